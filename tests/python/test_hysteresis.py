"""Hysteresis and gaps in periodic motions: loops, steady motions, multipliers, published values."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

pytestmark = pytest.mark.filterwarnings("ignore:.*do not reach the tolerance.*")

NU = 1.3
PERIOD = 2 * np.pi / NU


def joint(exponent=2):
    return vv.BoucWen(on="x1", stiffness=2.0, ratio=0.2, beta=1.5, gamma=0.5, exponent=exponent)


def single(element):
    return vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]], elements=[element])


def bouc_wen(t, y):
    x, v, z = y
    rate = v * (1 - (0.5 + 1.5 * np.sign(v * z)) * z**2)
    return [v, np.cos(NU * t) - 0.1 * v - 1.4 * x - 1.6 * z, rate]


def moved(rhs, start, periods=1, rtol=1e-11):
    run = solve_ivp(rhs, (0, periods * PERIOD), start, "DOP853", rtol=rtol, atol=1e-13)
    return run.y[:, -1]


@pytest.mark.parametrize("exponent", [1, 2, 1.5, 1.1, 2.3, 5.7])
def test_a_loop_of_bouc_and_wen(exponent):
    """Each part by the steps of SciPy, and its work, to 1e-12 of the largest force."""
    element, z, force, lost = joint(exponent), 0.0, [], 0.0
    d = [0.0, 1.2, -0.4, 0.9, -1.5]
    for _ in range(12):
        force, lost = [], 0.0
        for i, now in enumerate(d):
            last = d[i - 1]
            way = np.sign(now - last)
            path = solve_ivp(
                lambda _, y, way=way: [
                    way * (1 - (0.5 + 1.5 * np.sign(way * y[0])) * abs(y[0]) ** exponent),
                    way * 1.6 * y[0],
                ],
                (0, abs(now - last)), [z, 0.0], "DOP853", rtol=3e-14, atol=1e-15,
            )  # fmt: skip
            z = path.y[0, -1]
            lost += path.y[1, -1]
            force.append(0.4 * now + 1.6 * z)
    smooth = 1e-12 if exponent == int(exponent) else 1e-9
    np.testing.assert_allclose(element.loop(d), force, atol=2 * smooth)
    assert element.energy(d) == pytest.approx(lost, abs=5 * smooth)


@pytest.mark.parametrize(("beta", "gamma"), [(1.0, 1.0), (0.7, 0.3), (2.0, -1.2), (1.0, 0.9)])
def test_squared_states_follow_tangents(beta, gamma):
    """Exponent 2: unloading by tan(q x)/q, loading by tanh(x), in units of the largest state."""
    largest, q = (beta + gamma) ** -0.5, np.sqrt((beta - gamma) / (beta + gamma))
    element = vv.BoucWen(on="x1", stiffness=1.0, ratio=0, beta=beta, gamma=gamma, exponent=2)
    back = np.arctan(q) / q if q > 0 else 1.0
    down = np.tan(0.4 * q * back) / q if q > 0 else 0.4
    d = largest * np.array([-40, 40, 40 - 0.6 * back, 40 - back - 0.8])
    force = element.loop(d) / largest
    np.testing.assert_allclose(force, [-1, 1, down, -np.tanh(0.8)], atol=1e-12)
    # Each direction unloads to 0 and loads again.
    unloading = np.log1p(q**2) / (2 * q**2) if q > 0 else 0.5
    energy = 2 * (np.log(np.cosh(60 - back)) - unloading) * largest**2
    assert element.energy(largest * np.array([-30, 30])) == pytest.approx(energy, rel=1e-12)


def test_steady_motion_of_bouc_and_wen():
    """Harmonics by SciPy within the stated truncation; three multipliers by differences."""
    start = moved(bouc_wen, [0.0, 0, 0], 40)
    run = solve_ivp(
        bouc_wen, (0, PERIOD), start, "DOP853", rtol=1e-11, atol=1e-13, dense_output=True
    )
    x = np.fft.rfft(run.sol(np.arange(256) * PERIOD / 256)[0]) / 128
    errors = []
    for orders in (7, 31):
        found = vv.forced_response(
            single(joint()), [NU], load=[1.0], method="newton", harmonics=orders, stability=True
        )
        own = found.coefficients[0, 0]
        error = max(abs(abs(own[found.harmonics == k][0]) - abs(x[k])) for k in (1, 3))
        assert error < found.truncation[0] * abs(x[1])
        errors.append(error)
    assert errors[1] < 2e-8 < errors[0]
    h = 1e-4
    steps = [moved(bouc_wen, start + h * e) - moved(bouc_wen, start - h * e) for e in np.eye(3)]
    expected = np.linalg.eigvals(np.array(steps).T / (2 * h))
    multipliers = np.sort_complex(found.multipliers[0][:3])
    np.testing.assert_allclose(multipliers, np.sort_complex(expected), atol=3e-6)


def test_multipliers_of_sliders():
    """A sliding slider has the multiplier 0; a sticking slider is a spring."""
    slides = vv.Jenkins(on="x1", stiffness=2.0, limit=0.5)
    found = vv.forced_response(
        single(slides), [NU, 5.0], load=[1.0], method="newton", harmonics=15, stability=True
    )
    assert found.stable.tolist() == [True, True]
    assert found.multipliers[0][2] == 0
    s = np.roots([1, 0.1, 3.0])
    expected = np.exp(2 * np.pi / 5.0 * s)
    own = found.multipliers[1][:2]
    np.testing.assert_allclose(np.sort_complex(own), np.sort_complex(expected), rtol=1e-10)


@pytest.mark.parametrize(("nu", "limit", "peak"),
                         [(0.8, 0.2, 2.7114152554), (1.2, 0.3, 2.072384268)])  # fmt: skip
def test_den_hartog(nu, limit, peak):
    """Den Hartog's closed form without sticking: the order, its estimate, and the limit."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, forces="R*sign(x_dot)", parameters={"R": limit}
    )
    theta = np.linspace(0, 2 * np.pi, 20001)
    errors = {}
    for orders in (49, 99, 199):
        found = vv.forced_response(
            system, [nu], load=[1.0], method="newton", harmonics=orders, tolerance=1e-9
        )
        x, u = found.coefficients[0, 0], np.zeros(theta.size)
        for k, c in zip(found.harmonics, x, strict=True):
            u += (c * np.exp(1j * k * theta)).imag
        errors[orders] = np.ptp(u) / 2 / peak - 1
        assert abs(errors[orders]) < 1.3 * found.truncation[0] < 10 * abs(errors[orders])
    assert abs(errors[199]) < 1.5e-4
    # First-order convergence, so two results give the limit.
    assert errors[99] / errors[199] == pytest.approx(200 / 100, rel=0.02)
    assert abs(2 * errors[199] - errors[99]) < 1e-6


def test_branch_with_a_gap():
    """Example 03 of NLvib (Krack and Gross): period doubling and Neimark-Sacker points."""
    stiffness = np.array([[1.0, -1], [-1, 2]])
    system = vv.PolynomialSystem(
        mass=[1, 1], stiffness=stiffness, damping=0.03 * stiffness,
        forces={"x1": "k*max(x1 - gap, 0)"}, parameters={"k": 100.0, "gap": 1.0},
    )  # fmt: skip
    branch = vv.trace_response(system, (0.8, 0.5), load=[0, 0.1], harmonics=63, tolerance=1e-9)
    places = {}
    for one in branch.crossings:
        places.setdefault(one.kind, []).append(one.parameter)
    assert [len(places[kind]) for kind in ("fold", "period doubling", "Neimark-Sacker")] == [2] * 3
    # Published with five digits.
    assert places["period doubling"][0] == pytest.approx(0.75559, abs=5e-5)
    assert places["Neimark-Sacker"][0] == pytest.approx(0.61861, abs=5e-5)
    # Contact begins where the linear motion has the amplitude 1.
    omega = places["fold"][0]
    d = stiffness * (1 + 0.03j * omega) - omega**2 * np.eye(2)
    assert abs(np.linalg.solve(d, [0, 0.1])[0]) == pytest.approx(1, abs=1e-3)


def test_parameters_of_laws_vary():
    """A branch over a parameter of a law passes through motions of systems with that value."""

    def system(c):
        return vv.PolynomialSystem(
            mass=1, stiffness=1, forces="c*tanh(x_dot/0.5) + k3*x^3",
            parameters={"c": c, "k3": 0.1},
        )  # fmt: skip

    branch = vv.trace_response(
        system(0.2),
        vary="c",
        vary_range=(0.2, 0.6),
        nu=1.2,
        load=[1.0],
        harmonics=15,
        stability=False,
    )
    assert branch.outcome == "completed"
    i = branch.parameter.size // 2
    alone = vv.forced_response(
        system(float(branch.parameter[i])), [1.2], load=[1.0], method="newton", harmonics=15
    )
    np.testing.assert_allclose(
        branch.coefficients[i, 0, branch.harmonics == 1],
        alone.coefficients[0, 0, alone.harmonics == 1], rtol=1e-8,
    )  # fmt: skip
    with pytest.raises(vv.InputError, match="or a parameter of its forces, c, k3"):
        vv.trace_response(system(0.2), vary="d", vary_range=(0.2, 0.6), nu=1.2, load=[1.0])


def test_an_iwan_is_its_sliders():
    """Separate elements in parallel give the same motion."""
    k, limit = [1.0, 2.0, 0.5], [0.2, 0.7, 0.6]
    one = single(vv.Iwan(on="x1", stiffness=k, limit=limit))
    several = vv.Structure(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]],
        elements=[vv.Jenkins(on="x1", stiffness=a, limit=b) for a, b in zip(k, limit, strict=True)],
    )  # fmt: skip
    given = {"load": [1.0], "method": "newton", "harmonics": 15}
    found = [vv.forced_response(s, [NU], **given).coefficients for s in (one, several)]
    np.testing.assert_allclose(found[0], found[1], atol=1e-10)


@pytest.mark.parametrize(
    ("call", "reported"),
    [
        (lambda: vv.Iwan(on=0, stiffness=[1, 2], limit=[1]), "limit: must have one value"),
        (lambda: vv.Iwan(on=0, stiffness=[1, 0], limit=[1, 1]), r"stiffness\[1\] = 0: must be"),
        (lambda: vv.BoucWen(on=0, stiffness=1, beta=0, gamma=2), "beta = 0: must be greater"),
        (lambda: vv.BoucWen(on=0, stiffness=1, beta=1, gamma=0, ratio=1), "ratio = 1: must be in"),
        (lambda: vv.BoucWen(on=0, stiffness=1, beta=1, gamma=0, exponent=0.5), "exponent = 0.5"),
        (lambda: vv.Dahl(on=0, stiffness=1, limit=1, exponent=-1), "exponent = -1: must be 0"),
        (lambda: vv.Gap(on=0, stiffness=0, gap=1), "stiffness = 0: must be greater"),
        (lambda: vv.Stop(on=0, stiffness=1, gap=-1), "gap = -1: must be at least 0"),
    ],
)
def test_what_is_refused(call, reported):
    """One line that names the argument."""
    with pytest.raises(vv.InputError, match=reported):
        call()
