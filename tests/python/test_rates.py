"""Laws of rates: friction and quadratic damping against SciPy, with every method."""

import warnings

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

C, K, NU, LOAD = 0.1, 1.5, 1.1, 0.4
LAWS = {
    "0.3*x_dot*abs(x_dot)": lambda x, v: 0.3 * v * abs(v),
    "0.2*tanh(x_dot/0.3)": lambda x, v: 0.2 * np.tanh(v / 0.3),
    "0.3*x^2*x_dot + 0.3*x_dot + x^3": lambda x, v: 0.3 * x * x * v + 0.3 * v + x**3,
    "0.2*sin(x)*x_dot^2 + 0.2*x_dot": lambda x, v: 0.2 * np.sin(x) * v * v + 0.2 * v,
}


def equation(force):
    return lambda t, y: [
        y[1], LOAD * np.sin(NU * t) - C * y[1] - K * y[0] - force(y[0], y[1])
    ]  # fmt: skip


def solved(rhs, n, times, start=None, step=0.05):
    return solve_ivp(
        rhs, (0, times[-1]), np.zeros(n) if start is None else start, "DOP853", times,
        rtol=1e-13, atol=1e-14, max_step=step,
    ).y  # fmt: skip


@pytest.mark.parametrize("text", LAWS)
def test_steady_motion_in_time_and_multipliers(text):
    """One oscillator: harmonics, time integration, and the monodromy matrix."""
    rhs = equation(LAWS[text])
    system = vv.PolynomialSystem(mass=1, stiffness=K, damping=C, forces=text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        found = vv.forced_response(system, [NU], load=LOAD, method="newton", stability=True)
    period = 2 * np.pi / NU
    orders, x = found.harmonics, found.coefficients[0, 0]
    start = [x.imag.sum(), (orders * NU * x.real).sum()]
    # A steady motion ends at its start; the sum of |k| x_k v converges slowest at a kink.
    end = solved(rhs, 2, [period], start)[:, -1]
    np.testing.assert_allclose(end, start, atol=1e-7 if "abs" in text else 1e-9)
    times = np.linspace(0, 10, 5)[1:]
    run = vv.simulate(system, 10, load=LOAD, nu=NU, dt=0.01)
    np.testing.assert_allclose(
        run.state[-1], solved(rhs, 2, times)[:, -1], atol=1e-9 if "abs" in text else 1e-12
    )
    ends = [
        solved(rhs, 2, [period], np.add(start, shift))[:, -1]
        for shift in ([1e-5, 0], [-1e-5, 0], [0, 1e-5], [0, -1e-5])
    ]
    monodromy = np.array([ends[0] - ends[1], ends[2] - ends[3]]).T / 2e-5
    np.testing.assert_allclose(
        np.sort_complex(found.multipliers[0]), np.sort_complex(np.linalg.eigvals(monodromy)),
        atol=1e-6,
    )  # fmt: skip
    assert found.stable[0]


@pytest.mark.parametrize("outside", [False, True])
def test_with_memory(outside):
    """A law of a rate behind a kernel and in parallel with one: time, harmonics, exponents."""
    weight, rate = 0.8, 2.0
    kernel = vv.PronyKernel(weights=[weight], rates=[rate])
    text = "0.2*tanh(x_dot/0.3) + 0.3*x^3"
    if outside:
        springs = [vv.Springs(forces=text)]
        system = vv.PolynomialSystem(mass=1, stiffness=K, damping=C, kernel=kernel, springs=springs)
    else:
        system = vv.PolynomialSystem(mass=1, stiffness=K, damping=C, forces=text, kernel=kernel)

    def rhs(t, y):
        f = 0.2 * np.tanh(y[1] / 0.3) + 0.3 * y[0] ** 3
        w = K * y[0] + (0 if outside else f)
        force = w - weight * y[2] + (f if outside else 0)
        return [y[1], LOAD * np.sin(NU * t) - C * y[1] - force, w - rate * y[2]]

    run = vv.simulate(system, 10, load=LOAD, nu=NU, dt=0.05)
    exact = solved(rhs, 3, [10.0])[:2, -1]
    np.testing.assert_allclose(run.state[-1], exact, atol=1e-12)
    found = vv.forced_response(system, [NU], load=LOAD, method="newton", stability=True)
    period = 2 * np.pi / NU
    steady = solved(rhs, 3, [40 * period])[:, -1]
    np.testing.assert_allclose(found.coefficients[0, 0].imag.sum(), steady[0], atol=1e-8)
    ends = [solved(rhs, 3, [period], steady + shift)[:, -1] for shift in 1e-5 * np.eye(3)]
    back = [solved(rhs, 3, [period], steady - shift)[:, -1] for shift in 1e-5 * np.eye(3)]
    expected = np.linalg.eigvals((np.array(ends) - np.array(back)).T / 2e-5)
    known = found.multipliers[0][np.isfinite(found.multipliers[0])]
    for multiplier in known:
        assert np.abs(expected - multiplier).min() < 1e-7
    assert found.stable[0]
    assert np.abs(known).max() == pytest.approx(np.abs(expected).max(), abs=1e-7)


@pytest.mark.filterwarnings("ignore::viscovib.errors.ConvergenceWarning")
def test_branch_derivatives():
    """A branch over the frequency, whose tangents need dR/dnu, and over the damping."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.05, forces="0.1*tanh(x_dot/0.5) + 0.02*x^3"
    )
    branch = vv.trace_response(system, (0.5, 2.0), load=0.2, harmonics=31, tolerance=1e-8)
    assert branch.outcome == "completed"
    for i in (0, -1):
        point = vv.forced_response(
            system, [branch.nu[i]], load=0.2, method="newton", harmonics=31, tolerance=1e-8
        )
        np.testing.assert_allclose(point.coefficients[0], branch.coefficients[i], atol=1e-9)
    # Damping in the law itself stays when the coefficient c varies.
    swept = vv.trace_response(
        system, nu=1.2, vary="damping", vary_range=(0.05, 0.2), load=0.2, harmonics=31
    )
    other = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.2, forces="0.1*tanh(x_dot/0.5) + 0.02*x^3"
    )
    found = vv.forced_response(other, [1.2], load=0.2, method="newton", harmonics=31)
    np.testing.assert_allclose(swept.coefficients[-1], found.coefficients[0], atol=1e-8)


@pytest.mark.filterwarnings("ignore::viscovib.errors.ConvergenceWarning")
def test_van_der_pol_is_a_polynomial():
    """Polynomials with rates are sampled without aliasing: the balance is exact."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.2*(x^2 - 1)*x_dot")
    found = vv.forced_response(
        system, [1.1], load=2.0, method="newton", harmonics=5, stability=True
    )
    x, orders = found.coefficients[0, 0], found.harmonics
    theta = 2 * np.pi * np.arange(64) / 64
    waves = np.exp(1j * np.outer(orders, theta))
    u, v = (x @ waves).imag, ((1j * orders * 1.1 * x) @ waves).imag
    left = ((1 - (orders * 1.1) ** 2) * x @ waves).imag + 0.2 * (u**2 - 1) * v - 2 * np.sin(theta)
    np.testing.assert_allclose(left @ waves.conj().T / 64, 0, atol=1e-12)


def test_friction_of_a_mount_is_reported_in_its_force():
    """The force of a mount contains the rate part of its law."""
    mounts = [
        vv.MountPoint(
            name=name, position=[x, y, 0], stiffness=[1e4] * 3, damping=50, law="40*tanh(v/0.1)"
        )
        for name, x, y in (("a", 0.5, 0.3), ("b", -0.5, 0.3), ("c", 0.0, -0.4))
    ]
    body = vv.Body(mass=20, inertia=np.diag([2.0, 3, 4]), mounts=mounts)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        r = vv.forced_response(body, [20.0], load=[0, 0, 50, 0, 0, 0], method="newton")
    forces = body.mount_forces(r)
    total = forces.force[0].sum(axis=0)[2]
    x = r.coefficients[0, 2]
    inertia = -20 * (20.0 * r.harmonics) ** 2 * x
    load = 50.0 * (r.harmonics == 1)
    np.testing.assert_allclose(total + inertia, load, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "reported"),
    [
        (lambda: vv.Spring(on="x", law="tanh(w/2)"), r"did you mean v\?|'w' is neither"),
        (
            lambda: vv.Spring(on="x", law="v", parameters={"v": 1}),
            "must be a name, other than d, v",
        ),
        (lambda: vv.PolynomialSystem(mass=1, forces="abs(y_dot)"), "'y_dot' is neither"),
        (
            lambda: vv.backbone(
                vv.PolynomialSystem(mass=1, stiffness=1, forces="x_dot*abs(x_dot)"),
                mode=0,
                amplitude_range=(0.1, 1),
            ),
            "depend on rates",
        ),
    ],
)
def test_what_is_refused(make, reported):
    """One line that names the argument."""
    with pytest.raises(vv.InputError, match=reported):
        make()


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_branch_over_a_parameter_of_friction():
    """The end of a branch over a parameter of a rate law is the structure with that value."""

    def structure(c):
        law = "c*v + c*tanh(v/0.3) + 0.1*d^3"
        return vv.Structure(
            mass=[[1.0]], stiffness=[[1.0]], damping=[[0.05]],
            elements=[vv.Jenkins(on="x1", stiffness=0.1, limit=50),
                      vv.Spring(on="x1", law=law, parameters={"c": c})],
        )  # fmt: skip

    branch = vv.trace_response(
        structure(0.1), nu=1.3, vary="elements[1].c", vary_range=(0.1, 0.4), load=[0.3],
        harmonics=15,
    )  # fmt: skip
    found = vv.forced_response(structure(0.4), [1.3], load=[0.3], method="newton", harmonics=15)
    np.testing.assert_allclose(branch.coefficients[-1], found.coefficients[0], atol=1e-8)


@pytest.mark.parametrize("law", ["50*sqrt(d^2 + 0.01)*v", "10*d^3*v", "30*v^2*d", "40*tanh(v)"])
def test_strong_dampers_at_the_beginning(law):
    """Short panels in the first step, also in its halves, determine a velocity."""
    force = {
        "50*sqrt(d^2 + 0.01)*v": lambda d, v: 50 * np.sqrt(d * d + 0.01) * v,
        "10*d^3*v": lambda d, v: 10 * d**3 * v,
        "30*v^2*d": lambda d, v: 30 * v * v * d,
        "40*tanh(v)": lambda d, v: 40 * np.tanh(v),
    }[law]
    rng = np.random.default_rng(11)
    kernel = vv.PronyKernel(weights=[0.2, 0.3], rates=[5.0, 1.0])
    system = vv.Structure(
        mass=[1.0],
        stiffness=[1.0],
        elements=[vv.Spring(on="x1", law=law), vv.Spring(on="x1", stiffness=0.5, kernel=kernel)],
    )
    for _ in range(8):
        end, start = 10 ** rng.uniform(-2.5, -1.2), rng.uniform(0.3, 1, 2)

        def slope(t, y):
            pull = 0.5 * y[0]
            a = -y[0] - pull - force(*y[:2]) + y[2:].sum()
            return [y[1], a, 0.2 * pull - 5 * y[2], 0.3 * pull - y[3]]

        right = solve_ivp(
            slope, (0, end), [*start, 0, 0], "DOP853", rtol=3e-14, atol=1e-16, max_step=end / 20
        ).y
        run = vv.simulate(system, end, dt=end, initial=start, keep="last")
        assert np.abs(run.state[-1] - right[:2, -1]).max() < 1e-13, (end, start)
