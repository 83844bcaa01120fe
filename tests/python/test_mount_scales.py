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
