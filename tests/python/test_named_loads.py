"""Loads by names of coordinates equal loads by position, in every analysis."""

import numpy as np
import pytest
import viscovib as vv

SYSTEM = vv.PolynomialSystem(
    mass=[1.0, 1.0],
    stiffness=[[2.0, -1.0], [-1.0, 2.0]],
    damping=[0.1, 0.1],
    names=["a", "b"],
    forces={"b": "0.5*b^3"},
)
MOUNT = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2)
ANALYSES = {
    "simulate": lambda s, load: vv.simulate(s, 5.0, load=load, nu=1.0).state,
    "forced_response": lambda s, load: vv.forced_response(s, [0.7], load=load).coefficients,
    "trace_response": lambda s, load: vv.trace_response(s, (0.5, 0.6), load=load).nu,
}


@pytest.mark.parametrize("analysis", ANALYSES)
@pytest.mark.parametrize("system", [SYSTEM, MOUNT], ids=["system", "mount"])
def test_names_are_places(analysis, system):
    run, name = ANALYSES[analysis], system.dof_names[1]
    by_place = np.asarray(run(system, [0.0, 0.01]))
    assert np.abs(by_place).max() > 0
    np.testing.assert_array_equal(run(system, {name: 0.01}), by_place)
    np.testing.assert_array_equal(run(system, {1: {name: 0.01}}), by_place)


@pytest.mark.parametrize("analysis", ANALYSES)
def test_a_name_that_is_none_is_reported(analysis):
    with pytest.raises(vv.InputError, match=r"'c' must be one of the 2 coordinates a, b"):
        ANALYSES[analysis](SYSTEM, {"c": 1.0})
