"""Quadratic resonance with memory by multiple scales; polynomial systems; units."""

import warnings

import numpy as np
import pytest
import viscovib as vv

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")

FORCES = {"x1": "0.4*x1*x2 + 0.1*x1^3", "x2": "0.2*x1^2 + 0.3*x2^3"}


def two_to_one(size, kernel):
    """Two oscillators near 1:2; damping and detuning are as small as the motion."""
    return vv.PolynomialSystem(
        mass=[1, 1], stiffness=[1, 4 * (1 + 0.02 * size)], kernel=kernel, forces=FORCES,
        damping=[0.01 * size, 0.01 * size],
    )  # fmt: skip


def test_motion_at_two_to_one_with_memory_against_integration():
    """On the slow manifold, after the memory of the start has relaxed."""
    system = two_to_one(0.5, vv.PronyKernel(weights=[0.05], rates=[1.2]))
    errors = []
    for size in (1.0, 0.5, 0.25):
        run = vv.simulate(system, 100, dt=0.1, initial=size * np.array([0.1, 0, 0.05, 0]))
        start = int(np.searchsorted(run.t, 40.0))
        motion = vv.MultipleScales(system, tolerance=0.08).motion(
            run.t[start:] - run.t[start], run.state[start]
        )
        error = abs(motion.state - run.state[start:])[:, ::2].max()
        assert 0.3 * error < motion.error_estimate.max() < 6 * error
        errors.append(error / abs(run.state[start:]).max())
    powers = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (powers > 2.9).all()


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_kernel_without_integral_is_a_limit(damping):
    """Abel kernel as limit of the Rzhanitsyn kernel for beta -> 0: the mean relaxes completely."""
    forces = {"x1": "0.3*x1^2 + 0.1*x1*x2", "x2": "0.2*x1*x2 + 0.1*x2^3"}
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.StabilityWarning)
        for kernel in (
            vv.AbelKernel(amplitude=0.01, alpha=0.4),
            vv.RzhanitsynKernel(amplitude=0.01, alpha=0.4, beta=1e-12),
        ):
            system = vv.PolynomialSystem(
                mass=[1, 1], stiffness=[1, 3], kernel=kernel, forces=forces,
                damping=[damping, damping],
            )  # fmt: skip
            ms = vv.MultipleScales(system, load=[0.001, 0], nu=1.0)
            steady = ms.response("nu", [0.99])
            found.append([*ms.interaction.ravel(), *steady.harmonics[:, 0]])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_exact_resonance_with_memory_divides_by_nothing():
    system = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[1, 4], forces=FORCES,
        kernel=vv.RzhanitsynKernel(amplitude=1e-12, alpha=0.5, beta=0.1),
    )  # fmt: skip
    without = vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 4], forces=FORCES)
    one, other = (vv.MultipleScales(s).terms for s in (system, without))
    assert [t.factors for t in one] == [t.factors for t in other]
    np.testing.assert_allclose(
        [t.coefficient for t in one], [t.coefficient for t in other], atol=1e-10
    )


@pytest.mark.parametrize("memory", [False, True])
def test_a_polynomial_system_is_the_mount(memory):
    """The cubic geometry of the mount as monomials: the same numbers within rounding."""
    c, arm, c_phi, i = 10.0, 0.5, 2.0, 0.1
    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05) if memory else None
    mount = vv.Mount(
        mass=1, inertia=i, offset=arm, stiffness_x=c, stiffness_phi=c_phi, kernel=kernel,
        damping=0.01 * np.eye(2),
    )  # fmt: skip
    system = vv.PolynomialSystem(
        mass=[1, i], stiffness=[[c, -c * arm], [-c * arm, c * arm**2 + c_phi]], kernel=kernel,
        damping=[0.01, 0.01], names=("x", "phi"),
        forces={
            "x": f"{c * arm / 6}*phi^3",
            "phi": f"{c * arm / 2}*phi^2*x - {2 * c * arm**2 / 3}*phi^3",
        },
    )  # fmt: skip
    one, other = (vv.MultipleScales(s, load=0.05, nu=1.5) for s in (mount, system))
    np.testing.assert_allclose(one.exponents, other.exponents, rtol=1e-13)
    np.testing.assert_allclose(one.interaction, other.interaction, rtol=1e-12)
    nu = np.linspace(1.4, 1.7, 7)
    one, other = (ms.response("nu", nu) for ms in (one, other))
    np.testing.assert_allclose(one.harmonics, other.harmonics, rtol=1e-11)
    np.testing.assert_allclose(one.error_estimate, other.error_estimate, rtol=1e-6)


def test_terms_beyond_the_third_degree_are_in_the_error():
    nu = np.array([1.0])
    cubic, quintic = (
        vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces=f)
        for f in ("x^3", "x^3 + 5*x^5")
    )
    one, other = (
        vv.MultipleScales(s, load=0.002, nu=1.0).response("nu", nu) for s in (cubic, quintic)
    )
    np.testing.assert_array_equal(one.harmonics, other.harmonics)
    exact = vv.forced_response(quintic, nu, load=0.002, method="newton", harmonics=9)
    error = abs(other.harmonics[0, 0] - exact.coefficients[0, 0, 0])
    np.testing.assert_allclose(other.error_estimate, error, rtol=0.2)
    assert other.error_estimate[0] > 2 * one.error_estimate[0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: vv.MultipleScales(two_to_one(1, None), load=[1, 2, 3]),
            r"load: must be a number or have shape \(2,\)",
        ),
        (
            lambda: vv.MultipleScales(vv.PolynomialSystem(mass=1, stiffness=-1, forces="x^3")),
            "eigenvalue -1",
        ),
        (
            lambda: vv.MultipleScales(
                vv.PolynomialSystem(mass=[1, 1], stiffness=[[1, 0.1], [0.3, 2]], forces=FORCES)
            ),
            "stiffness: must be symmetric for multiple scales",
        ),
        (
            lambda: vv.MultipleScales(two_to_one(1, None), ordering="weak_coupling"),
            "ordering = 'weak_coupling': is for a Pendulum",
        ),
        (
            lambda: vv.MultipleScales(vv.Pendulum(e=0.1, w2=0.5, w3=0.8), ordering="paper"),
            "ordering = 'paper': must be one of",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(vv.InputError, match=message):
        call()


@pytest.mark.parametrize("unit", [1e-9, 1e6])
@pytest.mark.parametrize("what", ["mass", "length", "time"])
def test_units_move_results_by_rounding(what, unit):
    """All public values in other units of mass, length or time."""

    def results(mass, length, time):
        force, kernel = (
            mass * length / time**2,
            vv.RzhanitsynKernel(amplitude=0.03 * time**-0.25, alpha=0.25, beta=0.05 / time),
        )
        body = vv.Mount(
            mass=mass, inertia=0.1 * mass * length**2, offset=0.5 * length,
            stiffness_x=10 * mass / time**2, stiffness_phi=2 * force * length, kernel=kernel,
            damping=np.array([[0.2, 0], [0, 0.01 * length**2]]) * mass / time,
        )  # fmt: skip
        ms = vv.MultipleScales(body, load=[0.03 * force, 0.01 * force * length], nu=1.5 / time)
        shape = np.array([length, 1.0])[:, np.newaxis]
        # Amplitudes by their effect on phi, where units of length cancel.
        phi = abs(ms.mode_shapes[1])
        steady = ms.response("nu", np.array([1.4, 1.5, 1.6]) / time)
        t = np.linspace(0, 20, 5) * time
        initial = np.array([0.02 * length, 0, 0.05, 0.03 / time])
        motion = ms.motion(t, initial, accuracy=1e-13)
        units = np.array([length, length / time, 1, 1 / time])
        scale = np.array([length, 1.0])
        return [
            ms.exponents * time, (ms.mode_shapes / shape / ms.mode_shapes[1]).ravel(),
            (ms.interaction / phi**2 * time).ravel(), (steady.harmonics / scale).ravel(),
            steady.eigenvalues.ravel() * time, (motion.state / units).ravel(),
            (steady.harmonics.real + steady.harmonic_errors).ravel() / np.tile(scale, 3),
            # In the unit of the coordinate with the largest motion, which may be another one.
            steady.order_sizes[:, 2] / steady.order_sizes[:, 0], motion.in_range * 1.0,
            motion.order_sizes[:, 2] / motion.order_sizes[:, 0],
        ]  # fmt: skip

    changed = dict.fromkeys(("mass", "length", "time"), 1.0) | {what: unit}
    for one, other in zip(results(1, 1, 1), results(**changed), strict=True):
        assert abs(one - other).max() < 3e-13 * abs(one).max()
