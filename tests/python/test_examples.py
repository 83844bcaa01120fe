"""The docstring of every public name has an example, which runs and prints its output."""

import doctest
import inspect
import warnings
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
import viscovib as vv

#: Names that examples need not import.
GIVEN = {"np": np, "vv": vv}
DATA = Path(__file__).parents[2] / "data"

#: Warnings and errors appear in the examples of the functions that raise them.
NAMES = [
    name
    for name in vv.__all__
    if not (isinstance(getattr(vv, name), type) and issubclass(getattr(vv, name), BaseException))
]


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_name_runs(name, tmp_path, monkeypatch):
    text = inspect.getdoc(getattr(vv, name)) or ""
    examples = doctest.DocTestParser().get_doctest(text, dict(GIVEN), name, None, 0)
    assert examples.examples, f"{name}: its docstring has no example"
    (tmp_path / "data").symlink_to(DATA)
    monkeypatch.chdir(tmp_path)
    reported: list[str] = []
    options = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    runner = doctest.DocTestRunner(optionflags=options, verbose=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        failed, _ = runner.run(examples, out=reported.append)
    plt.close("all")
    assert not failed, "".join(reported)
