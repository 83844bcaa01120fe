"""Tutorials as notebooks, generated from the pages, with the same code blocks."""

import json
import sys
import warnings
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import pytest

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS / "_extensions"))

import notebooks  # noqa: E402
import run_blocks  # noqa: E402

PAGES = notebooks.pages(DOCS)


@pytest.mark.parametrize("name", PAGES)
def test_a_notebook_has_the_blocks_of_its_page(name):
    # test_guide runs the pages.
    made = json.loads(json.dumps(notebooks.notebook(PAGES[name])))
    assert made["nbformat"] == 4
    assert len({cell["id"] for cell in made["cells"]}) == len(made["cells"])
    code = ["".join(cell["source"]) for cell in made["cells"] if cell["cell_type"] == "code"]
    assert code == [block.rstrip("\n") for block in run_blocks.blocks(PAGES[name])]
    words = "".join("".join(c["source"]) for c in made["cells"] if c["cell_type"] == "markdown")
    # Relative links into the site would be broken.
    assert ".md)" not in words
    assert words.startswith("# ")


def test_the_cells_of_a_notebook_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for cell in notebooks.notebook(PAGES["first-response"])["cells"]:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), "first-response", "exec"), names)
    plt.close("all")
