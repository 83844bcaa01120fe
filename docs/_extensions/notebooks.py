"""Tutorials as notebooks, made from the same pages: `notebooks/NAME.ipynb` of the site."""

import json
import re
from pathlib import Path

from run_blocks import BLOCK

#: Links to other pages of the site lead nowhere from a notebook; their words stay.
LINK = re.compile(r"!?\[([^\]]*)\]\((?!https?:)[^)]*\)")


def notebook(text):
    """The notebook (format 4.5) of a page in Markdown: its words and its Python blocks."""
    cells = []
    place = 0
    for block in BLOCK.finditer(text):
        _add_words(cells, text[place : block.start()])
        code = {"cell_type": "code", "execution_count": None, "outputs": []}
        cells.append(_cell(cells, block[1], code))
        place = block.end()
    _add_words(cells, text[place:])
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def _add_words(cells, text):
    words = LINK.sub(r"\1", re.sub(r"```{.*?```\n?", "", text, flags=re.DOTALL)).strip()
    if words:
        cells.append(_cell(cells, words, {"cell_type": "markdown"}))


def _cell(cells, source, kind):
    text = source.rstrip("\n").splitlines(keepends=True)
    return {**kind, "id": f"cell-{len(cells)}", "metadata": {}, "source": text}


def pages(folder):
    """Tutorials that have Python blocks, by name."""
    return {
        page.stem: page.read_text(encoding="utf-8")
        for page in sorted((Path(folder) / "tutorials").glob("*.md"))
        if BLOCK.search(page.read_text(encoding="utf-8"))
    }


def _write(app, error):
    if error is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "notebooks"
    folder.mkdir(exist_ok=True)
    for name, text in pages(app.srcdir).items():
        content = json.dumps(notebook(text), indent=1, ensure_ascii=False)
        (folder / f"{name}.ipynb").write_text(content + "\n", encoding="utf-8")


def _link(app, docname, source):
    name = docname.removeprefix("tutorials/")
    if name != docname and BLOCK.search(source[0]):
        link = f'<a href="../notebooks/{name}.ipynb" download>Download this page as a notebook</a>'
        source[0] += f"\n\n```{{raw}} html\n<p>{link}</p>\n```\n"


def setup(app):
    """Sphinx calls this."""
    # Before the blocks of the page are run, which adds what they print.
    app.connect("source-read", _link, priority=100)
    app.connect("build-finished", _write)
    return {"version": "1", "parallel_read_safe": True}
