"""Branches and responses with a given start: isolas, subharmonics, final motions."""

import numpy as np
import pytest
import viscovib as vv

#: Birth of the isola of this absorber (Detroux et al., arXiv 1604.05524, parameters of example 02
#: of NLvib): load and frequency of an independent program, to 10 and 7 digits.
BORN, NU_BORN = 0.1255119631, 1.793788
M, K = [1, 0.05], [[1.0453, -0.0453], [-0.0453, 0.0453]]
C = [[0.015, -0.013], [-0.013, 0.013]]


def absorber(condensed: bool) -> vv.PolynomialSystem | vv.Structure:
    if condensed:
        return vv.Structure(
            mass=M, stiffness=K, damping=C,
            elements=[vv.Spring(on="x1", law="d^3"),
                      vv.Spring(on=("x1", "x2"), law="0.0042*d^3")],
        )  # fmt: skip
    forces = {"x1": "x1^3 + 0.0042*(x1 - x2)^3", "x2": "0.0042*(x2 - x1)^3"}
    return vv.PolynomialSystem(mass=M, stiffness=K, damping=C, forces=forces)


@pytest.mark.parametrize("condensed", [False, True])
def test_isola(condensed: bool) -> None:
    """The birth is a fold in the load; a branch that starts on the isola closes."""
    system = absorber(condensed)
    load = 1.02 * BORN
    in_load = vv.trace_response(
        system, nu=NU_BORN, load_range=(0.01, 3), load=1.0, at=[load], stability=False
    )
    assert np.abs(in_load.folds / BORN - 1).min() < 1e-9
    assert in_load.stops.size == 3
    known = vv.trace_response(system, (0.5, 4), load=load, at=[NU_BORN], stability=False)
    assert known.stops.size == 1
    isola = vv.trace_response(
        system, (0.5, 4), load=load, start=(in_load, int(in_load.stops[-1])), stability=False
    )
    assert isola.outcome == "closed"
    assert isola.folds.size == 2
    assert isola.folds.min() < NU_BORN < isola.folds.max()
    # Points of a branch, harmonics by coordinate, and a response are starts too.
    x = isola.coefficients[3]
    harmonics = {int(k): x[:, j] for j, k in enumerate(isola.harmonics)}
    for start in ((isola, 3), harmonics):
        r = vv.forced_response(
            system, isola.nu[3] + np.array([0, 1e-3]), load=load, method="newton", start=start
        )
        assert np.abs(r.coefficients[0, :, 0] - x[:, 0]).max() < 1e-8


def test_subharmonic_of_the_end_of_a_motion_in_time() -> None:
    """A motion with three periods of the load, which a sweep never reaches."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces="x^3")
    nu = 1.4
    run = vv.simulate(
        system, t_end=600 * np.pi / nu, dt=0.01, load={3: 6.0}, nu=nu, initial=[1.4, 0.0],
        save_every=5,
    )  # fmt: skip
    r = vv.forced_response(system, [nu], load={3: 6.0}, method="newton", start=run)
    assert r.amplitude("x", 1)[0] > 0.3
    b = vv.trace_response(
        system, (nu, 1.5), load={3: 6.0}, start=run, stability=False, harmonics=21
    )
    assert abs(b.amplitude("x", 1)[0] / r.amplitude("x", 1)[0] - 1) < 1e-6


def test_a_structure_begins_at_the_end_of_its_motion() -> None:
    structure = absorber(True)
    nu = 1.1
    run = vv.simulate(structure, t_end=400 * np.pi / nu, dt=0.02, load=0.1, nu=nu)
    r = vv.forced_response(structure, [nu], load=0.1, method="newton", start=run)
    last = run.t >= run.t[-1] - 2 * np.pi / nu
    waves = np.exp(1j * np.outer(run.t[last], r.harmonics * nu))
    expected = (waves @ r.coefficients[0].T).imag
    assert np.abs(run.state[last][:, ::2] - expected).max() < 1e-3


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (3, r"start = 3: must be \(result, i\)"),
        ({}, "start = {}: must be"),
        ({1: [1.0]}, r"start\[1\]: must have shape \(2,\), got \(1,\)"),
        ({-1: [1.0, 0]}, "start order = -1: must be"),
        ({1: {"y": 1.0}}, "'y' is not a coordinate"),
    ],
)
def test_what_is_no_start(start: object, message: str) -> None:
    for call in (
        lambda: vv.trace_response(absorber(False), (1, 2), load=0.1, start=start),
        lambda: vv.forced_response(absorber(True), [1], load=0.1, method="newton", start=start),
    ):
        with pytest.raises(vv.InputError, match=message):
            call()
    with pytest.raises(vv.InputError, match="start: needs method = 'newton'"):
        vv.forced_response(absorber(True), [1], load=0.1, method="successive", start=start)
