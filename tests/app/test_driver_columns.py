"""Optional columns of responses and branches: sampling errors, energy loss."""

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused, read_csv, silence

STRUCTURE = """&structure mass=1 2 stiffness=2 -1 -1 2 damping=0.06 -0.01 -0.01 0.05
  base_direction=1 1 /
&kernel kind='prony' weights=0.3 rates=0.8 /
&element on='x1' law='0.2*d^3 + 0.1*v*abs(v)' kernel=0 /
&element on='x1' 'x2' stiffness=0.3 law='0.2*sin(d)' damping=0.1 kernel=1 /
&load on='x1' amplitude=0.5 /
&load kind='base' amplitude=0.1 phase=1 /
"""
RESPONSE = "&response nu=0.7 1.1 method='{}' {} sampling='yes' dissipation='yes' /\n"
BRANCH = "&branch nu=0.8 vary='load_factor' from=0.5 to=1 harmonics=15 stability='no' {} /\n"


def _table(solve, folder, text):
    (folder / "scene.nml").write_text(text)
    done = solve(folder / "scene.nml", "--out", folder)
    assert done.returncode in (0, 1), done
    return read_csv(next(folder.glob("scene_*.csv")))


def _own(x, k, nu):
    """Loss of the structural damping: harmonics of coordinates relative to the base."""
    damping = np.array([[0.06, -0.01], [-0.01, 0.05]])
    return np.pi * nu * (k**2 * np.einsum("ak,ab,bk->k", x.conj(), damping, x).real).sum()


@pytest.mark.parametrize("branch", [False, True])
def test_a_structure_loses_what_it_is_fed(solve, tmp_path, branch):
    """Elements by the condensation in Python, and the damping of the structure."""
    asked = "sampling='yes' dissipation='yes'"
    more = BRANCH.format(asked) if branch else RESPONSE.format("newton", "harmonics=15")
    rows = _table(solve, tmp_path, STRUCTURE + more)
    scene = vv.Scene.read(tmp_path / "scene.nml")
    loads = scene.loads()
    with silence():
        if branch:
            r = vv.trace_response(
                scene.structure(), load_range=(0.5, 1), nu=0.8, harmonics=15, stability=False,
                **loads,
            )  # fmt: skip
            ends = [0, -1]
        else:
            r = vv.forced_response(
                scene.structure(), [0.7, 1.1], method="newton", harmonics=15, **loads
            )
            ends = [0, 1]
    lost, k = r.dissipation(), r.harmonics
    for i in ends:
        factor = r.load_factor[i] if branch else 1
        x = r.coefficients[i] - factor * loads["base"][1] * (k == 1)
        total = lost[i].sum() + _own(x, k, r.nu[i])
        assert rows["dissipation"][i] == pytest.approx(total, rel=2e-6)
        assert rows["sampling"][i] == pytest.approx(r.sampling[i], rel=0.1, abs=1e-13)


MOUNT = "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n&load amplitude=1 /"
BODY = (
    "&body mass=10 inertia=0.3 0.2 0.4 geometry='exact' /\n"
    "&mount_point name='a' position=0.1 0.2 0 stiffness=1e4 1e4 2e4 /\n&load on='z' amplitude=1 /"
)
REFUSED = {
    "sampling = 'often': must be one of 'no', 'yes'": MOUNT + "\n&response nu=1 sampling='often' /",
    ":3: sampling = yes: the system changes along a branch over mass": MOUNT
    + "\n&branch vary='mass' nu=1 from=1 to=2 sampling='yes' /",
    ":3: dissipation = yes: the system changes along a branch over offset": MOUNT
    + "\n&branch vary='offset' nu=1 from=1 to=2 dissipation='yes' /",
    ":4: dissipation = yes: is not available for a &body with geometry = 'exact', must be no": BODY
    + "\n&response nu=1 dissipation='yes' method='newton' /",
}


@pytest.mark.parametrize("message", REFUSED)
def test_refused(solve, tmp_path, message):
    check_refused(solve, tmp_path, REFUSED[message] + "\n", message)
