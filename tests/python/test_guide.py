"""Every Python block of the README and of each page of the documentation runs as it stands."""

import re
import warnings
from pathlib import Path

import matplotlib
import pytest

matplotlib.use("Agg")

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
FOLDERS = ("tutorials", "howto", "explanation", "reference")
PAGES = [
    str(page.relative_to(ROOT))
    for page in [ROOT / "README.md", ROOT / "docs/guide.md"]
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
