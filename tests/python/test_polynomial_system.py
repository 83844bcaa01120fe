"""Polynomial systems against shooting by scipy, closed forms and the mount."""

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import solve_ivp
from scipy.linalg import eigvals
from scipy.optimize import brentq, root

matplotlib.use("Agg")

KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])
BODY = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}


def chain(n, cubic=0.2, damping=0.05, **changes):
    """Equal masses between walls, each spring with a cubic part in its own stretch."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    names = ["0", *(f"x{i + 1}" for i in range(n)), "0"]
    forces = {
        names[
            i
        ]: f"{cubic}*({names[i]} - {names[i - 1]})^3 + {cubic}*({names[i]} - {names[i + 1]})^3"
        for i in range(1, n + 1)
    }
    given = {"mass": np.ones(n), "stiffness": stiffness, "damping": damping * stiffness}
    given["names"] = names[1:-1]
    return vv.PolynomialSystem(**(given | {"forces": forces} | changes))


def periodic(right, start, period):
    """Shooting: the state at time 0 of a periodic solution, by scipy alone."""

    def after(y):
        return solve_ivp(right, (0, period), y, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]

    found = root(lambda y: after(y) - y, start, tol=1e-13)
    assert np.abs(found.fun).max() < 1e-11
    return found.x


def state_at_zero(r, i=0):
    x, k = r.coefficients[i], r.harmonics
    return np.concatenate([x.sum(axis=1).imag, (1j * k * r.nu[i] * x).sum(axis=1).imag])


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("memory", [False, True])
def test_the_mount_is_one_of_them(memory):
    kernel = KERNEL if memory else None
    damping = 0.02 * STIFFNESS
    mount = vv.Mount(**BODY, kernel=kernel, damping=damping)
    same = vv.PolynomialSystem(
        mass=[1, 0.1],
        stiffness=STIFFNESS,
        damping=damping,
        kernel=kernel,
        forces={"x": "5/6*phi^3", "phi": "2.5*phi^2*x - 5/3*phi^3"},
        names=("x", "phi"),
        units=("m", "rad"),
    )
    nu = np.linspace(0.5, 10, 80)
    for method in ("linear", "successive", "newton"):
        a = vv.forced_response(mount, nu, load=0.2, method=method, tolerance=1e-13)
        b = vv.forced_response(same, nu, load=0.2, method=method, tolerance=1e-13)
        assert (a.outcome == b.outcome).all()
        assert a.coefficients == pytest.approx(b.coefficients, abs=1e-13, nan_ok=True)
    a = vv.trace_response(mount, (0.5, 10), load=0.5, tolerance=1e-13)
    b = vv.trace_response(same, (0.5, 10), load=0.5, tolerance=1e-13)
    assert a.folds == pytest.approx(b.folds, abs=1e-13)
    assert a.coefficients == pytest.approx(b.coefficients, abs=1e-10)
    if not memory:
        assert np.abs(a.multipliers) == pytest.approx(np.abs(b.multipliers), abs=1e-9)
    assert same.natural_frequencies() == pytest.approx(mount.natural_frequencies(), rel=1e-14)
    shapes = mount.mode_shapes()
    assert same.mode_shapes()[1] / same.mode_shapes()[0] == pytest.approx(shapes[1], rel=1e-12)
    assert same.dynamic_stiffness(nu) == pytest.approx(mount.dynamic_stiffness(nu), abs=1e-12)
    one, other = mount.characteristic_roots(), same.characteristic_roots()
    assert one.oscillatory == pytest.approx(other.oscillatory, abs=1e-13)
    assert one.real == pytest.approx(other.real, rel=1e-12)
    assert (one.n_unstable, one.complete) == (other.n_unstable, other.complete)


@pytest.mark.parametrize("nu", [0.7, 1.0, 1.6])
def test_duffing_against_shooting(nu):
    system = vv.PolynomialSystem(mass=1.3, stiffness=1.1, damping=0.1, forces="0.5*x^3 + 0.1*x^5")
    r = vv.forced_response(system, nu, load=0.4, method="newton", harmonics=41, tolerance=1e-13)
    assert (r.harmonics % 2 == 1).all()

    def motion(t, y):
        u, v = y
        return [v, (0.4 * np.sin(nu * t) - 0.1 * v - 1.1 * u - 0.5 * u**3 - 0.1 * u**5) / 1.3]

    start = state_at_zero(r)
    assert periodic(motion, start, 2 * np.pi / nu) == pytest.approx(start, abs=1e-11)


def test_helmholtz_duffing_has_a_mean():
    """Even powers: every order and a mean, and no two halves of a period alike."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="0.4*x^2 + 0.5*x^3")
    nu, load = 1.1, {1: 0.3 + 0.1j, 2: 0.05}
    r = vv.forced_response(system, nu, load=load, method="newton", harmonics=31, tolerance=1e-13)
    assert r.harmonics.tolist() == list(range(32))
    assert "even" not in str(r.plan)

    def motion(t, y):
        u, v = y
        force = 0.3 * np.sin(nu * t) + 0.1 * np.cos(nu * t) + 0.05 * np.sin(2 * nu * t)
        return [v, force - 0.1 * v - u - 0.4 * u**2 - 0.5 * u**3]

    start, period = state_at_zero(r), 2 * np.pi / nu
    assert periodic(motion, start, period) == pytest.approx(start, abs=1e-11)
    times = period * np.arange(512) / 512
    path = solve_ivp(motion, (0, period), start, "DOP853", times, rtol=1e-13, atol=1e-14).y[0]
    assert r.coefficient("x", 0)[0] == pytest.approx(1j * path.mean(), abs=1e-12)
    assert abs(path.mean()) > 0.01
    gentle = vv.forced_response(system, 0.4, load={1: 0.05}, tolerance=1e-13)
    newton = vv.forced_response(system, 0.4, load={1: 0.05}, method="newton", tolerance=1e-13)
    assert gentle.coefficients == pytest.approx(newton.coefficients, abs=1e-14)


@pytest.mark.parametrize(("quadratic", "cubic"), [(0.0, 0.3), (0.0, -0.3), (0.5, 0.0), (0.4, 0.7)])
def test_backbone_of_small_amplitudes(quadratic, cubic):
    """Peak at omega_0 + (3 cubic/8 - 5 quadratic^2/12) a^2: Nayfeh and Mook (1979), section 2.3."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=1e-4, forces=f"{quadratic}*x^2 + {cubic}*x^3"
    )
    slopes = []
    for load in (2e-6, 4e-6):
        peak = vv.trace_response(
            system, (0.99, 1.01), load=load, max_step=0.01, stability=False
        ).peak("x")
        slopes.append((peak.nu - 1) / peak.amplitude**2)
    expected = 3 * cubic / 8 - 5 * quadratic**2 / 12
    assert slopes[1] == pytest.approx(expected, rel=0.02)


def test_absorber_transfer_function():
    """Den Hartog: x_1/P of a damped mass with a damped absorber, written out."""
    m, k, c, m_2, k_2, c_2 = 1.0, 1.0, 0.02, 0.05, 0.045, 0.012
    system = vv.PolynomialSystem(
        mass=[m, m_2],
        stiffness=[[k + k_2, -k_2], [-k_2, k_2]],
        damping=[[c + c_2, -c_2], [-c_2, c_2]],
        names=("body", "absorber"),
    )
    nu = np.linspace(0.3, 2, 300)
    link = k_2 + 1j * nu * c_2
    below = (k + 1j * nu * c + link - m * nu**2) * (link - m_2 * nu**2) - link**2
    r = vv.forced_response(system, nu, load=1.0)
    assert r.method == "linear"
    assert r.coefficient("body") == pytest.approx((link - m_2 * nu**2) / below, rel=1e-12)
    assert r.coefficient("absorber") == pytest.approx(link / below, rel=1e-12)
    # A moving base instead: the ground spring and damper pull.
    moving = vv.PolynomialSystem(
        mass=[m, m_2],
        stiffness=[[k + k_2, -k_2], [-k_2, k_2]],
        damping=[[c_2, -c_2], [-c_2, c_2]],
        base_direction=[1, 1],
    )
    r = vv.forced_response(moving, nu, base=0.1)
    below = (k + link - m * nu**2) * (link - m_2 * nu**2) - link**2
    assert r.coefficient("x1") == pytest.approx(0.1 * k * (link - m_2 * nu**2) / below, rel=1e-11)


def test_memory_of_the_mean():
    """At rest under a constant load a kernel leaves 1 - its integral of every force."""
    kernel = vv.RzhanitsynKernel(amplitude=0.2, alpha=0.5, beta=0.7)
    system = vv.PolynomialSystem(
        mass=1, kernel=kernel, forces="x + 0.3*x^2 + 0.5*x^3", springs=[vv.Springs(stiffness=0.4)]
    )
    kept = 1 - 0.2 * np.sqrt(np.pi / 0.7)
    assert kernel.integral == pytest.approx(1 - kept, rel=1e-14)
    expected = brentq(
        lambda x: kept * (x + 0.3 * x**2 + 0.5 * x**3) + 0.4 * x - 0.8, 0, 5, xtol=1e-15
    )
    for method in ("newton", "successive"):
        r = vv.forced_response(
            system, 0.9, load={0: 0.8j}, method=method, relaxation=0.5, tolerance=1e-13
        )
        assert r.coefficient("x", 0)[0] == pytest.approx(1j * expected, rel=1e-12)
        assert np.abs(r.coefficients[0, 0, 1:]).max() < 1e-13


def test_memory_on_some_forces_only():
    """R(t) = w exp(-r t) is one more differential equation: z' = w g(u) - r z, (1 - R*) g = g - z.

    One kernel on the linear spring, another on the cubic one, none on the quadratic one.
    """
    weights, rates, nu = (0.3, 0.2), (0.5, 1.5), 1.3
    kernels = [vv.PronyKernel(weights=[w], rates=[r]) for w, r in zip(weights, rates, strict=True)]
    system = vv.PolynomialSystem(
        mass=1.2,
        stiffness=1.5,
        kernel=kernels[0],
        damping=0.05,
        springs=[vv.Springs(forces="0.8*x^3", kernel=kernels[1]), vv.Springs(forces="0.3*x^2")],
    )
    r = vv.forced_response(system, nu, load=0.6, method="newton", harmonics=31, tolerance=1e-13)

    def motion(t, y):
        u, v, z_1, z_2 = y
        linear, cubic = 1.5 * u, 0.8 * u**3
        force = 0.6 * np.sin(nu * t) - 0.05 * v - (linear - z_1) - (cubic - z_2) - 0.3 * u**2
        slow = np.multiply(weights, (linear, cubic)) - np.multiply(rates, (z_1, z_2))
        return [v, force / 1.2, *slow]

    start = np.concatenate([state_at_zero(r), [0, 0]])
    assert periodic(motion, start, 2 * np.pi / nu)[:2] == pytest.approx(start[:2], abs=1e-11)
    branch = vv.trace_response(system, (0.5, 2), load=0.6)
    assert branch.stable.dtype == bool
    assert branch.outcome == "completed"


def test_twenty_masses():
    system, nu = chain(20), 0.31
    r = vv.forced_response(system, nu, load=0.3, method="newton", harmonics=31, tolerance=1e-12)
    start, stiffness = state_at_zero(r), np.asarray(system.stiffness)

    def motion(t, y):
        u, v = y[:20], y[20:]
        stretch = np.diff(np.concatenate([[0], u, [0]]))
        force = -np.diff(0.2 * stretch**3) + stiffness @ (u + 0.05 * v)
        force[0] -= 0.3 * np.sin(nu * t)
        return np.concatenate([v, -force])

    after = solve_ivp(motion, (0, 2 * np.pi / nu), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert after == pytest.approx(start, abs=1e-8)
    assert np.abs(start).max() > 0.1


@pytest.mark.parametrize("n", [1, 3, 4, 5, 7])
def test_multipliers_at_rest_are_exponentials(n):
    system = chain(n, damping=0.03)
    branch = vv.trace_response(system, (0.7, 0.8), load=0.0)
    stiffness = np.asarray(system.stiffness)
    first = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -0.03 * stiffness]])
    expected = np.exp(eigvals(first) * 2 * np.pi / 0.7)
    found = branch.multipliers[0]
    distance = np.abs(found[:, np.newaxis] - expected)
    # Steps that turn the fastest mode by 0.6 rad at most leave some 1e-9.
    assert distance.min(axis=0).max() < 2e-9
    assert distance.min(axis=1).max() < 2e-9
    assert branch.stable.all()


def test_stability_of_seven_masses_against_integration():
    n, nu = 7, 0.45
    system = chain(n, cubic=0.5)
    branch = vv.trace_response(system, (nu, 0.46), load=0.6, harmonics=45, tolerance=1e-12)
    x, k = branch.coefficients[0], branch.harmonics
    start = np.concatenate([x.sum(axis=1).imag, (1j * k * nu * x).sum(axis=1).imag])
    stiffness = np.asarray(system.stiffness)

    def motion(t, y):
        y = y.reshape(2 * n, -1)
        u, v = y[:n], y[n:]
        stretch = np.diff(np.concatenate([0 * u[:1], u, 0 * u[:1]]), axis=0)
        force = -np.diff(0.5 * stretch**3, axis=0) + stiffness @ (u + 0.05 * v)
        force[0] -= 0.6 * np.sin(nu * t)
        return np.concatenate([v, -force]).ravel()

    h = 1e-5
    many = start[:, np.newaxis] + h * np.hstack([np.eye(2 * n), -np.eye(2 * n)])
    after = solve_ivp(
        motion, (0, 2 * np.pi / nu), many.ravel(), "DOP853", rtol=1e-12, atol=1e-13
    ).y[:, -1].reshape(2 * n, -1)  # fmt: skip
    matrix = (after[:, : 2 * n] - after[:, 2 * n :]) / (2 * h)
    expected = eigvals(matrix)
    distance = np.abs(branch.multipliers[0][:, np.newaxis] - expected)
    assert distance.min(axis=0).max() < 1e-7


def test_characteristic_roots_of_three_masses_with_memory():
    w, r = 0.3, 0.4
    system = chain(3, kernel=vv.PronyKernel(weights=[w], rates=[r]))
    stiffness = np.asarray(system.stiffness)
    zero, one = np.zeros((3, 3)), np.eye(3)
    large = np.block(
        [[zero, one, zero], [-stiffness, -0.05 * stiffness, one], [w * stiffness, zero, -r * one]]
    )
    upper = np.array([s for s in eigvals(large) if s.imag > 1e-6])
    roots = system.characteristic_roots()
    assert roots.oscillatory == pytest.approx(upper[np.argsort(upper.imag)], rel=1e-11)
    assert (roots.n_unstable, roots.complete) == (0, True)


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_roots_where_rest_is_unstable():
    """The double well: a real root for leaving the hill; no natural frequency there."""
    system = vv.PolynomialSystem(mass=2, stiffness=-1, damping=0.1, forces="x^3")
    roots = system.characteristic_roots()
    assert roots.real == pytest.approx(np.sort(np.roots([2, 0.1, -1]))[::-1], rel=1e-13)
    assert (roots.n_unstable, roots.complete) == (1, True)
    with pytest.raises(vv.InputError, match="rest is unstable"):
        system.natural_frequencies()
    # With a mean load in one of the wells.
    r = vv.forced_response(system, 3.0, load={0: 0.1j, 1: 0.05}, method="newton")
    assert r.converged.all()
    gyroscopic = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[[1, 0.05], [-0.05, 1.2]], damping=[[0, 0.3], [-0.3, 0]]
    )
    assert gyroscopic.natural_frequencies().size == 2
    creeping = chain(3, kernel=vv.PronyKernel(weights=[1.1], rates=[1]))
    assert creeping.characteristic_roots().n_unstable == 3
    assert creeping.characteristic_roots().complete


@pytest.mark.parametrize("method", ["gauss8", "gauss16", "gauss3", "dop8", "verner9", "rk4"])
def test_motion_in_time(method):
    system = vv.PolynomialSystem(
        mass=[[1, 0.1], [0.1, 0.5]],
        stiffness=[[2, -1], [-1, 1.5]],
        damping=[0.05, 0.02],
        forces={"x1": "(x1 - x2)^3 + 0.2*x1^2", "x2": "(x2 - x1)^3"},
    )
    nu, start = 1.3, [0.3, 0.1, -0.2, 0.4]
    load = {0: [0.1j, 0], 1: [0.5, 0.1 + 0.2j], 3: [0, 0.1j]}

    def motion(t, y):
        u, v = y[::2], y[1::2]
        cubic = (u[0] - u[1]) ** 3
        force = -np.array([2 * u[0] - u[1], -u[0] + 1.5 * u[1]]) - [0.05, 0.02] * v
        force -= [cubic + 0.2 * u[0] ** 2, -cubic]
        force += [0.1 + 0.5 * np.sin(nu * t), 0.1 * np.sin(nu * t) + 0.2 * np.cos(nu * t)]
        force += [0, 0.1 * np.cos(3 * nu * t)]
        a = np.linalg.solve([[1, 0.1], [0.1, 0.5]], force)
        return [v[0], a[0], v[1], a[1]]

    end = solve_ivp(motion, (0, 20), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    fine = {"rk4": 2e-3, "gauss3": 2e-2}.get(method, 0.05)
    run = vv.simulate(system, 20, dt=fine, initial=start, load=load, nu=nu, method=method)
    assert run.outcome == "completed"
    assert run.state[-1] == pytest.approx(end, abs=1e-9 if method in ("rk4", "gauss3") else 1e-11)
    assert np.abs(run.energy_defect()).max() < 1e-6
    more = vv.simulate(system, 40, resume=run)
    whole = vv.simulate(system, 40, dt=fine, initial=start, load=load, nu=nu, method=method)
    assert (more.state[-1] == whole.state[-1]).all()


def test_motion_with_memory_in_time():
    """Kernels of one exponential each are differential equations: z' = w g(u) - r z."""
    weights, rates, nu = (0.3, 0.2), (0.5, 1.5), 1.3
    kernels = [vv.PronyKernel(weights=[w], rates=[r]) for w, r in zip(weights, rates, strict=True)]
    system = vv.PolynomialSystem(
        mass=1.2,
        stiffness=1.5,
        kernel=kernels[0],
        damping=0.05,
        springs=[vv.Springs(forces="0.8*x^3", kernel=kernels[1]), vv.Springs(forces="0.3*x^2")],
        base_direction=[1],
    )

    def motion(t, y):
        u, v, z_1, z_2 = y
        linear, cubic = 1.5 * u, 0.8 * u**3
        # A base moving as 0.1 cos(nu t) pushes by -m times its acceleration.
        force = 0.6 * np.sin(nu * t) + 0.12 * nu**2 * np.cos(nu * t)
        force -= 0.05 * v + (linear - z_1) + (cubic - z_2) + 0.3 * u**2
        slow = np.multiply(weights, (linear, cubic)) - np.multiply(rates, (z_1, z_2))
        return [v, force / 1.2, *slow]

    run = vv.simulate(
        system, 20, initial=[0.5, 0.2], load=0.6, base=0.1j, nu=nu, tolerance=1e-11
    )  # fmt: skip
    end = solve_ivp(
        motion, (0, 20), [0.4, 0.2, 0, 0], "DOP853", rtol=1e-13, atol=1e-14
    ).y[:2, -1]  # fmt: skip
    moved = [0.1 * np.cos(nu * 20), -0.1 * nu * np.sin(nu * 20)]
    assert run.state[-1] == pytest.approx(end + moved, abs=1e-10)
    with pytest.raises(vv.InputError, match="the balance of energy is for pendulums only"):
        run.energy_defect()


def test_both_ways_in_time_agree():
    """Without memory, through the methods of a pendulum and through those with memory."""
    start = 0.3 * np.sin(np.arange(10.0))
    load = {1: [0.2, 0, 0, 0, 0.1j]}
    one = vv.simulate(chain(5), 15, initial=start, load=load, nu=0.7, tolerance=1e-11)
    # A base at rest, which only the other way takes.
    other = vv.simulate(
        chain(5, base_direction=np.ones(5)), 15, initial=start, load=load, base={1: 0.0}, nu=0.7,
        tolerance=1e-11,
    )  # fmt: skip
    assert "evaluations" in one.stats
    assert "iterations" in other.stats
    assert one.state[-1] == pytest.approx(other.state[-1], abs=1e-10)
    many = vv.simulate(chain(12), 5, initial=np.zeros(24), load=0.1, nu=0.5, tolerance=1e-9)
    assert many.state.shape[1] == 24
    assert many.outcome == "completed"


def test_steps_are_found_and_tables_written(tmp_path):
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.1, forces="x_1^3", names=["x_1"], units=["mm"]
    )
    run = vv.simulate(system, 50, initial=[1, 0], load=0.3, nu=1.1, tolerance=1e-9)
    r = vv.forced_response(system, 1.1, load=0.3, method="newton", harmonics=25)
    long = vv.simulate(system, 600, initial=state_at_zero(r), load=0.3, nu=1.1, keep="last")
    u, v = (np.exp(1j * r.nu[0] * 600 * r.harmonics) * x for x in (1, 1j * 1.1 * r.harmonics))
    expected = [(r.coefficients[0, 0] * part).sum().imag for part in (u, v)]
    assert long.state[-1] == pytest.approx(expected, abs=1e-9)
    run.to_csv(tmp_path / "run.csv")
    assert "# units: t in s, x_1 in mm" in (tmp_path / "run.csv").read_text()
    data = run.to_dataset()
    assert data["x_1_dot"].attrs["units"] == "mm/s"
    assert len(vv.plot_trajectory(run)) == 2
    r.to_csv(tmp_path / "r.csv")
    assert "x_1_1_re" in (tmp_path / "r.csv").read_text()
    assert r.to_dataset().unit.values.tolist() == ["mm"]
    branch = vv.trace_response(system, (0.5, 2), load=0.3)
    branch.to_csv(tmp_path / "b.csv")
    vv.plot_branch(branch)
    figure = vv.plot_response(vv.forced_response(system, [0.5, 0.6], load=0.3))[0].figure
    figure.savefig(tmp_path / "r.png")
    vv.plot_trajectory(vv.simulate(chain(2), 1, initial=np.zeros(4)))[0].figure.savefig(
        tmp_path / "t.png"
    )
    matplotlib.pyplot.close("all")


def test_energy_needs_a_potential():
    system = chain(3, damping=0.0)
    state = np.array([0.3, 0.1, -0.2, 0.4, 0.5, 0.0])
    u, v = state[::2], state[1::2]
    stretch = np.diff(np.concatenate([[0], u, [0]]))
    expected = (v @ v + (stretch**2).sum()) / 2 + 0.05 * (stretch**4).sum()
    assert system.energy(state) == pytest.approx(expected, rel=1e-14)
    odd = vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 1], forces={"x1": "x2^3"})
    with pytest.raises(vv.InputError, match=r"x2\^3 on x1 has no potential"):
        odd.energy(np.zeros(4))
    with pytest.raises(vv.InputError, match="energy is not defined with memory"):
        chain(2, kernel=KERNEL).energy(np.zeros(4))


def test_monomials_and_texts_say_the_same():
    by_text = chain(2)
    listed = [
        vv.Monomial(coefficient=c, powers=powers, on=on)
        for on, rows in (("x1", 0), (1, 1))
        for c, powers in (
            [(0.4, {"x1": 3}), (-0.6, (2, 1)), (0.6, {"x1": 1, "x2": 2}), (-0.2, [0, 3])]
            if rows == 0
            else [(-0.2, (3, 0)), (0.6, (2, 1)), (-0.6, (1, 2)), (0.4, (0, 3))]
        )
    ]
    by_list = chain(2, forces=listed)
    nu = np.linspace(0.3, 2, 20)
    a = vv.forced_response(by_text, nu, load=0.1, method="newton")
    b = vv.forced_response(by_list, nu, load=0.1, method="newton")
    assert a.coefficients == pytest.approx(b.coefficients, abs=1e-14)


def test_harmonics_are_as_many_as_needed():
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="0.5*x^2 + 0.5*x^3")
    r = vv.forced_response(system, [0.8, 1.0], load=0.5, method="newton", harmonics="auto")
    assert r.truncation.max() <= 1e-10
    assert 9 < r.harmonics[-1] < 60
    # A coordinate that stands still, and many of them.
    idle = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[1, 2], damping=[0.2, 0.2], forces={"x1": "x1^3", "x2": "x2^3"}
    )
    assert vv.forced_response(
        idle, 1.0, load=0.5, method="newton", harmonics="auto"
    ).harmonics[-1] < 60  # fmt: skip
    r = vv.forced_response(chain(20), 0.5, load=0.5, method="newton", harmonics="auto")
    assert r.truncation.max() <= 1e-10


DUFFING = {"mass": 1, "stiffness": 1, "forces": "x^3"}
TWO = {"mass": [1, 1], "stiffness": [1, 1]}


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"mass": 0}, "mass: must be symmetric and positive definite"),
        ({"mass": [[1, 2], [2, 1]]}, "mass: must be symmetric and positive definite"),
        ({"mass": np.ones((2, 3))}, "mass: must have shape"),
        ({"mass": np.ones(65)}, "mass: 65 coordinates, must be 1 to 64"),
        ({"mass": []}, "mass: 0 coordinates"),
        ({"mass": np.nan}, "mass = nan: must be a finite number"),
        (DUFFING | {"stiffness": [1, 2]}, "stiffness: must have shape (1,) or (1, 1), got (2,)"),
        (DUFFING | {"damping": np.ones((2, 2))}, "damping: must have shape"),
        (DUFFING | {"kernel": 1}, "kernel = 1: must be a Kernel or None"),
        (DUFFING | {"names": "x"}, "names = 'x': must be a sequence of 1 texts"),
        (DUFFING | {"names": ["2x"]}, "names: '2x' must be letters, digits and _"),
        (TWO | {"names": ["a", "a"]}, "names = a, a: must differ"),
        (TWO | {"units": ["m"]}, "units = ['m']: must be 2 texts"),
        (TWO | {"base_direction": [1]}, "base_direction: must have shape (2,), got (1,)"),
        (TWO | {"forces": "x1^3"}, "forces = 'x1^3': must say on which equation"),
        (TWO | {"forces": {"y": "x1^3"}}, "equation 'y' must be one of 'x1' (0), 'x2' (1)"),
        (TWO | {"forces": {"x1": 3}}, "forces['x1'] = 3: must be a text"),
        (TWO | {"forces": {"x1": "z^2"}}, "forces['x1']: unknown coordinate 'z', must be one of"),
        (TWO | {"forces": {"x1": "x1_dot^3"}}, "x1_dot is a velocity, and forces depend on"),
        (TWO | {"forces": {"x1": "x1 x2"}}, "must be a polynomial such as 2*x^3"),
        (TWO | {"forces": {"x1": "sin(x1)"}}, "must be a polynomial such as 2*x^3"),
        (TWO | {"forces": {"x1": "x1^1.5"}}, "powers must be whole numbers"),
        (TWO | {"forces": {"x1": "x1^-1"}}, "powers must be whole numbers"),
        (TWO | {"forces": {"x1": "x1^x2"}}, "powers must be whole numbers"),
        (TWO | {"forces": {"x1": "1/x1"}}, "must be divided by numbers other than 0 only"),
        (TWO | {"forces": {"x1": "x1/0"}}, "must be divided by numbers other than 0 only"),
        (TWO | {"forces": {"x1": "x1^16"}}, "degree of x1^16 must be at most 15"),
        (TWO | {"forces": {"x1": "3 + x1^2"}}, "has the constant 3, which belongs to the load"),
        (TWO | {"forces": {"x1": "1e999*x1^2"}}, "must have finite coefficients"),
        (TWO | {"forces": {"x1": "x1^1e999"}}, "powers must be whole numbers"),
        (TWO | {"forces": {"x1": "(" * 5000 + "x1" + ")" * 5000}}, "must be a polynomial"),
        (TWO | {"forces": {"x1": "x1+" * 9000}}, "characters, must be at most 20000"),
        (TWO | {"forces": [1]}, "forces[0] = 1: must be a Monomial"),
        (TWO | {"forces": 1}, "forces = 1: must be a text, a mapping or Monomials"),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers=(2,), on=0)]},
            "forces[0].powers: has 1 powers, must be 2",
        ),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers={"y": 2}, on=0)]},
            "forces[0].powers: unknown coordinate 'y'",
        ),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers=(2, 0), on=2)]},
            "forces[0].on: equation 2 must be one of",
        ),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers=(15, 1), on=0)]},
            "forces[0].powers: degree 16, must be at most 15",
        ),
        (TWO | {"springs": vv.Springs(stiffness=1)}, "springs: must be a sequence of Springs"),
        (TWO | {"springs": [1]}, "springs[0] = 1: must be Springs"),
        (TWO | {"springs": [vv.Springs(stiffness=1)]}, "springs[0].stiffness: must have shape"),
    ],
)
def test_bad_systems_are_named(given, text):
    with pytest.raises(vv.InputError) as error:
        vv.PolynomialSystem(**given)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("work", "text"),
    [
        (lambda s: vv.forced_response(s, 1, base=0.1), "base: this system has no base_direction"),
        (lambda s: vv.forced_response(s, 1, load=[1, 2]), "must be a number or have shape (1,)"),
        (
            lambda s: vv.forced_response(chain(20), 1, load=1, method="newton", harmonics=199),
            "harmonics = 199: makes 4000 unknowns with 20 coordinates, must be at most 2000",
        ),
        (
            lambda s: vv.trace_response(
                chain(20), (0.1, 1), load=1, max_points=100_000, harmonics=49
            ),
            "max_points = 100000: must be at most",
        ),
        (lambda s: vv.simulate(s, 1, initial=[0, 0], load=1), "must be greater than 0 with a load"),
        (lambda s: vv.simulate(s, 1, initial=[0, 0], load=1, nu=0), "nu = 0: must be greater"),
        (lambda s: vv.simulate(s, 1, initial=[0, 0, 0]), "initial: must have shape (2,), got (3,)"),
        (
            lambda s: vv.simulate(chain(7), 1, initial=np.zeros(14), method="dop8"),
            "method = 'dop8': must be one of",
        ),
        (
            lambda s: vv.simulate(chain(2, kernel=KERNEL), 1, method="dop8"),
            "method = 'dop8': must be one of",
        ),
        (
            lambda s: vv.simulate(s, 1, base=0.1, nu=1),
            "base: this system has no base_direction",
        ),
        (lambda s: vv.simulate(s, 1, held=[1, 2]), "held: must have shape (1,), got (2,)"),
        (
            lambda s: vv.forced_response(
                vv.PolynomialSystem(
                    mass=1, forces="x + x^2", kernel=vv.AbelKernel(amplitude=0.1, alpha=0.5)
                ),
                1, load=0.1, method="newton",
            ),
            "a kernel has no finite integral",
        ),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_bad_jobs_are_named(work, text):
    with pytest.raises(vv.InputError) as error:
        work(vv.PolynomialSystem(**DUFFING))
    assert text in str(error.value)


def test_creep_is_told():
    with pytest.warns(vv.StabilityWarning, match="kernel integral = 2 >= 1"):
        vv.PolynomialSystem(**DUFFING, kernel=vv.PronyKernel(weights=[2], rates=[1]))


def test_huge_motions_overflow_in_words():
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.01, forces="x^15")
    with pytest.warns(vv.ConvergenceWarning):
        r = vv.forced_response(system, [0.5, 1.0], load=1e30, method="successive")
    assert not r.converged.any()
    run = vv.simulate(system, 10, dt=0.5, initial=[1e3, 0])
    assert run.outcome == "diverged"


def test_period_doubling_in_a_well():
    """Period 2 sets in near f = 0.266 in the well of x'' + 0.3 x' - x + x^3 = f cos(1.2 t).

    Below it motion about x = 1 repeats each period, above it every second one; Floquet multipliers
    must say where. The equation is that of Guckenheimer and Holmes (1983), section 2.2.
    """
    system = vv.PolynomialSystem(mass=1, stiffness=2, damping=0.3, forces="3*x^2 + x^3")
    nu = 1.2
    branch = vv.trace_response(system, nu=nu, load_range=(0, 0.3), load=1j, harmonics=25)
    assert [crossing.kind for crossing in branch.crossings] == ["period doubling"]
    i = branch.crossings[0].before
    real = branch.multipliers[i : i + 2, 0].real
    onset = np.interp(1, -real, branch.load_factor[i : i + 2])
    period = 2 * np.pi / nu
    for factor, repeats in ((0.98 * onset, 1), (1.02 * onset, 2)):
        near = int(np.abs(branch.load_factor - factor).argmin())
        x, k = branch.coefficients[near, 0], branch.harmonics
        start = [x.sum().imag + 1e-3, (1j * k * nu * x).sum().imag]
        run = vv.simulate(
            system, 1500 * period, initial=start, load=1j * factor, nu=nu, dt=period / 40,
            save_every=40, keep="tail", tail=3.5 * period,
        )  # fmt: skip
        once, twice = np.abs(run.state[-1] - run.state[-2:-4:-1]).max(axis=1)
        assert twice < 1e-9
        assert (once < 1e-9) == (repeats == 1)


def residual(system, load, nu, orders, x, oversampling):
    """Harmonics of M u'' + C u' + sum_g (1 - R_g*) [K_g u + f_g] - load, by numpy.fft."""
    n = x.shape[0]
    samples = oversampling * (int(orders.max()) + 1)
    u = (np.exp(2j * np.pi * np.outer(np.arange(samples) / samples, orders)) @ x.T).imag
    mass, damping = np.asarray(system.mass), np.asarray(system.damping)
    total = (1j * orders * nu) ** 2 * (mass @ x) + 1j * orders * nu * (damping @ x)
    size = np.abs(total).max()
    for group in system.groups:
        force = u @ group.stiffness.T
        for (on, powers), c in group.forces.items():
            force[:, on] += c * np.prod(u ** np.array(powers), axis=1)
        spectrum = 2j * np.fft.fft(force, axis=0)[orders].T / samples
        spectrum[:, orders == 0] = 0.5j * spectrum[:, orders == 0].imag
        kept = 1 if group.kernel is None else 1 - group.kernel.transform(orders * nu)
        total = total + kept * spectrum
        size = max(size, np.abs(spectrum).max())
    for j, k in enumerate(orders):
        total[:, j] -= load.get(int(k), np.zeros(n))
    return np.abs(total).max() / size


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("seed", range(30))
def test_solutions_of_random_systems_satisfy_their_equations(seed):
    rng = np.random.default_rng(seed)
    n, degree = int(rng.integers(1, 5)), int(rng.choice([3, 5, 8]))
    kernels = [
        None,
        vv.PronyKernel(weights=[0.4 * rng.random()], rates=[0.5 + rng.random()]),
        vv.RzhanitsynKernel(amplitude=0.1 * rng.random(), alpha=0.3, beta=0.2),
    ]

    def springs():
        root = rng.normal(size=(n, n))
        monomials = []
        for _ in range(int(rng.integers(1, 5))):
            factors = rng.integers(n, size=int(rng.integers(2, degree + 1)))
            powers = np.bincount(factors, minlength=n).tolist()
            c = float(rng.normal() * 10 ** rng.uniform(-2, 1))
            monomials.append(vv.Monomial(coefficient=c, powers=powers, on=int(rng.integers(n))))
        kernel = kernels[int(rng.integers(3))]
        return vv.Springs(stiffness=root @ root.T + np.eye(n), forces=monomials, kernel=kernel)

    root = rng.normal(size=(n, n))
    system = vv.PolynomialSystem(
        mass=root @ root.T + 0.3 * np.eye(n),
        damping=0.1 * np.ones(n),
        springs=[springs(), springs()],
    )
    load = {1: 0.1 * rng.normal(size=n) + 0j, 2: 0.05j * rng.normal(size=n)}
    if seed % 2:
        load[0] = 0.1j * rng.normal(size=n)
    found = 0
    for method in ("newton", "successive"):
        r = vv.forced_response(
            system, np.geomspace(0.3, 3, 6), load=load, method=method, harmonics=9, tolerance=1e-12
        )
        for i in np.flatnonzero(r.converged):
            x = r.coefficients[i]
            assert residual(system, load, r.nu[i], r.harmonics, x, 2 * degree + 2) < 1e-10
            found += 1
    assert found >= 6
