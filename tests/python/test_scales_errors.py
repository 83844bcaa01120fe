"""The estimated errors of multiple scales against the errors themselves."""

import warnings

import numpy as np
import pytest
import viscovib as vv

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")


def random_mount(rng):
    kernels = (
        None,
        vv.RzhanitsynKernel(amplitude=10 ** rng.uniform(-2.5, -1.3), alpha=0.3, beta=0.3),
        vv.PronyKernel(weights=[10 ** rng.uniform(-2.5, -1)], rates=[0.8]),
    )
    offset, inertia, c_phi = rng.uniform(-0.8, 0.8), 10 ** rng.uniform(-1.5, 0.5), 2.0
    stiffness = np.array([[10, -10 * offset], [-10 * offset, 10 * offset**2 + c_phi]])
    return vv.Mount(
        mass=1, inertia=inertia, offset=offset, stiffness_x=10, stiffness_phi=c_phi,
        kernel=kernels[rng.integers(3)], geometry=str(rng.choice(["cubic", "exact"])),
        damping=10 ** rng.uniform(-2.5, -1.5) * stiffness,
    )  # fmt: skip


def test_of_steady_motions_of_mounts_against_harmonic_balance():
    """Within a factor of 1.5 for nine of ten motions in range, of 3 for all except jumps."""
    rng = np.random.default_rng(11)
    ratios = []
    for _ in range(12):
        system = random_mount(rng)
        omega = vv.MultipleScales(system).frequencies[rng.integers(2)]
        nu = omega * np.linspace(0.9, 1.1, 5)
        load = 10 ** rng.uniform(-3, -1) * np.array([1, rng.uniform(-0.3, 0.3)])
        steady = vv.MultipleScales(system, load=load, nu=omega).response("nu", nu)
        exact = vv.forced_response(system, nu, load=load, method="newton")
        for i in range(nu.size):
            points = np.flatnonzero(steady.index == i)
            if points.size != 1 or not steady.in_range[points[0]]:
                continue
            p = points[0]
            error = abs(steady.harmonics[p] - exact.coefficients[i, :, 0]).max()
            # Elsewhere rounding errors, or another branch of the balance.
            if 1e-10 < error / abs(steady.harmonics[p]).max() < 0.3:
                ratios.append(steady.error_estimate[p] / error)
    ratios = np.array(ratios)
    assert ratios.size > 25
    assert ((ratios > 1 / 3) & (ratios < 3)).all()
    assert np.mean((ratios > 1 / 1.5) & (ratios < 1.5)) > 0.9


@pytest.mark.parametrize(
    ("mode", "load", "frequency", "size"),
    [(0, "f0", "p1", 2e-4), (1, "m01", "p2", 1e-4), (2, "m02", "p3", 5e-4)],
)
def test_of_the_pendulum_under_one_load(mode, load, frequency, size):
    """The parameter set P1 of the paper, a load near each mode in turn, by harmonic balance."""
    body = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.005, "c2": 0.005, "c3": 0.005}
    # Frequencies of z, of phi and of psi.
    w = vv.MultipleScales(vv.Pendulum(**body)).frequencies[mode]
    for offset in (-0.01, 0.004):
        p = w * (1 + offset)
        pend = vv.Pendulum(**body, **{load: size, frequency: p})
        steady = vv.MultipleScales(pend).response(frequency, [p])
        exact = vv.forced_response(pend, stability=False)
        # Im convention there, Re convention here.
        wanted = np.array([-1j * exact.coefficient(dof, 1)[0] for dof in ("z", "phi", "psi")])
        error = abs(steady.harmonics[0] - wanted).max()
        assert steady.index.size == 1
        assert error < 0.01 * abs(wanted).max()
        np.testing.assert_allclose(steady.error_estimate, error, rtol=0.1)


def test_of_a_long_motion_against_integration():
    """Forty exchanges of energy: the step size follows the changes of the amplitudes."""
    pend = vv.Pendulum(e=0.05, w2=0.51, w3=0.9, alpha=0.1, c1=1e-5, c2=1e-5, c3=1e-5)
    initial = np.array([0.012, 0, 0.003, 0, 0, 0])
    t = np.linspace(0, 10000, 2001)
    motion = vv.MultipleScales(pend).motion(t, initial)
    exact = vv.simulate(pend, t[-1], times=t, initial=initial, tolerance=1e-12).state
    error = abs(motion.state - exact)[:, ::2].max()
    assert 0.9 < motion.error_estimate.max() / error < 1.1


def test_what_is_exact_has_no_error():
    """A linear system: only rounding errors remain."""
    system = vv.CubicSystem(
        mass=np.eye(2), stiffness=[[2, -1], [-1, 3]], damping=0.02 * np.eye(2),
        load=[[0.3], [0.1]], drives=[0.7],
    )  # fmt: skip
    ms = vv.MultipleScales(system)
    assert ms.response("p1", [0.6, 0.7]).error_estimate.max() < 1e-13
    motion = ms.motion(np.linspace(0, 50, 51), [0.1, 0, 0, 0.2])
    assert motion.error_estimate.max() < 1e-12


def test_large_errors_are_out_of_range():
    """Orders decrease, but a term of fifth degree gives an error as large as the motion."""
    for factor, inside in ((1, True), (3000, False)):
        system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=0.02, forces=f"0.1*x^3 + {factor}*x^5"
        )
        ms = vv.MultipleScales(system, load=0.002, nu=1.0)
        assert ms.response("nu", [1.0]).in_range.all() == inside
        free = vv.MultipleScales(system)
        assert free.motion(np.linspace(0, 60, 7), [0.1, 0]).in_range.all() == inside


def test_results_can_be_sent_to_other_processes():
    import pickle

    pend = vv.Pendulum(e=0.1, w2=0.48, w3=0.8, alpha=0.5, c1=0.005, f0=0.001, p1=1.04)
    ms = vv.MultipleScales(pend)
    steady = pickle.loads(pickle.dumps(ms.response("p1", [1.03, 1.04])))
    np.testing.assert_array_equal(
        steady.error_estimate, ms.response("p1", [1.03, 1.04]).error_estimate
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motion = pickle.loads(pickle.dumps(ms.motion([0.0, 1.0], [0.01, 0, 0, 0, 0, 0])))
    assert motion.error_estimate.shape == (2,)


def test_a_wave_of_the_motion_at_the_frequency_of_a_resting_mode_is_no_growth():
    # 3 nu equals the frequency at which growth of the second mode is examined: the residual of the
    # motion itself is not a perturbation, for any load.
    for load in (1e-5, 1e-3, 0.02):
        system = vv.PolynomialSystem(
            mass=[0.605, 1.41], damping=[[0.011956, -0.004956], [-0.004956, 0.016926]],
            stiffness=[[1.708, -0.708], [-0.708, 2.418]],
            forces=[vv.Monomial(coefficient=1.386, powers=(0, 3), on=1),
                    vv.Monomial(coefficient=0.723, powers=(2, 0), on=0)],
        )  # fmt: skip
        steady = vv.MultipleScales(system, load=load, nu=0.5902).response("nu", [0.5902])
        exact = vv.forced_response(system, [0.5902], load=load, method="newton", stability=True)
        assert steady.stable.tolist() == exact.stable.tolist() == [True]
        assert steady.decided.all()
        assert steady.resting_growth[0] < -0.01


def test_stability_within_its_error_is_not_decided():
    # Near a Neimark-Sacker bifurcation: the Floquet growth is +0.0009, here it is -0.0014.
    system = vv.PolynomialSystem(
        mass=[1.23, 1.09], damping=[[0.0164152, -0.010721], [-0.010721, 0.018886]],
        stiffness=[[2.312, -1.51], [-1.51, 2.66]],
        forces=[vv.Monomial(coefficient=0.661, powers=(0, 3), on=1),
                vv.Monomial(coefficient=0.951, powers=(2, 0), on=0)],
    )  # fmt: skip
    steady = vv.MultipleScales(system, load=0.048, nu=0.91296).response("nu", [0.91296])
    assert not steady.decided.any()
    assert 1e-3 < steady.growth_error[0] < 0.05
    assert "not decided" in steady.summary()
    small = vv.MultipleScales(system, load=0.002, nu=0.91296).response("nu", [0.8])
    assert small.decided.all()
    assert small.stable.all()


@pytest.mark.parametrize("ordering", ["general", "weak_coupling"])
def test_of_a_mode_that_drifts_in_a_frame_far_from_it(ordering):
    """The frame uses w1 = 2 w2 with a detuning of a tenth: products rotate with the modes."""
    kw = {"e": 0.002, "w2": 0.591, "w3": 1.11, "alpha": 0.103, "c1": 1e-4, "c2": 1e-4, "c3": 1e-4}
    initial = np.array([-0.0007, -0.0054, 0.0248, 0.0526, -0.0384, 0.0192])
    pend = vv.Pendulum(**kw)
    motion = vv.MultipleScales(pend, ordering=ordering).motion(np.linspace(0, 80, 161), initial)
    frame = motion.modulation.frame
    assert abs(frame[0] - 2 * frame[1]) < 1e-9
    exact = vv.simulate(pend, 80, times=motion.t, initial=initial, tolerance=1e-12).state
    error = abs(motion.state - exact)[:, ::2].max(axis=1)
    for part in (slice(0, 41), slice(120, 161)):
        assert 0.7 < motion.error_estimate[part].max() / error[part].max() < 1.5
