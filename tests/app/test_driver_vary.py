"""Branches along the load or a parameter in scenes, by the driver and by Python."""

import pytest
from driver import check_refused

LIGHT = """&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
  damping=0.2 -0.1 -0.1 0.09 /
&load amplitude=2.5 /
"""
ALONG = (
    LIGHT + "&branch vary='cubic_scale', nu=2.3686976436, from=0.8, to=1.2, harmonics='auto' /\n"
)
SYSTEM = """&system coordinates='x', mass=1, stiffness=1, damping=0.1, base_direction=1 /
&force law='x^3' /
&load kind='base', amplitude=0.3 /
&branch vary='load_factor', nu=1, from=0.1, to=3 /
"""


BAD = {
    "name": (ALONG.replace("cubic", "cubik"), 4, "vary = 'cubik_scale': must be one of 'nu'"),
    "of a system": (SYSTEM.replace("'load_factor'", "'mass'"), 4, "vary = 'mass': must be one of"),
    "no frequency": (ALONG.replace("nu=2.3686976436,", ""), 4, "&branch lacks nu"),
    "frequency": (ALONG.replace("nu=2.3686976436,", "nu=0,"), 4, "nu = 0: must be greater than 0"),
    "nowhere": (ALONG.replace("to=1.2", "to=0.8"), 4, "to = 0.8: must differ from from"),
    "no mount": (
        ALONG.replace("'cubic_scale'", "'mass'").replace("to=1.2", "to=-1"),
        4,
        "mass = -1: must be greater than 0",
    ),
    "no mount to begin with": (
        ALONG.replace("'cubic_scale'", "'mass'").replace("from=0.8", "from=0"),
        4,
        "mass = 0: must be greater than 0",
    ),
    "nan": (ALONG.replace("from=0.8", "from=nan"), 4, "from = nan: must be a finite number"),
    "frequencies too": (ALONG.replace("nu=2", "nu_from=1, nu=2"), 4, "unknown key 'nu_from'"),
    "of a pendulum": (
        "&pendulum e=0.1, w2=0.4, w3=0.8, f0=0.01, p1=1 /\n&branch vary='mass', from=0.9, to=1 /",
        2,
        "unknown key 'vary'",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_branch_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD[name]
    check_refused(solve, tmp_path, text, message, line)
