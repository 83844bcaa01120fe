"""Stability of structures, counted by their elements, against multipliers of the full system."""

import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import solve_ivp
from scipy.linalg import expm

pytestmark = pytest.mark.filterwarnings("ignore:.*do not reach the tolerance")


def test_cheaper_judge_is_taken():
    """Monodromy matrices without memory, unless there are many coordinates per force."""

    def cubic(n, q, kernel=None):
        places = [f"x{i + 1}" for i in range(q)]
        springs = [
            vv.Springs(stiffness=np.eye(n)),
            vv.Springs(forces={x: f"{x}^3" for x in places}, kernel=kernel),
        ]
        return vv.PolynomialSystem(mass=np.ones(n), springs=springs)

    kernel = vv.PronyKernel(weights=[0.3], rates=[1.5])
    for n, q, judged in [(5, 1, False), (6, 1, True), (6, 2, True), (7, 3, False), (8, 4, True)]:
        assert cubic(n, q)._condenses(True) == judged
        assert cubic(n, q)._condenses(False)
        assert cubic(n, q, kernel)._condenses(True)
    assert not cubic(3, 1)._condenses(False)
    assert not cubic(8, 5)._condenses(False)


@pytest.mark.parametrize(
    ("n", "square", "cubic", "zeta", "load", "span", "kinds"),
    [
        (4, 0.75, 0.82, 0.018, 0.33, (1.5, 2.6), {"fold": 2, "Neimark-Sacker": 4}),
        (2, 1.11, 0.78, 0.018, 0.52, (1.5, 2.6), {"fold": 2, "period doubling": 2}),
        (2, 0.0, 1.12, 0.011, 3.74, (0.25, 0.8),
         {"fold": 4, "branch point": 2, "symmetry breaking": 2}),
    ],
)  # fmt: skip
def test_crossings_of_all_kinds_are_located(n, square, cubic, zeta, load, span, kinds):
    """Bifurcations at the locations given by the multipliers of the full system."""
    k = np.diag(np.linspace(1.5, 2.5, n)) - 0.6 * (np.eye(n, k=1) + np.eye(n, k=-1))
    squares, shapes = np.linalg.eigh(k)
    w, end = np.sqrt(squares), f"x{n}"
    given = {
        "mass": np.eye(n), "stiffness": k, "damping": shapes * (2 * zeta * w) @ shapes.T,
    }  # fmt: skip
    spring = vv.Spring(on=end, law=f"{square}*d^2 + {cubic}*d^3")
    structure = vv.Structure(**given, elements=[spring])
    whole = vv.PolynomialSystem(**given, forces={end: f"{square}*{end}^2 + {cubic}*{end}^3"})
    whole.__dict__["_condensation"] = None
    one, other = (
        vv.trace_response(
            system, (span[0] * w[0], span[1] * w[0]), load=np.eye(n)[-1] * load, harmonics=15,
            max_points=600,
        )
        for system in (structure, whole)
    )  # fmt: skip
    names = [crossing.kind for crossing in one.crossings]
    assert {kind: names.count(kind) for kind in names} == kinds
    assert names == [crossing.kind for crossing in other.crossings]
    places = [[crossing.parameter for crossing in branch.crossings] for branch in (one, other)]
    assert places[0] == pytest.approx(places[1], rel=1e-10)


@pytest.mark.parametrize("n", [5, 12])
@pytest.mark.parametrize("proportional", ["mass", "stiffness"])
def test_slowest_exponents_of_few_modes(n: int, proportional: str) -> None:
    """For a small load the exponents are the slowest ones of the linear system."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    damping = 0.02 * (stiffness if proportional == "stiffness" else np.eye(n))
    elements = [vv.Spring(on=f"x{n}", law="0.5*d^3")]
    system = vv.Structure(mass=np.eye(n), stiffness=stiffness, damping=damping, elements=elements)
    squares = np.linalg.eigvalsh(stiffness)
    rates = np.diag(squares if proportional == "stiffness" else np.ones(n)) * 0.02
    first_order = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(squares), -rates]])
    nu = np.linspace(0.8, 1.3, 6) * np.sqrt(squares[0])
    motions = vv.forced_response(
        system, nu, load=1e-6 * np.eye(n)[0], method="newton", harmonics=3, stability=True
    )
    assert motions.stable.all()
    assert motions.slowest.all()
    expected = np.sort(np.linalg.eigvals(first_order).real)[::-1]
    for exponents in motions.exponents:
        found = exponents[~np.isnan(exponents)]
        # Two for each element and four more.
        assert found.size >= 6
        assert found.real == pytest.approx(expected[: found.size], abs=1e-8)


def monodromy(stiffness, damping, place, law, nu, orders, coefficients, steps=400):
    """The matrix of perturbations over a period, by a method of order 4 (Blanes and Moan 2006)."""
    n, h = len(stiffness), 2 * np.pi / nu / steps
    still = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])

    def at(t):
        matrix = still.copy()
        u = (np.exp(1j * nu * orders * t) @ coefficients[place]).imag
        matrix[n + place, place] -= np.polyval(np.polyder(law), u)
        return matrix

    whole, apart = np.eye(2 * n), np.sqrt(3) / 6
    for k in range(steps):
        early, late = (at((k + 0.5 + sign * apart) * h) for sign in (-1, 1))
        inner, outer = (0.25 + apart) * h, (0.25 - apart) * h
        whole = expm(outer * early + inner * late) @ expm(inner * early + outer * late) @ whole
    return whole


@pytest.mark.parametrize("seed", range(2))
def test_the_slowest_of_many_modes_that_decay_alike_is_not_lost(seed):
    """The line of the count may lie between a zero and its approximation."""
    rng = np.random.default_rng(seed)
    n, place, law = 10, 9, [0.281, 0.3, 0.0, 0.0]
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    damping = 1.1467170808588345e-4 * stiffness + 0.001 * np.eye(n)
    load, span = {"x4": 0.006108024583832597}, (0.5815810182026409, 1.0800790338049047)
    if seed > 0:
        n = int(rng.integers(6, 11))
        place, law = int(rng.integers(n)), [rng.uniform(0.1, 1), rng.choice([0, 0.3]), 0.0, 0.0]
        stiffness = stiffness[:n, :n]
        damping = 10 ** rng.uniform(-4.3, -3) * stiffness + 0.001 * np.eye(n)
        first = np.sqrt(np.linalg.eigvalsh(stiffness)[rng.integers(4)])
        load, span = {f"x{rng.integers(n) + 1}": 0.01}, (0.8 * first, 1.2 * first)
    text = f"{float(law[0])!r}*d^3 + {float(law[1])!r}*d^2"
    system = vv.Structure(
        mass=np.eye(n), stiffness=stiffness, damping=damping,
        elements=[vv.Spring(on=f"x{place + 1}", law=text)],
    )  # fmt: skip
    branch = vv.trace_response(
        system, span, load=load, harmonics=5, stability=True, coordinates=list(system.dof_names)
    )
    points = np.linspace(0.4, 0.95, 5) * branch.nu.size
    for j in points.astype(int):
        assert branch.slowest[j]
        exact = monodromy(
            stiffness, damping, place, law, branch.nu[j], np.array(branch.harmonics),
            branch.coefficients[j],
        )  # fmt: skip
        largest = np.abs(np.linalg.eigvals(exact)).max()
        assert np.nanmax(np.abs(branch.multipliers[j])) == pytest.approx(largest, abs=1e-7)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_multipliers_of_friction_in_thin_layers(seed):
    """Friction smoothed by tanh on one coordinate, a hardening spring on another one."""
    rng = np.random.default_rng(seed)
    n, width = int(rng.integers(3, 8)), rng.choice([0.02, 0.1])
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    damping = 0.02 * stiffness + np.diag(rng.uniform(0, 0.1, n) * (seed % 2))
    (slider, spring), sizes = rng.choice(n, 2, replace=False), rng.uniform(0.1, 0.8, 2)
    force, cubic = sizes.tolist()
    structure = vv.Structure(
        mass=np.ones(n), stiffness=stiffness, damping=damping,
        elements=[
            vv.Spring(on=f"x{slider + 1}", law=f"{force!r}*tanh(v/{width})"),
            vv.Spring(on=f"x{spring + 1}", law=f"{cubic!r}*d^3"),
        ],
    )  # fmt: skip
    nu = 1.1 * np.sqrt(np.linalg.eigvalsh(stiffness)[1])
    found = vv.forced_response(
        structure, [nu], load={f"x{slider + 1}": 3 * force}, method="newton", harmonics=9,
        stability=True, coordinates=structure.names,
    )  # fmt: skip
    motion, orders = found.coefficients[0], np.asarray(found.harmonics)

    def slopes(t, y):
        at, waves = y.reshape(2 * n, 2 * n), np.exp(1j * nu * orders * t)
        springs, drags = stiffness.copy(), damping.copy()
        speed = (motion[slider] @ (1j * nu * orders * waves)).imag
        drags[slider, slider] += force / width / np.cosh(speed / width) ** 2
        springs[spring, spring] += 3 * cubic * (motion[spring] @ waves).imag ** 2
        return np.vstack([at[n:], -springs @ at[:n] - drags @ at[n:]]).ravel()

    period = 2 * np.pi / nu
    whole = solve_ivp(
        slopes, (0, period), np.eye(2 * n).ravel(), method="DOP853", rtol=1e-10, atol=1e-12,
        max_step=period / 300,
    )  # fmt: skip
    expected = np.linalg.eigvals(whole.y[:, -1].reshape(2 * n, 2 * n))
    multipliers = found.multipliers[0][np.isfinite(found.multipliers[0])]
    assert multipliers.size >= 8
    for one in multipliers:
        assert np.abs(expected - one).min() < 1e-8
