"""Skipped computations of a plan: counted, stated in tables, and not written."""

import pytest
import viscovib as vv
from driver import SCENES


def counts(text):
    """Read the counts printed by --count."""
    lines = [line.split(": ") for line in text.splitlines() if line.startswith("counted: ")]
    return {name: int(n) for _, name, n in lines}


def test_tables_carry_the_plan_and_work_is_counted(solve, tmp_path):
    """The debug build counts; the release build prints that it does not count."""
    scene = tmp_path / "m.nml"
    text = (SCENES / "mount_paper.nml").read_text()
    quiet = text[: text.index("&kernel")] + text[text.index("&load") :]
    found = {}
    for name, scenario in (("memory", text), ("none", quiet)):
        scene.write_text(scenario)
        done = solve(scene, "--count", "--out", tmp_path)
        if done.returncode == 2:
            assert "--count: this build does not count its work" in done.stderr
            done = solve(scene, "--out", tmp_path)
        assert done.returncode in (0, 1)
        found[name] = counts(done.stdout)
        table = (tmp_path / "m_response.csv").read_text()
        plan = solve(scene, "--plan").stdout.splitlines()
        assert len(plan) > 3
        assert all(f"# {line}\n" in table for line in plan)
    if found["memory"]:
        assert found["memory"]["kernel transforms"] > 0 == found["none"]["kernel transforms"]
        assert found["memory"]["unknowns, even"] == 0 < found["memory"]["unknowns"]
        assert found["none"]["Fourier transforms"] == 0


def test_motions_in_time_tell_a_static_preload(solve, tmp_path):
    system = "&system coordinates='x' mass=1 stiffness=1 damping=0.05 /\n&force on='x' law='{}' /\n"
    structure = (
        "&structure size=2 mass=1 1 stiffness=2 -1 -1 2 rayleigh=0 0.05 /\n"
        "&element on='x1' law='{}' /\n"
    )
    motion = "&transient t_end=3 initial={} /\n"
    for text, start, law in (
        (system, "0 1", "0.3*tanh(x) + 0.2*cos(x)"), (structure, "0 1 0 0", "0.2*exp(d)"),
    ):  # fmt: skip
        scene = tmp_path / "scene.nml"
        scene.write_text(text.format(law) + motion.format(start))
        plan = solve(scene, "--plan").stdout.splitlines()
        assert "computes: the static preload of laws that are not 0 at rest (up to 0.2)" in plan
        assert str(vv.plan(scene)).splitlines() == plan


CHAIN = """&system coordinates='a' 'b' 'c' 'd' mass=1 1 1 1 damping=0.1 0.1 0.1 0.1 kernel=0
  stiffness=2 -1 0 0 -1 2 -1 0 0 -1 2 -1 0 0 -1 2 /
&kernel kind='prony' weights=0.2 rates=1 /
&force on='d' law='0.5*d^3' kernel=1 /
"""
HEAVY = """&system coordinates='x' mass=1 stiffness=1 damping=DAMPING /
&force on='x' law='0.5*x^3' /
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CHAIN + "&load on='a' amplitude=0.3 /\n&branch nu_from=0.3 nu_to=1 /\n", True),
        (CHAIN + "&load on='a' amplitude=0.3 /\n&response nu=0.5 method='newton' /\n", True),
        (CHAIN + "&load on='a' amplitude=0.3 /\n&response nu=0.5 method='linear' /\n", False),
        (HEAVY.replace("DAMPING", "1e5") + "&transient initial=0.5 0 t_end=100 /\n", True),
        (HEAVY.replace("DAMPING", "0.1") + "&transient initial=0.5 0 t_end=100 /\n", False),
        (HEAVY.replace("DAMPING", "1e5") + "&transient initial=0.5 0 t_end=1e-3 /\n", False),
    ],
)
def test_systems_are_condensed_where_that_takes_less_time(solve, tmp_path, text, said):
    scene = tmp_path / "scene.nml"
    scene.write_text(text)
    done = solve("--plan", scene)
    assert done.returncode == 0, done.stderr
    assert (" condensed to 1 deflection by " in done.stdout) == said
