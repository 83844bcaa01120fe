"""The mount by multiple scales, with memory, against harmonic balance."""

import numpy as np
import pytest
import viscovib as vv

#: Fixed numbers of harmonics; the truncation is tested elsewhere.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.*do not reach the tolerance:viscovib.ConvergenceWarning"
)

KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
BODY = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}


def mount(**change):
    return vv.Mount(**{**BODY, "kernel": KERNEL, **change})


@pytest.mark.parametrize("geometry", ["cubic", "exact", "printed"])
@pytest.mark.parametrize("kernel_phi", [None, False, vv.PronyKernel(weights=[0.1], rates=[0.3])])
def test_modes_are_the_characteristic_roots(geometry, kernel_phi):
    system = mount(geometry=geometry, kernel_phi=kernel_phi, damping=[[0.02, 0], [0, 0.001]])
    roots = system.characteristic_roots().oscillatory
    ms = vv.MultipleScales(system)
    np.testing.assert_allclose(np.sort(ms.exponents.imag), np.sort(roots.imag), rtol=1e-12)
    np.testing.assert_allclose(np.sort(-ms.decay), np.sort(roots.real), rtol=1e-11)


def test_interaction_without_memory_by_hand():
    """Potential to fourth order in normal coordinates: gamma_jj = 3 beta_jj/(8 omega)."""
    system = mount(kernel=None)
    ms = vv.MultipleScales(system)
    shapes = ms.mode_shapes
    c_x, length = BODY["stiffness_x"], BODY["offset"]
    modal_mass = np.array([BODY["mass"], BODY["inertia"]]) @ shapes**2
    # V_4 = c_x l x phi^3/6 - c_x l^2 phi^4/6, with (x, phi) = sum shapes_j b_j cos(theta_j):
    # the mean over both angles is sum_jk h_jk b_j^2 b_k^2, and omega_j shift = dV/db_j/(m w b_j).
    angles = np.arange(32) * 2 * np.pi / 32
    first, second = np.meshgrid(np.cos(angles), np.cos(angles))

    def mean(b):
        x, phi = (shapes[d, 0] * b[0] * first + shapes[d, 1] * b[1] * second for d in (0, 1))
        return np.mean(c_x * length * x * phi**3 / 6 - c_x * length**2 * phi**4 / 6)

    h11, h22 = mean([1, 0]), mean([0, 1])
    h12 = mean([1, 1]) - h11 - h22
    weights = modal_mass * ms.frequencies
    expected = np.array([[4 * h11, 2 * h12], [2 * h12, 4 * h22]]) / weights[:, np.newaxis]
    np.testing.assert_allclose(ms.interaction, expected, rtol=1e-12)


@pytest.mark.parametrize("geometry", ["cubic", "exact"])
@pytest.mark.parametrize("mode", [0, 1])
def test_response_near_a_mode_against_harmonic_balance(geometry, mode):
    system = mount(geometry=geometry)
    omega = vv.MultipleScales(system).frequencies[mode]
    nu = omega * np.linspace(0.97, 1.03, 7)
    for load in (0.1, 0.02):
        ms = vv.MultipleScales(system, load=load, nu=omega)
        response = ms.response("nu", nu)
        assert response.index.size == nu.size
        assert response.stable.all()
        assert response.in_range.all()
        exact = vv.forced_response(system, nu, load=load, method="newton", harmonics=7)
        linear = vv.forced_response(system, nu, load=load, method="linear")
        for dof in ("x", "phi"):
            error = abs(response.amplitude(dof) - exact.amplitude(dof))
            assert (error < 1.2 * response.error_estimate).all()
            effect = abs(linear.amplitude(dof) - exact.amplitude(dof)).max()
            assert error.max() < (0.05 if mode == 0 else 0.3) * effect


def test_error_falls_as_load_memory_and_detuning_do():
    """With load x^3 and memory and detuning x^2, the amplitude is x and the relative error x^2."""
    errors = []
    for k in range(4):
        x = 2.0**-k
        system = mount(memory_scale=0.1 * x**2)
        omega = vv.MultipleScales(system).frequencies[0]
        nu = np.array([omega * (1 + 0.01 * x**2)])
        load = 0.02 * x**3
        response = vv.MultipleScales(system, load=load, nu=nu[0]).response("nu", nu)
        exact = vv.forced_response(system, nu, load=load, method="newton", harmonics=7)
        errors.append(abs(response.amplitude("phi") / exact.amplitude("phi") - 1).max())
    assert errors[-1] < 1e-4
    assert np.log2(errors[-2] / errors[-1]) > 1.8


def test_branches_against_continuation():
    """Three coexisting motions of a lightly damped mount; stability by Floquet multipliers."""
    system = mount(kernel=None, damping=[[0.01, 0], [0, 0.001]])
    omega = vv.MultipleScales(system).frequencies[0]
    nu = 1.01 * omega
    response = vv.MultipleScales(system, load=0.006, nu=nu).response("nu", [nu])
    branch = vv.trace_response(
        system, nu_range=(0.98 * omega, 1.04 * omega), load=0.006, harmonics=5, max_step=0.01
    )
    crossed = np.flatnonzero((branch.nu[:-1] - nu) * (branch.nu[1:] - nu) <= 0)
    assert crossed.size == response.index.size == 3
    exact = np.sort(branch.amplitude("phi")[crossed])
    np.testing.assert_allclose(np.sort(response.amplitude("phi")), exact, rtol=0.05)
    order = np.argsort(branch.amplitude("phi")[crossed])
    assert list(branch.stable[crossed][order]) == [True, False, True]
    assert list(response.stable[np.argsort(response.amplitude("phi"))]) == [True, False, True]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: vv.MultipleScales(mount(), load=[1, 2, 3]), "load: must be a number or have"),
        (lambda: vv.MultipleScales(mount(), load=1, nu=0), "nu = 0: must be greater than 0"),
        (
            lambda: vv.MultipleScales(vv.Pendulum(e=0.1, w2=0.4, w3=0.8), load=1),
            "load, nu: are for a Mount or a PolynomialSystem",
        ),
        (lambda: vv.MultipleScales(mount()).response("nu", [1.0]), "load 1 has no amplitude"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(vv.InputError, match=message):
        call()


def test_no_motion_is_lost_where_many_modes_may_move():
    """With a wide tolerance 3 w1 ~ w2 counts as resonant: still one motion per detuning."""
    kernel = vv.AbelKernel(amplitude=0.05, alpha=0.2)
    with pytest.warns(vv.StabilityWarning):
        system = mount(
            kernel=kernel, inertia=2.2926, offset=-0.3, damping=[[0.062, 0], [0, 0.0432]]
        )
    omega = vv.MultipleScales(system).frequencies[0]
    ms = vv.MultipleScales(system, load=[0.05, 0.01], nu=omega, tolerance=0.2)
    assert len(ms.terms) == 6
    nu = omega * np.linspace(0.9, 1.35, 19)
    response = ms.response("nu", nu)
    assert list(np.bincount(response.index, minlength=nu.size)) == [1] * nu.size
    exact = vv.forced_response(system, nu, load=[0.05, 0.01], method="newton", harmonics=7)
    error = abs(response.amplitude("phi") - exact.amplitude("phi"))
    assert (error < 1.2 * response.error_estimate).all()
    np.testing.assert_allclose(response.amplitude("phi"), exact.amplitude("phi"), rtol=1e-3)
