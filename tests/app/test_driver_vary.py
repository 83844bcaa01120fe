"""Branches along the load or a parameter in scenes, by the driver and by Python."""

import os
import re

import numpy as np
import pytest
import viscovib as vv
from driver import BRANCH, check_failure, read_csv, silence

LIGHT = """&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
  damping=0.2 -0.1 -0.1 0.09 /
&load amplitude=2.5 /
"""
KERNEL = "&kernel kind='rzhanitsyn', amplitude=0.048, alpha=0.1, beta=0.05 /\n"
ALONG = (
    LIGHT + "&branch vary='cubic_scale', nu=2.3686976436, from=0.8, to=1.2, harmonics='auto' /\n"
)
SYSTEM = """&system coordinates='x', mass=1, stiffness=1, damping=0.1, base_direction=1 /
&force law='x^3' /
&load kind='base', amplitude=0.3 /
&branch vary='load_factor', nu=1, from=0.1, to=3 /
"""

SCENES = {
    "cubic": ALONG,
    "from zero": ALONG.replace("from=0.8, to=1.2", "from=0, to=0.3"),
    "mass": ALONG.replace("'cubic_scale'", "'mass'"),
    "memory": KERNEL + ALONG.replace("'cubic_scale'", "'memory_scale'").replace("=1.2,", "=0.4,"),
    "geometry": KERNEL
    + ALONG.replace("'cubic_scale'", "'offset'")
    .replace("from=0.8, to=1.2", "from=0.3, to=0.6")
    .replace("mass=1", "geometry='exact', mass=1")
    .replace("amplitude=2.5", "amplitude=0.5"),
    "load, back": ALONG.replace("'cubic_scale'", "'load_factor'").replace(
        "from=0.8, to=1.2", "from=1.2, to=0.8"
    ),
    "base": SYSTEM,
}

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


@pytest.mark.parametrize("name", SCENES)
def test_driver_and_python_agree(solve, tmp_path, name):
    scene = tmp_path / "s.nml"
    scene.write_text(SCENES[name])
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    with silence():
        result = vv.run(scene)
        assert str(result.plan).splitlines() == solve(scene, "--plan").stdout.splitlines()
    branch = result.branch
    table = read_csv(tmp_path / "s_branch.csv")
    assert table.dtype.names[0] == branch.varies
    text = (tmp_path / "s_branch.csv").read_text()
    changes = re.findall(r"# stability changes after point (\d+): (.*?)(?: at .* = (\S+))?\n", text)
    assert [kind for _, kind, _ in changes] == [c.kind for c in branch.crossings]
    if name == "cubic":
        # Symmetry breaking along the frequency.
        (at,) = [float(where) for _, kind, where in changes if kind == "symmetry breaking"]
        assert at == pytest.approx(1, abs=1e-8)
    ends = [0, -1]
    for d, dof in enumerate(branch.dof_names):
        ours = table[f"{dof}_1_re"] + 1j * table[f"{dof}_1_im"]
        assert ours[ends] == pytest.approx(branch.coefficients[ends, d, 0], rel=1e-7)
    if "debug" in os.environ.get("VISCOVIB_SOLVE", ""):
        return
    assert (table[branch.varies] == branch.parameter).all()
    assert (table["growing"] == branch.growing).all()
    for d, dof in enumerate(branch.dof_names):
        for j, k in enumerate(branch.harmonics):
            assert (table[f"{dof}_{k}_re"] == branch.coefficients[:, d, j].real).all()
            assert (table[f"{dof}_{k}_im"] == branch.coefficients[:, d, j].imag).all()
    assert [float(where or "nan") for _, _, where in changes] == pytest.approx(
        [np.nan if c.parameter is None else c.parameter for c in branch.crossings],
        rel=1e-15, nan_ok=True,
    )  # fmt: skip
    branch.to_csv(tmp_path / "python.csv")
    assert (read_csv(tmp_path / "python.csv")[branch.varies] == branch.parameter).all()


@pytest.mark.parametrize("name", BAD)
def test_bad_branch_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD[name]
    scene = tmp_path / "bad.nml"
    scene.write_text(text)
    out = tmp_path / "out"
    out.mkdir()
    done = solve(scene, "--out", out)
    check_failure(done, 2, message, out)
    assert f"bad.nml:{line}: " in done.stderr
    with pytest.raises(vv.ViscovibError) as error:
        vv.run(scene)
    assert str(error.value) in done.stderr


def test_a_branch_in_frequency_is_as_before(tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(BRANCH)
    read = vv.Scene.read(scene)
    assert read.groups["branch"]["vary"] == "nu"
    assert read.groups["branch"]["nu_to"] == 4
