"""Runs the Python blocks of each page where they stand; their output and pictures follow them.

The blocks of a page share their names, as the cells of a notebook do. Pages whose blocks are run
are those of `RUN`; the tests run the same blocks through `blocks`.
"""

import contextlib
import io
import os
import re
import tempfile
import warnings
from pathlib import Path

BLOCK = re.compile(r"```python\n(.*?)```\n", re.DOTALL)
#: Printed LaTeX becomes a formula.
FORMULA = re.compile(r"(\\begin\{aligned\}.*?\\end\{aligned\})", re.DOTALL)
RUN = ("tutorials/", "howto/", "explanation/", "reference/")


def blocks(text):
    """The Python blocks of a page in Markdown, in their order."""
    return BLOCK.findall(text)


def _run_page(app, docname, source):
    if not docname.startswith(RUN) or not BLOCK.search(source[0]):
        return
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder = Path(app.srcdir) / "_pictures"
    folder.mkdir(exist_ok=True)
    names: dict = {}
    made = 0

    def run(match):
        nonlocal made
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
            exec(compile(match[1], docname, "exec"), names)
        text = match[0]
        for part in FORMULA.split(printed.getvalue()):
            if part.startswith(r"\begin{aligned}"):
                text += f"\n$$\n{part}\n$$\n"
            elif part.strip():
                text += f"\n```text\n{part.strip(chr(10)).rstrip()}\n```\n"
        for number in plt.get_fignums():
            made += 1
            name = f"{docname.replace('/', '-')}-{made}.png"
            plt.figure(number).savefig(folder / name, dpi=110, bbox_inches="tight")
            text += f"\n![what the lines above draw](/_pictures/{name})\n"
        plt.close("all")
        return text

    before = Path.cwd()
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        os.chdir(scratch)
        try:
            source[0] = BLOCK.sub(run, source[0])
        finally:
            os.chdir(before)


def setup(app):
    """Sphinx calls this."""
    app.connect("source-read", _run_page)
    return {"version": "1", "parallel_read_safe": False}
