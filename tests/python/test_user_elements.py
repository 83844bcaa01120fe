"""A user-defined element, `examples/ratchet.f90`, which is built for the tests."""

import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/howto/own-element.md").read_text(encoding="utf-8")
NU = 1.3
PERIOD = 2 * np.pi / NU


def ratchet(**other):
    numbers = {"stiffness": 2.0, "ahead": 0.4, "back": 0.15} | other
    return vv.user_elements()["ratchet"](on="x1", **numbers)


def single(element):
    return vv.Structure(mass=[1.0], stiffness=[1.0], damping=[0.1], elements=[element])


def moved(t_end, k=2.0, ahead=0.4, back=0.15):
    """Return x, v and z at the end, by SciPy between yield and reversal."""
    # Mode: 0 sticks, 1 slides ahead, -1 slides back.
    ends = {
        0: [(lambda _, y: y[2] - ahead, 1, 1), (lambda _, y: y[2] + back, -1, -1)],
        1: [(lambda _, y: y[1], -1, 0)],
        -1: [(lambda _, y: y[1], 1, 0)],
    }
    y, t, state = np.zeros(3), 0.0, 0
    while t < t_end:
        events = []
        for at, direction, _ in ends[state]:
            at.direction, at.terminal = direction, True
            events.append(at)
        run = solve_ivp(
            lambda t, y, own=state: [
                y[1], np.sin(NU * t) - 0.1 * y[1] - y[0] - y[2], k * y[1] if own == 0 else 0.0
            ],
            (t, t_end), y, "DOP853", rtol=1e-12, atol=1e-13, events=events,
        )  # fmt: skip
        y, t = run.y[:, -1], run.t[-1]
        for (_, _, after), found in zip(ends[state], run.t_events, strict=True):
            if len(found):
                state = after
        if state:
            y[2] = ahead if state > 0 else -back
    return y


def test_its_class():
    element = ratchet()
    assert repr(element) == "ratchet(on='x1', stiffness=2.0, ahead=0.4, back=0.15)"
    assert repr(pickle.loads(pickle.dumps(element))) == repr(element)
    with pytest.raises(vv.InputError, match=r"^back = -1: must be greater than 0$"):
        ratchet(back=-1)
    with pytest.raises(vv.InputError, match=r"^ahead = 'a': must be a real number"):
        ratchet(ahead="a")


def test_its_loop():
    """Bitwise equal to a `Jenkins` with equal limits; otherwise compared by its area."""
    d = np.random.default_rng(3).normal(size=40)
    alike, slider = ratchet(back=0.4), vv.Jenkins(on="x1", stiffness=2.0, limit=0.4)
    assert np.array_equal(alike.loop(d), slider.loop(d))
    assert alike.energy(d) == slider.energy(d)
    # (F_ahead + F_back) (2 a - (F_ahead + F_back)/k).
    assert ratchet().energy([0.7, -0.7]) == pytest.approx(0.55 * (1.4 - 0.55 / 2), rel=1e-14)


def test_its_motions():
    """In time and steady, by SciPy; with even harmonics, because it is not odd."""
    system = single(ratchet())
    run = vv.simulate(system, 30 * PERIOD, load=[1.0], nu=NU, tolerance=1e-9)
    end = moved(30 * PERIOD)
    assert np.abs(run.state[-1] - end[:2]).max() < 3e-12
    steady = vv.forced_response(
        system, [NU], load=[1.0], method="newton", harmonics=40, tolerance=1e-5, stability=True
    )
    assert 2 in steady.harmonics
    assert steady.stable[0] == 1
    x = steady.coefficients[0, 0]
    # The remaining transient after 30 periods, and its offset, which sliding resets.
    assert x.imag.sum() == pytest.approx(end[0], abs=2e-4)


@pytest.mark.parametrize(("name", "ends"), [("back", (0.15, 0.3)), ("stiffness", (2.0, 2.5))])
def test_its_numbers_vary(name, ends):
    """The end of a branch equals the element with that value."""
    options = {"load": [1.0], "harmonics": 9, "tolerance": 1e-3}
    vary = f"elements[0].{name}"
    branch = vv.trace_response(single(ratchet()), vary=vary, vary_range=ends, nu=NU, **options)
    assert branch.outcome == "completed"
    other = single(ratchet(**{name: ends[1]}))
    alone = vv.forced_response(other, [NU], method="newton", **options)
    np.testing.assert_allclose(branch.coefficients[-1], alone.coefficients[0], atol=1e-9)


def listed(folder, name, text):
    element = folder / f"{name}.f90"
    element.write_text(text)
    program = ROOT / "fortran/list_elements.py"
    template = ROOT / "fortran/systems/user_elements.f90.in"
    return subprocess.run(
        [sys.executable, program, template, folder / "made.f90", element],
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_the_commands_of_the_page(tmp_path):
    """A copy under another name, listed and compiled as in the build."""
    copy, rename, build = re.search(r"```sh\n(cp.*\n)(sed.*\n)(pip.*\n)```", PAGE).groups()
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    subprocess.run(["sh", "-ec", copy + rename], cwd=tmp_path, check=True)
    assert re.fullmatch(
        r"pip install \. --config-settings=setup-args=-Delements=\$PWD/belt.f90\n", build
    )
    assert "option('elements', type: 'array'" in (ROOT / "meson.options").read_text()
    belt = (tmp_path / "belt.f90").read_text()
    done = listed(tmp_path, "belt", belt)
    assert done.returncode == 0, done.stderr
    sources = [ROOT / "fortran" / f"{name}.f90" for name in
               ("base/kinds", "base/number_text", "base/status", "systems/hysteresis")]  # fmt: skip
    for source in (*sources, tmp_path / "belt.f90", tmp_path / "made.f90"):
        subprocess.run(
            ["gfortran", "-fsyntax-only", "-std=f2018", "-Wall", "-Werror", source],
            cwd=tmp_path, check=True, env=os.environ | {"LC_ALL": "C"},
        )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "change", "reported"),
    [
        (
            "belt",
            ("new_belt", "make_belt"),
            "has no new_belt; must have belt_element, belt, new_belt",
        ),
        ("Belt", ("", ""), "must be called NAME.f90"),
    ],
)
def test_a_file_that_is_no_element(tmp_path, name, change, reported):
    text = (ROOT / "examples/ratchet.f90").read_text().replace("ratchet", "belt")
    done = listed(tmp_path, name, text.replace(*change))
    assert done.returncode != 0
    assert reported in done.stderr
