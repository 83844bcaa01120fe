"""Overhead of a short run in time, and equal results of its fast paths."""

import gc
import sys
from typing import Any

import numpy as np
import pytest
import viscovib as vv

#: Limit of function calls per run, including compiled functions: about 60 of them convert the
#: values of its single task.
MOST_CALLS = 180


def _oscillator(forces: Any = "0.3*tanh(x_dot) + 0.2*sin(x)") -> vv.PolynomialSystem:
    return vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=forces)


def _run(system: vv.PolynomialSystem, **given: Any) -> vv.Trajectory:
    return vv.simulate(system, 3.0, dt=0.5, method="gauss8", tolerance=1e-10, **given)


def test_few_functions_are_called_for_one_run() -> None:
    system, calls = _oscillator(), []
    given = {"initial": (1.0, 0.0), "load": 0.5, "nu": 0.9, "keep": "last"}
    _run(system, **given)
    # Garbage of other tests would be counted when it is collected.
    gc.collect()
    gc.disable()
    sys.setprofile(lambda frame, event, _: calls.append(frame) if "call" in event else None)
    try:
        _run(system, **given)
    finally:
        sys.setprofile(None)
        gc.enable()
    assert len(calls) <= MOST_CALLS


@pytest.mark.parametrize("seed", range(3))
def test_the_same_load_and_start_written_in_other_ways_are_the_same_run(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = _oscillator()
    x, v, load, nu = (float(number) for number in rng.uniform(0.2, 1.5, 4))
    first = _run(system, initial=(x, v), load=load, nu=nu)
    loads = [complex(load), [load], {1: load}, np.float64(load), {0: 0.0, 1: load}]
    starts: list[Any] = [[x, v], np.array([x, v]), (np.float64(x), v), np.array([x, 9, v])[::2]]
    for other in loads:
        np.testing.assert_array_equal(
            _run(system, initial=(x, v), load=other, nu=nu).state, first.state
        )
    for start in starts:
        found = _run(system, initial=start, load=load, nu=nu)
        np.testing.assert_array_equal(found.state, first.state)


def test_coordinates_that_nothing_moves_rest_however_they_are_reported() -> None:
    system = vv.PolynomialSystem(
        mass=np.eye(2), stiffness=np.diag([1.0, 2.0]), forces={"x1": "0.1*sin(x1)"}
    )
    table = vv.LoadTable(times=[0.0, 1.0, 2.0], values=[[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    still = _run(system, initial=(1.0, 0.0, 0.0, 0.0))
    assert np.abs(still.state[:, 2:]).max() == 0.0 < np.abs(still.state[1:, 1]).min()
    assert np.abs(_run(system, force=table).state[:, 2]).max() > 0.0
    assert np.abs(_run(system, load=[0.0, 1.0], nu=1.0).state[:, 2]).max() > 0.0
    assert np.abs(_run(system, initial=(0.0, 0.0, 0.0, 0.1)).state[:, 2]).max() > 0.0


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        ({"initial": (1.0, float("nan"))}, r"initial\[1\] = nan: must be a finite number"),
        ({"initial": (float("inf"), -float("inf"))}, r"initial\[0\] = inf: must be a finite"),
        ({"initial": (1.0,)}, r"initial: must have shape \(2,\), got \(1,\)"),
        ({"initial": (1.0, True)}, None),
        ({"initial": (1e29, 1e29)}, None),
        ({"load": float("nan"), "nu": 1.0}, r"load = .*nan.*: must be a finite number"),
        ({"load": 0.5}, r"nu: must be given with a load"),
        ({"load": {0: 1j, 1: 0.0}}, None),
        ({"load": 0.5, "nu": -1.0}, r"nu = -1: must be greater than 0"),
        ({"load": 0.0}, None),
        ({"load": {0: 1j}}, None),
        ({"nu": 1.0}, r"nu: must not be given without load"),
    ],
)
def test_what_is_wrong_is_still_refused(given: dict[str, Any], reported: str | None) -> None:
    if reported is None:
        _run(_oscillator(), **given)
        return
    with pytest.raises(vv.InputError, match=reported):
        _run(_oscillator(), **given)
