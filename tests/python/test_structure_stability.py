"""Stability of structures, counted by their elements, against multipliers of the full system."""

import numpy as np
import pytest
import viscovib as vv
from scipy.linalg import expm

pytestmark = pytest.mark.filterwarnings("ignore:.*do not reach the tolerance")


def both(n: int, law: str, zeta: float = 0.01) -> tuple[vv.PolynomialSystem, vv.Structure]:
    """A chain, one end fixed, with a law at the other."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    stiffness[-1, -1] = 1
    squares, shapes = np.linalg.eigh(stiffness)
    damping = shapes @ np.diag(2 * zeta * np.sqrt(squares)) @ shapes.T
    end = f"x{n}"
    whole = vv.PolynomialSystem(
        mass=np.ones(n), stiffness=stiffness, damping=damping, forces={end: law.replace("d", end)}
    )
    elements = [vv.Spring(on=end, law=law)]
    structure = vv.Structure(
        mass=np.ones(n), stiffness=stiffness, damping=damping, elements=elements
    )
    return whole, structure


@pytest.mark.parametrize(
    ("law", "n", "zeta"), [("0.4*d^3", 3, 0.001), ("0.2*d^2 + 0.3*d^3", 6, 0.02)]
)
def test_growing_motions_are_those_of_the_whole(n: int, law: str, zeta: float) -> None:
    whole, structure = both(n, law, zeta)
    first = whole.natural_frequencies()[0]
    load = np.zeros(n)
    load[-1] = 0.4 * zeta
    given = {"load": load, "harmonics": 9, "stability": True}
    b = vv.trace_response(structure, (0.6 * first, 1.5 * first), **given)
    assert (np.array(b.stable) == False).any()  # noqa: E712
    for parameter in [c.parameter for c in b.crossings if c.kind == "fold"]:
        assert np.abs(b.folds / parameter - 1).min() < 1e-6
    nu = np.linspace(0.6, 1.5, 12) * first
    a, c = (vv.forced_response(s, nu, method="newton", **given) for s in (whole, structure))
    assert (a.converged & c.converged).sum() > 8
    for i in np.flatnonzero(a.converged & c.converged):
        if abs(a.coefficients[i] - c.coefficients[i]).max() > 1e-8:
            continue
        assert a.stable[i] == c.stable[i]
        seen = c.multipliers[i][~np.isnan(c.multipliers[i])]
        if seen.size:
            assert np.abs(a.multipliers[i][:, None] - seen).min(axis=0).max() < 1e-7


@pytest.mark.parametrize("seed", range(3))
def test_judged_condensed_and_whole(seed, monkeypatch):
    """Systems with few coordinates: growing perturbations as by the full equations."""
    rng = np.random.default_rng(seed)
    n, kernel = 4 + seed % 3, vv.PronyKernel(weights=[0.3], rates=[1.5])
    k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    tip = np.zeros((n, n))
    tip[-1, -1] = rng.uniform(0.2, 0.6)
    system = vv.PolynomialSystem(
        mass=rng.uniform(0.5, 2, n), damping=0.02 * k,
        springs=[vv.Springs(stiffness=k),
                 vv.Springs(stiffness=tip, forces={f"x{n}": f"0.6*x{n}^3"}, kernel=kernel)],
    )  # fmt: skip
    load = np.eye(n)[0] * rng.uniform(0.1, 0.3)
    first = system.natural_frequencies()[0]

    def motions():
        return vv.forced_response(
            system, np.linspace(0.6, 1.6, 16) * first, load=load, method="newton", harmonics=7,
            stability=True,
        )  # fmt: skip

    assert system._condenses(True)
    condensed = motions()
    monkeypatch.setattr(vv.PolynomialSystem, "_condenses", lambda *_: False)
    whole = motions()
    same = np.abs(condensed.coefficients - whole.coefficients).max(axis=(1, 2)) < 1e-9
    assert same.sum() > 8
    assert (condensed.stable[same] == whole.stable[same]).all()
    assert all(one is not None for one in condensed.stable[same])


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
    for n, q, judged in [(7, 1, False), (8, 1, True), (8, 2, True), (8, 4, False), (14, 4, True)]:
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


def test_many_orders_keep_the_digits_of_exponents():
    """Two joints with a hundred harmonics: Hill's determinant needs as many."""
    n = 6
    cuts = np.diff(np.eye(n), axis=0)
    k = 0.38 * cuts.T @ cuts
    k[0, 0] += 0.57
    c, e = 0.008 * np.eye(n), np.eye(n)
    structure = vv.Structure(
        mass=np.ones(n), stiffness=k, damping=c,
        elements=[vv.Spring(on="x6", stiffness=0.09, law="0.02*d^2 + 1.4*d^3"),
                  vv.Spring(on="x5", stiffness=0.11, law="0.02*d^2 + 2.7*d^3")],
    )  # fmt: skip
    whole = vv.PolynomialSystem(
        mass=np.ones(n), stiffness=k + 0.09 * np.outer(e[5], e[5]) + 0.11 * np.outer(e[4], e[4]),
        damping=c, forces={"x6": "0.02*x6^2 + 1.4*x6^3", "x5": "0.02*x5^2 + 2.7*x5^3"},
    )  # fmt: skip
    whole.__dict__["_condensation"] = None
    nu = [0.1, 0.12, 0.19, 0.2]
    given = {"load": 0.3 * e[4], "method": "newton", "stability": True}
    a, b = (vv.forced_response(s, nu, **given) for s in (structure, whole))
    assert a.highest.max() > 70
    sizes = [np.nanmax(np.abs(r.multipliers), axis=1) for r in (a, b)]
    assert (np.array(a.stable) == np.array(b.stable)).all()
    assert np.abs(sizes[0] / sizes[1] - 1).max() < 2e-9


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
