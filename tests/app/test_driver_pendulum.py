"""Branches of a pendulum in scenes, by the driver and by Python."""

import pytest
from driver import MOTION, check_refused

PENDULUM_BRANCH = MOTION.splitlines()[0] + "\n&branch from=0.9, to=1 /\n"
TORUS = """&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.1, c2=0.1, c3=0.1, f0=0.02, p1=0.93,
  m01=0.01, p2=0.37 /
&branch from=0.9, to=0.95, harmonics=4, symmetry='kept' /
"""

BAD_BRANCHES = {
    "branch and motion": (MOTION + "&branch from=0.9, to=1 /", 3, "has &transient already"),
    "branch and scales": (
        PENDULUM_BRANCH + "&multiple_scales from=0.9, to=1 /",
        3,
        "has &branch already",
    ),
    "no such load": (PENDULUM_BRANCH.replace("from", "parameter='p2', from"), 2, "m01 = 0"),
    "no base": (
        TORUS.replace("from", "parameter='nu', from"),
        3,
        "needs a single base frequency",
    ),
    "no such branch": (PENDULUM_BRANCH.replace("to=1", "to=0.9"), 2, "must differ from from"),
    "orders": (PENDULUM_BRANCH.replace("to=1", "to=1, harmonics=0"), 2, "harmonics = 0: must be"),
    "too many orders": (TORUS.replace("=4", "=99"), 3, "harmonics = 99: must be 1 to"),
    "switch": (PENDULUM_BRANCH.replace("to=1", "to=1, switch=0"), 2, "switch = 0: must be"),
    "switch half": (PENDULUM_BRANCH.replace("to=1", "to=1, switch=0.5"), 2, "must be integers"),
    "symmetry": (PENDULUM_BRANCH.replace("to=1", "to=1, symmetry='no'"), 2, "must be one of 'any'"),
    "stability": (PENDULUM_BRANCH.replace("to=1", "to=1, stability='maybe'"), 2, "must be one of"),
    "nan": (
        PENDULUM_BRANCH.replace("from=0.9", "from=nan"),
        2,
        "from = nan: must be a finite number",
    ),
    "subharmonic": (PENDULUM_BRANCH.replace("to=1", "to=1, subharmonic=0"), 2, "must be 1 to 20"),
}


@pytest.mark.parametrize("name", BAD_BRANCHES)
def test_bad_branch_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD_BRANCHES[name]
    check_refused(solve, tmp_path, text, message, line)
