"""Typing errors in scenes: status 2 and one clear line, the same for driver and Python."""

import pytest
from driver import check_refused

SYSTEM = "&system coordinates='x' 'y' mass=1 1 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /\n"
LOAD = "&load on='x' amplitude=0.3 /\n"
ENSEMBLE = "vary='load_scale' from=0.2 to=0.3 count=3 nu=1.2 initial=0 0 0 0 t_end=3"


def _parameters(text, law="k*x^3"):
    return f"&parameters {text} /\n{SYSTEM}&force on='x' law='{law}' /\n{LOAD}&response nu=1 /\n"


def _event(text):
    return f"{SYSTEM}{LOAD}&transient t_end=5 initial=0.1 0 0 0 nu=1 /\n&event {text} /\n"


def _ensemble(old, new):
    assert old in ENSEMBLE
    return f"{SYSTEM}{LOAD}&ensemble {ENSEMBLE.replace(old, new)} /\n"


def _law(text):
    return f"{SYSTEM}&force on='x' law={text} /\n{LOAD}&response nu=1 /\n"


TYPOS = {
    **{
        f"parameters {text}": (_parameters(text), line, message)
        for text, line, message in [
            ("", 3, "'k' is neither a variable nor a parameter"),
            ("k=", 1, "k has no value"),
            ("k", 1, "is not followed by '='"),
            ("k=1 2", 1, "k has 2 values: must be a number"),
            ("k=nan", 1, "must be a finite number"),
            ("k=1 k2=3", 1, "k2: is in no law"),
            ("k=1 K=2", 1, "k is given twice"),
            ("pi=3", 1, "pi: is a name that laws have already"),
            ("x_dot=2", 1, "x_dot: is the name of a coordinate"),
            ("3k=1", 1, "must be a name of at most 32 letters"),
        ]
    },
    **{
        f"event {text}": (_event(text), 4, message)
        for text, message in [
            ("", "&event lacks function"),
            ("funtion='x'", "did you mean 'function'?"),
            ("function='x +'", "at its end: expected"),
            ("function='1'", "depends on no quantity"),
            ("function='x' direction='upp'", "must be one of 'any', 'up', 'down'"),
            ("function='é'", "'é' (character 1): expected"),
            ("function='x*€'", "'€' (character 3): expected"),
            ("function='k*x'", "'k' is neither a variable nor a parameter"),
        ]
    },
    **{
        f"ensemble {new}": (_ensemble(old, new), 3, message)
        for old, new, message in [
            ("load_scale", "load_scal", "must be one of 'nu', 'load_scale'"),
            ("count=3", "count=0", "count = 0: must be 1 to"),
            ("count=3", "count=2.5", "must be an integer"),
            ("initial=0 0 0 0", "initial=0 0", "initial has 2 values: must be 4"),
            ("t_end=3", "t_end=-1", "t_end = -1: must be greater than 0"),
            ("t_end=3", "t_end=3 discard=9", "discard = 9: must not be negative"),
            ("t_end=3", "t_end=3 dt=4", "dt = 4: must not exceed t_end = 3"),
            ("t_end=3", "t_end=3 sections=1", "&ensemble lacks n_periods"),
            ("t_end=3", "sections=1 n_periods=3 discard=-0.5", "discard = -0.5: must not be neg"),
            ("nu=1.2", "", "&ensemble lacks nu"),
        ]
    },
    **{
        f"law {text}": (_law(text), 2, message)
        for text, message in [
            ("", "law has no value"),
            ("x^3", "must be a quoted text"),
            ("'x^'", "expected a whole power"),
            ("'sinn(x)'", "did you mean sinh?"),
            ("'2x'", "'x' (character 2): expected"),
            ("'é*x'", "'é' (character 1): expected"),
            ("'sqrt(x)'", "must be defined near rest"),
            ("'tanh(1/x)'", "must be defined near rest"),
            ("'x / abs(x)'", "u/abs(u) is sign(u) but for u = 0: write sign"),
            ("'x*log(abs(x))'", "must have a finite derivative at rest"),
            ("'x/0'", "divided only by numbers other than 0"),
        ]
    },
}


TYPOS |= {
    "no law": (f"{SYSTEM}&force on='x' /\n{LOAD}&response nu=1 /\n", 2, "&force lacks law"),
    "lew": (
        f"{SYSTEM}&force on='x' lew='x^3' /\n{LOAD}&response nu=1 /\n", 2, "did you mean 'law'?",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TYPOS)
def test_one_clear_line(solve, tmp_path, name):
    text, line, message = TYPOS[name]
    check_refused(solve, tmp_path, text, message, line)
