"""The mount against closed forms, independent numerics and conservation laws."""

import numpy as np
import pytest
import scipy.linalg
import viscovib as vv
from referee.integration import solve_ivp

SCENE = {"mass": 1.0, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10.0, "stiffness_phi": 2.0}


def matrices():
    c_x, c_phi, arm = 10.0, 2.0, 0.5
    mass = np.diag([1.0, 0.1])
    in_x = c_x * np.array([[1.0, -arm], [-arm, arm**2]])
    in_phi = c_phi * np.diag([0.0, 1.0])
    return mass, in_x, in_phi


def test_natural_frequencies_and_shapes_solve_the_eigenproblem(mount):
    body = mount()
    mass, in_x, in_phi = matrices()
    for omega, shape in zip(body.natural_frequencies(), body.mode_shapes().T, strict=True):
        left = (in_x + in_phi) @ shape
        assert left == pytest.approx(omega**2 * mass @ shape, rel=1e-13)
    assert body.natural_frequencies() == pytest.approx([1.978647813497513, 7.147373841498814])


def test_repeated_frequency_without_offset(mount):
    body = mount(offset=0.0, stiffness_x=20.0)
    assert body.natural_frequencies() == pytest.approx(np.sqrt([20.0, 20.0]), rel=1e-15)
    assert body.mode_shapes() == pytest.approx(np.eye(2))


def test_stiffness_ratio_of_1e8_loses_no_digit(mount):
    body = mount(stiffness_x=1e9, stiffness_phi=10.0)
    low, high = body.natural_frequencies()
    assert low * high == pytest.approx(np.sqrt(1e9 * 10.0 / 0.1), rel=1e-14)
    # Rigid spring in x: the body swings about the support with I + m l^2.
    assert low == pytest.approx(np.sqrt(10.0 / (0.1 + 0.25)), rel=1e-7)


def test_dynamic_stiffness_is_the_sum_of_its_parts(mount):
    in_phi_kernel = vv.PronyKernel(weights=[0.3, 0.2], rates=[1.0, 5.0])
    damping = np.array([[0.2, 0.05], [0.03, 0.07]])
    body = mount(kernel_phi=in_phi_kernel, damping=damping, memory_scale=0.5)
    mass, in_x, in_phi = matrices()
    for nu in (0.4, 3.0, 20.0):
        expected = (
            in_x * (1 - 0.5 * body.kernel.transform(nu))
            + in_phi * (1 - 0.5 * in_phi_kernel.transform(nu))
            + 1j * nu * damping
            - nu**2 * mass
        )
        assert body.dynamic_stiffness(nu) == pytest.approx(expected, rel=1e-14)
    assert body.dynamic_stiffness([[1.0, 2.0]]).shape == (1, 2, 2, 2)


def right_side(geometry, c_x=10.0, c_phi=2.0, arm=0.5, damping=0.0, load=0.0, nu=1.0):
    """Equations of motion without memory, written explicitly."""

    def rhs(t, y):
        x, v, phi, w = y
        if geometry == "exact":
            f = c_x * (x - arm * np.sin(phi))
            moment = arm * np.cos(phi) * f - c_phi * phi
        else:
            signs = (1, 1, 4 / 6) if geometry == "cubic" else (-1, -1, -8 / 6)
            f = c_x * (x - arm * phi) + signs[0] * c_x * arm / 6 * phi**3
            moment = c_x * arm * x - (c_x * arm**2 + c_phi) * phi
            moment += -signs[1] * c_x * arm / 2 * phi**2 * x
            moment += abs(signs[2]) * c_x * arm**2 * phi**3
        return [v, load * np.sin(nu * t) - f - damping * v, w, (moment - damping * w) / 0.1]

    return rhs


@pytest.mark.parametrize("geometry", ["exact", "cubic", "printed"])
def test_response_solves_the_equations_of_motion(geometry):
    """Integrate the steady motion over a period: it must return to its start."""
    load, nu, damping = 0.5, 1.0, 0.4
    body = vv.Mount(**SCENE, geometry=geometry, damping=damping * np.eye(2))
    r = vv.forced_response(body, nu, load=load, harmonics=25, tolerance=1e-13)
    assert r.outcome == ["converged"]
    assert r.amplitude("phi", 3)[0] > 1e-4
    coefficients, orders = r.coefficients[0], r.harmonics

    def state(t):
        wave = np.exp(1j * orders * nu * t)
        u = (coefficients * wave).sum(axis=1).imag
        v = (coefficients * wave * 1j * orders * nu).sum(axis=1).imag
        return np.array([u[0], v[0], u[1], v[1]])

    end = 2.0
    run = solve_ivp(
        right_side(geometry, damping=damping, load=load, nu=nu),
        (0, end),
        state(0.0),
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    assert run.y[:, -1] == pytest.approx(state(end), abs=2e-10)


def test_cubic_approaches_exact_with_the_fifth_power_of_amplitude():
    """Without memory, halving the load divides the difference by 32."""
    differences = []
    for load in (0.4, 0.2, 0.1):
        response = [
            vv.forced_response(
                vv.Mount(**SCENE, geometry=geometry), 1.2, load=load, harmonics=15, tolerance=1e-14
            ).coefficients
            for geometry in ("exact", "cubic")
        ]
        differences.append(np.abs(response[0] - response[1]).max())
    orders = np.log2(np.array(differences[:-1]) / differences[1:])
    assert orders == pytest.approx([5.0, 5.0], abs=0.25)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"mass": 0.0}, "mass = 0: must be greater than 0"),
        ({"inertia": -1.0}, "inertia = -1: must be greater than 0"),
        ({"stiffness_x": 0}, "stiffness_x = 0: must be greater than 0"),
        ({"stiffness_phi": -2}, "stiffness_phi = -2: must be greater than 0"),
        ({"mass": np.nan}, "mass = nan: must be a finite number"),
        ({"offset": np.inf}, "offset = inf: must be a finite number"),
        ({"mass": "heavy"}, "mass = 'heavy': must be a real number"),
        ({"mass": None}, "mass = None: must be a real number"),
        ({"mass": 1 + 2j}, "mass = (1+2j): must be a real number"),
        ({"damping": [1, 2, 3]}, "damping: must have shape (2, 2), got (3,)"),
        ({"damping": np.eye(3)}, "damping: must have shape (2, 2), got (3, 3)"),
        ({"damping": [[0, np.nan], [0, 0]]}, "damping[0, 1] = nan"),
        ({"geometry": "round"}, "geometry = 'round': must be one of"),
        ({"kernel": 0.048}, "kernel = 0.048: must be a Kernel or None"),
        ({"kernel_phi": "x"}, "kernel_phi = 'x': must be a Kernel, None or False"),
        ({"memory_scale": -1}, "memory_scale = -1: must not be negative"),
        ({"geometry": "exact", "cubic_scale": 0.5}, "cubic_scale = 0.5: must be 1"),
    ],
)
def test_bad_parameters_are_named(mount, change, text):
    with pytest.raises(vv.InputError) as error:
        mount(**change)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_creep_is_warned_of_with_the_number(mount):
    with pytest.warns(vv.StabilityWarning, match=r"1\.00124 >= 1"):
        body = mount(amplitude=0.078)
    assert body.kernel.limit_amplitude == pytest.approx(0.0779033846, rel=1e-9)


def test_memory_scale_zero_silences_the_warning_and_the_memory(mount):
    silent = mount(amplitude=0.078, memory_scale=0.0)
    none = mount(kernel=None)
    nu = np.linspace(0.3, 5.0, 7)
    assert (silent.dynamic_stiffness(nu) == none.dynamic_stiffness(nu)).all()
    assert "no memory" in str(vv.forced_response(silent, nu, load=0.01, method="linear").plan)


@pytest.mark.filterwarnings("error")
def test_loads_beyond_all_frequencies(mount):
    """Only base accelerations grow with the square of the frequency."""
    body = mount()
    run = vv.simulate(body, 3, load=0.1, nu=1e300, dt=0.1)
    assert run.outcome == "completed"
    with pytest.raises(vv.InputError, match="beyond all range"):
        vv.simulate(body, 3, base=0.1, nu=1e300, dt=0.1)


@pytest.mark.parametrize("seed", range(2))
def test_normal_coordinates_decouple_the_equations(seed):
    """Equations (7), (8) and (14) of the paper: each coordinate is an independent oscillator."""
    rng = np.random.default_rng([48, seed])
    kernel = vv.RzhanitsynKernel(amplitude=rng.uniform(0.01, 0.05), alpha=0.1, beta=0.05)
    c_x, c_phi, arm, mass, inertia = rng.uniform([5, 1, 0.2, 0.5, 0.1], [20, 5, 0.8, 2, 0.5])
    mount = vv.Mount(
        mass=mass, inertia=inertia, offset=arm, stiffness_x=c_x, stiffness_phi=c_phi,
        kernel=kernel if seed else None,
    )  # fmt: skip
    modes = mount.modes()
    stiffness = np.array([[c_x, -c_x * arm], [-c_x * arm, c_x * arm**2 + c_phi]])
    masses = np.diag([mass, inertia])
    omega2, _ = scipy.linalg.eigh(stiffness, masses)
    assert modes.omega**2 == pytest.approx(omega2, rel=1e-12)
    assert modes.shapes[0] == pytest.approx([1, 1])
    nu, load = rng.uniform(0.5, 6, 5), np.array([0.3, 0.2])
    f = modes.force(load) / modes.dynamic_stiffness(nu)
    lost = kernel.transform(nu) if seed else np.zeros(5)
    exact = np.linalg.solve(
        (1 - lost)[:, None, None] * stiffness - nu[:, None, None] ** 2 * masses, load[:, None]
    )[..., 0]
    assert modes.physical(f) == pytest.approx(exact, rel=1e-11)
    assert modes.normal(exact) == pytest.approx(f, rel=1e-11)


def test_normal_coordinates_that_are_coupled():
    body = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
    kernel = vv.RzhanitsynKernel(amplitude=0.04, alpha=0.1, beta=0.05)
    for more, text in (
        ({"kernel": kernel, "kernel_phi": False}, "different kernels"),
        ({"damping": np.eye(2)}, "there is damping"),
    ):
        with pytest.raises(vv.InputError, match=f"{text}.* use mount.dynamic_stiffness"):
            vv.Mount(**body, **more).modes().dynamic_stiffness(1.0)
