"""Basins of attraction, against single motions and closed forms."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

GRID = np.linspace(-1.5, 1.5, 12)


def test_two_wells():
    """Two equilibria; a start and its mirror image settle at mirror images."""
    wells = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
    found = vv.basins(wells, {"x": GRID, "x_dot": GRID}, t_end=100.0)
    assert found.complete
    assert sorted(round(float(a[0, 0]), 6) for a in found.attractors) == [-1.0, 1.0]
    np.testing.assert_array_equal(found.labels[::-1, ::-1], 1 - found.labels)
    well = np.array([a[0, 0] for a in found.attractors])
    for j, i in ((0, 3), (5, 11), (7, 2), (10, 8)):
        run = solve_ivp(
            lambda t, y: [y[1], -0.3 * y[1] + y[0] - y[0] ** 3], (0, 150), [GRID[i], GRID[j]],
            rtol=1e-9, atol=1e-10,
        )  # fmt: skip
        assert well[found.labels[j, i]] == pytest.approx(run.y[0, -1], abs=1e-6)
    assert found.to_dataset()["label"].shape == (12, 12)


def test_a_saddle_attracts_nothing():
    """Starts on a saddle or on its stable manifold do not settle."""
    wells = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
    grid = np.linspace(-1.5, 1.5, 7)
    found = vv.basins(wells, {"x": grid, "x_dot": grid}, t_end=100.0)
    assert len(found.attractors) == 2
    assert (found.labels == -1).sum() == 1
    assert found.labels[3, 3] == -1
    assert not found.complete


@pytest.mark.parametrize("memory", [False, True])
def test_what_creeps_has_not_settled(memory):
    """Regression: starts that move less than the tolerance per check are not attractors."""
    given = {}
    if memory:
        kernel = vv.PronyKernel(weights=[0.3], rates=[1.0])
        given = {"springs": [vv.Springs(stiffness=0.3, kernel=kernel)]}
    starts = {"x": [-1.2, -0.3, 0.4, 1.3], "x_dot": [-0.5, 0.5]}
    slow = vv.PolynomialSystem(mass=1, stiffness=-1, damping=1e4, forces="x^3 + 0.05", **given)
    found = vv.basins(slow, starts, t_end=0.5, dt=1e-4 if memory else "auto")
    assert not found.attractors
    assert (found.labels == -1).all()


@pytest.mark.parametrize(
    "joint",
    [vv.Jenkins(on="x1", stiffness=0.5, limit=0.1), vv.Dahl(on="x1", stiffness=0.5, limit=0.1)],
)
def test_what_creeps_with_hysteresis_has_not_settled(joint):
    """Neighbouring starts stay apart, both when friction holds them and when they creep."""
    starts = {"x1": [-1.2, 0.4], "x1_dot": [-0.5, 0.5]}

    def found(damping, end, dt):
        wells = vv.Structure(
            mass=[1.0], stiffness=[-1.0], damping=[damping],
            elements=[vv.Spring(on="x1", law="d^3"), joint],
        )  # fmt: skip
        return vv.basins(wells, starts, t_end=end, dt=dt)

    creeping = found(1e4, 0.5, 1e-3)
    assert not creeping.attractors
    assert (creeping.labels == -1).all()
    assert found(0.3, 100.0, 0.05).complete


def test_structures_have_basins():
    """A structure with few coordinates equals the polynomial system with the same equations."""
    beam = vv.Structure(
        mass=[[1.0]], stiffness=[[-1.0]], damping=[[0.3]], elements=[vv.Spring(on="x1", law="d^3")]
    )
    wells = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
    one = vv.basins(beam, {"x1": GRID, "x1_dot": GRID}, t_end=60.0, dt=0.1)
    other = vv.basins(wells, {"x": GRID, "x_dot": GRID}, t_end=60.0, dt=0.1)
    np.testing.assert_array_equal(one.labels, other.labels)


def test_two_amplitudes_of_a_duffing_oscillator():
    """The attractors are the stable responses; single motions agree with the grid."""
    duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    grid = np.linspace(-3, 3, 8)
    call = {"load": 0.3, "nu": 1.4}
    found = vv.basins(duffing, {"x": grid, "x_dot": grid}, n_periods=150, **call)
    assert [a.shape for a in found.attractors] == [(1, 2), (1, 2)]
    assert found.share.sum() == pytest.approx(1)
    for j, i in ((0, 0), (3, 3), (6, 1)):
        run = vv.simulate(
            duffing, 150 * 2 * np.pi / 1.4, initial=[grid[i], grid[j]], dt=0.05, keep="last", **call
        )
        np.testing.assert_allclose(
            found.attractors[found.labels[j, i]][0], run.state[-1], atol=1e-3
        )


def test_three_magnets():
    """A pendulum over three magnets: three attractors with intertwined basins."""
    places = [(float(np.cos(a)), float(np.sin(a))) for a in 2 * np.pi * np.arange(3) / 3]

    def pull(mine):
        parts = []
        for x, y in places:
            r = f"((x1 - ({x!r}))^2 + (x2 - ({y!r}))^2 + 0.09)^1.5"
            parts.append(f"({'x1' if mine == 0 else 'x2'} - ({(x, y)[mine]!r}))/{r}")
        return " + ".join(parts)

    magnets = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[0.5, 0.5], damping=[0.3, 0.3],
        forces={"x1": pull(0), "x2": pull(1)},
    )  # fmt: skip
    grid = np.linspace(-1.2, 1.2, 5)
    found = vv.basins(magnets, {"x1": grid, "x2": grid}, t_end=100.0, tolerance=1e-3, dt=0.05)
    assert len(found.attractors) == 3
    # The centre has the same distance from all magnets: this equilibrium is a saddle.
    assert [tuple(at) for at in np.argwhere(found.labels < 0)] == [(2, 2)]
    # Each attractor is near its magnet.
    for states in found.attractors:
        place = states[0, [0, 2]]
        assert min(np.hypot(*(place - at)) for at in places) < 0.15
    mirrored = {
        i: int(
            np.argmin(
                [np.abs(b[0, [0, 2]] - a[0, [0, 2]] * [1, -1]).sum() for b in found.attractors]
            )
        )
        for i, a in enumerate(found.attractors)
    }
    mirrored |= {-1: -1, -2: -2}
    # Near the boundaries rounding may decide; the axis of symmetry is excluded.
    upper, lower = found.labels[:2], found.labels[:2:-1]
    same = np.vectorize(mirrored.get)(lower) == upper
    assert same.mean() > 0.9


def test_a_pendulum_without_a_load_comes_to_rest():
    """From starts without rotation, within the given run time."""
    swing = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.1, c2=0.1, c3=0.1)
    found = vv.basins(swing, {"phi": [-0.5, 0.5], "psi": [0.2, 0.4]}, t_end=600)
    assert found.complete
    np.testing.assert_allclose(found.attractors[0], 0, atol=1e-9)
    early = vv.basins(swing, {"phi": [0.1, 0.5], "psi": [0.2, 0.4]}, t_end=5)
    assert repr(early).endswith("psi 0.2 to 0.4>")
    with pytest.raises(vv.InputError, match="t_end: must be given without a load"):
        vv.basins(swing, {"phi": [0.1], "psi": [0.2]})


def test_bad_calls():
    """One-line messages."""
    wells = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
    for starts, given, words in (
        ({"x": GRID}, {"t_end": 10}, "two of"),
        ({"x": GRID, "y": GRID}, {"t_end": 10}, "'y'"),
        ({"x": GRID, "x_dot": GRID}, {"n_periods": 10}, "t_end"),
        ({"x": GRID, "x_dot": GRID}, {"load": 1, "nu": 1, "t_end": 10}, "n_periods"),
        ({"x": GRID, "x_dot": GRID}, {"load": 1, "nu": 1, "n_periods": 9}, "n_periods"),
    ):
        with pytest.raises(vv.InputError, match=words):
            vv.basins(wells, starts, **given)


def test_what_starts_and_ends_at_rest_between():
    """The other mass starts and ends at 0: its scale is the motion in between."""
    chain = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[[1.9, -1.1], [-1.1, 1.1]], damping=[0.2, 0.2], forces={"x1": "x1^3"}
    )
    found = vv.basins(chain, {"x1": GRID, "x1_dot": GRID}, t_end=120.0)
    assert found.complete
    np.testing.assert_allclose(found.attractors, 0, atol=1e-4)


def test_what_leaves_within_the_last_look():
    """From 1 the solution of x'' = x^3 diverges at 1.854, after t_end."""
    away = vv.PolynomialSystem(mass=1, forces="-x^3")
    found = vv.basins(away, {"x": [0.1, 1.0], "x_dot": [0.0]}, t_end=1.8, dt=0.005)
    np.testing.assert_array_equal(found.labels, [[-1, -2]])


def test_how_sure_labels_and_attractors_are():
    """Change of the motion, and remaining fraction of a perturbation: closed forms."""
    one = vv.PolynomialSystem(mass=1, stiffness=4, damping=0.2)
    found = vv.basins(one, {"x": [0.0, 0.5], "x_dot": [1.0]}, t_end=120.0)
    assert found.complete
    # A perturbation decays like exp(-0.1 t), for any phase, times the ratio of its components.
    assert 0.3 * np.exp(-12) < found.rest[0] < 4 * np.exp(-12)
    assert (found.moved < 2 * np.exp(-12)).all()
    assert (found.moved > 1e-8).all()
    away = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="-x^3")
    found = vv.basins(away, {"x": [0.0, 2.0], "x_dot": [0.1]}, t_end=100.0)
    np.testing.assert_array_equal(found.labels, [[0, -2]])
    np.testing.assert_array_equal(np.isnan(found.moved), [[False, True]])
