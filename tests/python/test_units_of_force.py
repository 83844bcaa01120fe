"""Results do not depend on the unit of force."""

import re

import numpy as np
import pytest
import viscovib as vv
from scipy.sparse import diags_array

SCALES = (2.0**20, 2.0**-20)


def _chain(rng, n):
    springs = rng.uniform(0.5, 2, n + 1)
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    mass, damping = rng.uniform(0.5, 2, n), 10 ** rng.uniform(-4, -1) * stiffness
    quadratic, cubic = rng.uniform(0.1, 0.4), rng.uniform(0.1, 1)
    kernel = vv.PronyKernel(weights=[rng.uniform(0.01, 0.1)], rates=[rng.uniform(0.1, 2)])

    def system(scale):
        return vv.PolynomialSystem(
            mass=mass * scale,
            stiffness=stiffness * scale,
            damping=damping * scale,
            forces={"x1": f"{quadratic * scale!r}*x1^2 + {cubic * scale!r}*x1^3"},
            kernel=kernel if n == 2 else None,
            names=[f"x{i + 1}" for i in range(n)],
        )

    return system


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_errors_are_the_same_in_any_unit_of_force(n):
    # The mean has no equation for its real part: its rounding error must not count, because it
    # grows with the numbers of the forces.
    rng = np.random.default_rng(n)
    for _ in range(3):
        system, nu = _chain(rng, n), np.sort(rng.uniform(0.3, 2.5, 5))
        load = np.array([10 ** rng.uniform(-3, -1)] + [0.0] * (n - 1))
        for method in ("newton", "successive"):
            own = vv.forced_response(system(1.0), nu, load=load, method=method)
            for scale in SCALES:
                other = vv.forced_response(system(scale), nu, load=scale * load, method=method)
                for name in ("coefficients", "truncation", "error"):
                    np.testing.assert_array_equal(getattr(other, name), getattr(own, name), name)
        # Steps along branches differ slightly, because pivots do.
        own, other = (
            vv.trace_response(system(scale), (0.4, 2.2), load=scale * load).error
            for scale in (1.0, SCALES[0])
        )
        assert np.median(other) < 4 * np.median(own)


def scaled(force, length, kernel=None):
    """A Duffing oscillator in other units of force and length, and its load and start."""
    system = vv.PolynomialSystem(
        mass=force / length, stiffness=force / length, damping=0.1 * force / length,
        forces=f"{0.5 * force / length**3!r}*x^3", kernel=kernel,
    )  # fmt: skip
    return system, {"load": 0.3 * force, "nu": 1.0, "initial": [0.4 * length, 0]}


@pytest.mark.parametrize("kernel", [None, vv.PronyKernel(weights=[0.1], rates=[1.0])])
def test_units_change_no_motion_or_are_out_of_range(kernel):
    """A system that is not refused moves as in ordinary units."""
    system, given = scaled(1.0, 1.0, kernel)
    true = vv.simulate(system, 5, rtol=1e-8, **given).state[-1]
    for force in (1e-307, 1e-290, 1e-279, 1e-200, 1e-100, 1e100, 1e200):
        if force < 1e-280:
            with pytest.raises(vv.InputError, match="must be at least 1e-280: choose other units"):
                scaled(force, 1.0, kernel)
            continue
        system, given = scaled(force, 1.0, kernel)
        assert vv.simulate(system, 5, rtol=1e-8, **given).state[-1] == pytest.approx(true, rel=1e-6)
    for length in (1e-60, 1e-30, 1e20, 1e29, 1e31, 1e50):
        system, given = scaled(length, length, kernel)
        if length > 1e30:
            with pytest.raises(vv.InputError, match=r"must be at most 1e.30: choose other units"):
                vv.simulate(system, 5, rtol=1e-8, **given)
            continue
        last = vv.simulate(system, 5, rtol=1e-8, **given).state[-1]
        assert last / length == pytest.approx(true, rel=1e-6)


@pytest.mark.parametrize(
    "make",
    [
        lambda m: vv.Structure(mass=[m, m], stiffness=m * np.eye(2)),
        lambda m: vv.Structure(mass=diags_array([m, m]), stiffness=diags_array([m, m])),
        lambda m: vv.Mount(mass=m, inertia=1, offset=0, stiffness_x=1, stiffness_phi=1),
        lambda m: vv.Mount(mass=1, inertia=m, offset=0, stiffness_x=1, stiffness_phi=1),
        lambda m: vv.PolynomialSystem(mass=[m, m], stiffness=[m, m]),
    ],
)
def test_masses_that_are_too_small_for_numbers_are_refused(make):
    make(1e-270)
    for mass in (5e-324, 1e-308, 1e-281):
        with pytest.raises(vv.InputError, match=r"must be (0 or )?at least 1e-280: choose other"):
            make(mass)


def test_scenes_refuse_what_is_out_of_range(tmp_path):
    system = "&system coordinates='x', mass={}, stiffness=1 /\n&load amplitude=1 /\n"
    run = "&transient initial={} 0, nu=1, t_end=3 /\n"
    scene = tmp_path / "a.nml"
    for mass, start, said in (
        (1e-300, 1, "a.nml:1: mass: has 1e-300 in row 1, must be at least 1e-280"),
        (1, 1e31, "a.nml:3: initial: has a displacement of 1e31, must be at most 1e30"),
    ):
        scene.write_text((system + run).format(mass, start))
        with pytest.raises(vv.InputError, match=re.escape(said)):
            vv.run(scene)
