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


def random_system(rng, kind):
    """A system of one to three coordinates, or eight with one force, and the name of one."""
    n = 8 if kind == "condensed" else int(rng.integers(1, 4))
    springs = rng.uniform(0.5, 2.0, n + 1)
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    kernel = vv.RzhanitsynKernel(amplitude=0.2, alpha=0.4, beta=1.0) if rng.random() < 0.5 else None
    names = [f"x{i + 1}" for i in range(n)]
    mass, cubic = rng.uniform(0.5, 2.0, n), rng.uniform(0.1, 0.5)
    if kind == "structure":
        element = vv.Spring(on="x1", stiffness=0.3, law=f"{cubic}*d^3", kernel=kernel)
        system = vv.Structure(
            mass=np.diag(mass), stiffness=stiffness, modal_damping=0.05, elements=[element]
        )
    else:
        system = vv.PolynomialSystem(
            mass=mass, stiffness=stiffness, damping=0.05 * stiffness, kernel=kernel,
            forces={"x1": f"{cubic}*x1^3"}, names=names,
        )  # fmt: skip
    return system, names[int(rng.integers(n))]


@pytest.mark.parametrize("kind", ["system", "structure", "condensed"])
@pytest.mark.parametrize("seed", range(4))
def test_unbalance_is_a_load_of_its_amplitude_at_each_frequency(kind, seed):
    rng = np.random.default_rng(seed)
    system, name = random_system(rng, kind)
    a, b, order = 0.02 * rng.random(), 0.05 * rng.random(), int(rng.integers(1, 3))
    nu = np.sort(rng.uniform(0.3, 2.5, 5))
    text = f"{a} + ({b} + {b / 2}j)*nu^2"
    for method in ("newton", "linear"):
        found = vv.forced_response(
            system, nu, load={order: {name: text}}, method=method, harmonics=9
        )
        for i, one in enumerate(nu):
            number = a + (b + 0.5j * b) * one**2
            expected = vv.forced_response(
                system, [one], load={order: {name: number}}, method=method, harmonics=9
            )
            scale = np.abs(expected.coefficients).max()
            np.testing.assert_allclose(
                found.coefficients[i], expected.coefficients[0], rtol=0, atol=1e-9 * scale
            )
    number = a + (b + 0.5j * b) * nu[0] ** 2
    runs = [
        vv.simulate(system, 5, load={order: {name: p}}, nu=nu[0], keep="last").state[-1]
        for p in (text, number)
    ]
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-12)


def test_folds_of_a_branch_with_unbalance():
    """Both folds agree with another program to 13 digits.

    The oscillator x'' + 0.05 x' + x + x^3 = 0.02 nu^2 cos nu t by Fourier collocation (25 and 40
    harmonics) and dnu/da = 0, confirmed by shooting with DOP853.
    """
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    branch = vv.trace_response(system, (0.3, 2.0), load="0.02*nu^2", stability=True)
    folds = [1.069208627388277, 1.0576213370217253]
    np.testing.assert_allclose(branch.folds, folds, rtol=1e-10)
    places = [np.abs(branch.nu - nu).argmin() for nu in folds]
    np.testing.assert_array_equal(branch.stable[[0, sum(places) // 2, -1]], [True, False, True])


@pytest.mark.parametrize(
    "text", ["0.3*nu", "nu*y", "nu^3", "nu/0", "nu(", "__import__('nu')", "nu + 9^9^9^9"]
)
def test_a_text_that_is_no_unbalance_is_refused(text):
    with pytest.raises(
        vv.InputError, match=r"load\['a'\] = .*: must be a number, or a text a \+ b"
    ):
        vv.forced_response(SYSTEM, [1.0], load={"a": text})


def test_a_frequency_that_varies_refuses_a_force_that_depends_on_it():
    with pytest.raises(vv.InputError, match="depends on nu, which is not a constant here"):
        vv.simulate_ensemble(
            SYSTEM, initial=np.zeros((2, 4)), t_end=5, load="nu^2", parameters={"nu": [1.0, 2.0]}
        )
    with pytest.raises(vv.InputError, match="a mean must not depend on nu"):
        vv.forced_response(SYSTEM, [1.0], load={0: "nu^2"})
