"""Every Python block of the README and of each page runs, and every script of the gallery."""

import re
import runpy
import shutil
import warnings
from pathlib import Path

import matplotlib
import matplotlib.pyplot
import pytest
import viscovib as vv

matplotlib.use("Agg")

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
SCENE = re.compile(r"```\n(&.*?)```", re.DOTALL)
FOLDERS = ("tutorials", "howto", "explanation", "reference")
PAGES = [
    str(page.relative_to(ROOT))
    for page in [ROOT / "README.md"]
    + [page for folder in FOLDERS for page in sorted((ROOT / "docs" / folder).rglob("*.md"))]
    if BLOCK.search(page.read_text())
]


@pytest.mark.parametrize("page", PAGES)
def test_blocks_of_a_page_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for block in BLOCK.findall((ROOT / page).read_text()):
            exec(compile(block, page, "exec"), names)
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize(
    "script", sorted((ROOT / "docs/examples/short").glob("*.py")), ids=lambda script: script.stem
)
def test_scripts_of_the_gallery_draw(script, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        runpy.run_path(str(script))
    assert matplotlib.pyplot.get_fignums()
    matplotlib.pyplot.close("all")


def test_scenes_of_pages_are_whole(tmp_path):
    shutil.copytree(ROOT / "data/scenes", tmp_path, dirs_exist_ok=True)
    scenes = 0
    for page in sorted((ROOT / "docs").rglob("*.md")):
        for number, text in enumerate(SCENE.findall(page.read_text())):
            scene = tmp_path / f"{page.stem}_{number}.nml"
            scene.write_text(text)
            vv.plan(vv.Scene.read(scene))
            scenes += 1
    assert scenes >= 4


def test_links_between_pages_lead_somewhere():
    # `./run docs` checks the links of the built site, including generated pages.
    sources = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    made = ("docs/gallery/", "docs/reference/python/names/", "docs/fortran/", "out/")
    broken = []
    for page in sources:
        place = page.relative_to(ROOT)
        if str(place).startswith((*made, "docs/ford.md")):
            continue
        text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            path = link.partition("#")[0]
            if not path or "://" in path or path.startswith("mailto:"):
                continue
            target = (page.parent / path).resolve()
            inside = str(target.relative_to(ROOT)) if target.is_relative_to(ROOT) else path
            if not target.exists() and not f"{inside}/".startswith(made):
                broken.append(f"{place}: {link}")
    assert broken == []


def test_the_paper_cites_what_its_bibliography_has():
    paper, sources = (ROOT / "docs/paper.md").read_text(), (ROOT / "docs/paper.bib").read_text()
    cited = set(re.findall(r"@(\w+)", paper.split("---", 2)[2]))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", sources, re.M))
    for part in ("Summary", "Statement of need", "State of the field", "Limits", "References"):
        assert f"\n# {part}\n" in paper


def test_every_public_name_has_a_reference_page():
    pages = (ROOT / "docs/reference/python").glob("*.md")
    listed = [name for page in pages for name in re.findall(r"^   (\w+)$", page.read_text(), re.M)]
    assert sorted(listed) == sorted(vv.__all__)
