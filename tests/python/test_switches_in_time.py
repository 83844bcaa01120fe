"""Elements that switch in time, hysteresis, rigid stops: against SciPy and closed forms."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

GRAVITY = 9.81


def body(*elements, k=1.0, c=0.05, n=1):
    """Masses of 1 on springs to the ground, with elements."""
    eye = np.eye(n)
    return vv.Structure(mass=eye, stiffness=k * eye, damping=c * eye, elements=list(elements))


def ball(restitution):
    """A ball above a rigid floor at 0."""
    return body(vv.Gap(on={"x1": -1}, gap=0.0, restitution=restitution), k=0.0, c=0.0)


@pytest.mark.parametrize("e", [0.0, 0.5, 0.8, 0.95])
def test_infinitely_many_impacts(e):
    """They end at t_0 (1 + e)/(1 - e), with t_0 the time of the first fall; then the ball rests."""
    fall = np.sqrt(2 / GRAVITY)
    end = fall * (1 + e) / (1 - e)
    run = vv.simulate(
        ball(e), 1.2 * end + 1, dt=0.05, initial=[1.0, 0.0], load={0: -1j * GRAVITY}, nu=1.0
    )
    assert run.outcome == "completed"
    assert run.resting_since[0, 0] == pytest.approx(end, abs=2e-12)
    assert np.isnan(run.resting_since[0, 1])
    assert run.state[:, 0].min() > -1e-14
    after = run.state[run.t > end]
    assert np.abs(after).max() < 1e-14
    # Before, each flight is a parabola with a height of e^(2 n).
    t = run.t[run.t < end - 1e-6]
    n = np.floor(np.log1p(-(t - fall) * (1 - e) / (2 * e * fall)) / np.log(e)) if e else 0 * t - 1
    n = np.where(t < fall, -1, n)
    begin = np.where(n < 0, 0, fall * (1 + 2 * e * (1 - e ** np.maximum(n, 0)) / (1 - e)))
    speed = np.where(n < 0, 0.0, GRAVITY * fall * e ** (n + 1.0))
    height = np.where(n < 0, 1.0, 0.0) + speed * (t - begin) - GRAVITY * (t - begin) ** 2 / 2
    np.testing.assert_allclose(run.state[: t.size, 0], height, atol=1e-11)


def test_ball_is_thrown_again():
    """A ball without contact force lifts off; `resting_since` is then not reported."""
    table = vv.LoadTable(times=[0.0, 8.0, 9.0, 20.0], values=[-1.0, -1.0, 1.0, 1.0])
    run = vv.simulate(ball(0.5), 12.0, initial=[1.0, 0.0], force=table, dt=0.1)
    late = run.state[-1]
    # The load is 0 at t = 8.5, where the ball lifts off; then it grows to 1 at t = 9.
    v = 0.25 + (12 - 9)
    x = 0.5**3 / 3 + 0.25 * 3 + 4.5
    np.testing.assert_allclose(late, [x, v], atol=1e-11)
    assert np.isnan(run.resting_since).all()


def impacts(e, gap, load, nu, t_end, start):
    """An oscillator between rigid stops by SciPy, from impact to impact."""
    t, y = 0.0, np.array(start, dtype=float)
    while t < t_end:

        def hit(t, y):
            return gap - abs(y[0])

        hit.terminal, hit.direction = True, -1
        run = solve_ivp(
            lambda t, y: [y[1], load * np.sin(nu * t) - 0.05 * y[1] - y[0]], (t, t_end), y,
            "DOP853", rtol=1e-13, atol=1e-14, events=hit, max_step=0.05,
        )  # fmt: skip
        t, y = run.t[-1], run.y[:, -1].copy()
        if run.status == 1:
            y = np.array([np.sign(y[0]) * gap * (1 - 1e-15), -e * y[1]])
    return y


@pytest.mark.parametrize(("method", "order", "steps"), [("gauss2", 4, 300), ("verner9", 9, 30)])
def test_order_through_impacts(method, order, steps):
    """Halving the step of an oscillator between stops gains the order of the method."""
    system = body(vv.Stop(on="x1", gap=0.7, restitution=0.8))
    expected = impacts(0.8, 0.7, 0.6, 0.7, 25.0, [0.0, 0.0])
    errors = []
    for n in (steps, 2 * steps):
        run = vv.simulate(system, 25.0, dt=25 / n, load=[0.6], nu=0.7, method=method, keep="last")
        errors.append(np.abs(run.state[-1] - expected).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.6
    run = vv.simulate(system, 25.0, load=[0.6], nu=0.7, tolerance=1e-10)
    np.testing.assert_allclose(run.state[-1], expected, atol=1e-9)


def test_impact_between_two_masses():
    """Momentum is constant, energy too for e = 1, the relative velocity is multiplied by -e."""
    for e in (1.0, 0.6):
        pair = vv.Structure(
            mass=[1.0, 3.0], stiffness=np.zeros((2, 2)),
            elements=[vv.Gap(on=("x1", "x2"), gap=0.2, restitution=e)],
        )  # fmt: skip
        run = vv.simulate(pair, 2.0, dt=0.1, initial=[0, 1.0, 0, 0])
        v = run.state[-1, 1::2]
        assert v @ [1, 3] == pytest.approx(1.0, abs=1e-14)
        assert v[1] - v[0] == pytest.approx(e, abs=1e-14)


@pytest.mark.parametrize(
    "element",
    [
        vv.Jenkins(on="x1", stiffness=5, limit=0.3),
        vv.Iwan(on="x1", stiffness=[3, 2], limit=[0.2, 0.3]),
        vv.Stop(on="x1", gap=0.2, restitution=0.3),
        vv.BoucWen(on="x1", stiffness=5, beta=5, gamma=3),
    ],
)
def test_goes_on_bit_for_bit(element):
    """States of elements are kept in a run, in parts or resumed."""
    system = body(element)
    whole = vv.simulate(system, 16.0, dt=0.0625, load=[1.0], nu=1.3)
    for cut in (1.0, 5.25, 9.75):
        part = vv.simulate(system, cut, dt=0.0625, load=[1.0], nu=1.3)
        again = vv.simulate(system, 16.0, resume=part)
        np.testing.assert_array_equal(again.state[-1], whole.state[-1])
    freed = vv.simulate(system, 20.0, resume=whole, load=0)
    assert freed.outcome == "completed"
    np.testing.assert_allclose(whole(whole.t[::40]), whole.state[::40], atol=1e-12)


@pytest.mark.parametrize(
    ("call", "reported"),
    [
        (lambda: vv.Gap(on="x1", gap=0.1), "stiffness, restitution: give exactly"),
        (lambda: vv.Stop(on="x1", gap=0.1, stiffness=1, restitution=1), "give exactly one"),
        (lambda: vv.Stop(on="x1", gap=0.1, restitution=1.5), r"restitution = 1.5: must be in \[0"),
        (lambda: vv.Stop(on="x1", gap=0.1, restitution=0.5).force(1), "a rigid stop has no force"),
        (
            lambda: vv.simulate(
                body(vv.Stop(on="x1", gap=0.1, restitution=0.5)), 1, initial=[0.2, 0]
            ),
            "beyond its stop at 0.1",
        ),
        (
            lambda: vv.forced_response(
                body(vv.Stop(on="x1", gap=0.1, restitution=0.5)), [1.0], load=[1.0], method="newton"
            ),
            "a stop with restitution is for motions in time",
        ),
        (
            lambda: vv.simulate(body(vv.Jenkins(on="x1", stiffness=1, limit=1), n=513), 1, dt=0.1),
            "at most 512 coordinates, has 513",
        ),
        (
            lambda: vv.simulate(
                body(vv.Jenkins(on="x1", stiffness=1, limit=1)), 1, dt=0.1, memory="direct"
            ),
            "memory 'auto'",
        ),
    ],
)  # fmt: skip
def test_what_is_refused(call, reported):
    """One line that names the argument."""
    with pytest.raises(vv.InputError, match=reported):
        call()


@pytest.mark.parametrize(
    "element",
    [
        vv.BoucWen(on="x1", stiffness=0.5, beta=5, gamma=3),
        vv.Spring(on="x1", law="0.1*abs(d)"),
        vv.Spring(on="x1", law="0.1*tanh(v/0.2) + 0.1*abs(d)"),
    ],
)
def test_a_tolerance_that_is_not_met_is_reported(element):
    """A motion that grows by 1e14 has no correct digit; additional laws require one more run."""
    with pytest.raises(vv.InputError, match="tolerance = 1e-10: not met with"):
        vv.simulate(body(element, k=-1.0, c=0.0), 35, load=[0.3], nu=1.3, tolerance=1e-10)


@pytest.mark.parametrize(("n", "kernel"), [(3, False), (3, True), (9, False)])
def test_chosen_coordinates_are_those_of_the_whole_motion(n, kernel):
    """Bitwise, with their events, within steps, and in resumed runs."""
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    elements = [
        vv.Jenkins(on="x1", stiffness=2.0, limit=0.3),
        vv.Gap(on="x2", stiffness=10.0, gap=0.4),
        vv.Stop(on="x2", gap=1.2, restitution=0.6),
    ]
    if kernel:
        prony = vv.PronyKernel(weights=[0.3], rates=[1.0])
        elements.append(vv.Spring(on="x1", stiffness=0.5, kernel=prony))
    system = vv.Structure(mass=np.eye(n), stiffness=chain, damping=0.02 * chain, elements=elements)
    given = {"load": {1: [0.8] + [0] * (n - 1)}, "nu": 0.9}
    kept = [4, 5, 0, 1]
    for more in ({}, {"dt": 0.1, "keep": "tail", "tail": 3.0}, {"dt": 0.1, "events": ["x2 - 0.1"]}):
        whole = vv.simulate(system, 8, **given, **more)
        some = vv.simulate(system, 8, coordinates=["x3", "x1"], **given, **more)
        assert some.dof_names == ("x3", "x1")
        assert some.state.tobytes() == whole.state[:, kept].tobytes()
        assert some.deflections.tobytes() == whole.deflections.tobytes()
        for one, other in zip(some.events, whole.events, strict=True):
            assert one.t.size > 0
            assert one.state.tobytes() == other.state[:, kept].tobytes()
        assert some(7.777).tobytes() == whole(7.777)[kept].tobytes()
    for other in ({}, {"load": 0}):
        ends = [vv.simulate(system, 12, resume=run, **other).state[-1] for run in (some, whole)]
        assert ends[0].tobytes() == ends[1][kept].tobytes()
    with pytest.raises(vv.InputError, match=r"coordinates: 'y' must be one of"):
        vv.simulate(system, 8, coordinates=["y"], **given)


@pytest.mark.parametrize("dt", [0.5, 0.1, 0.01])
def test_contact_begins_at_rest(dt):
    """A load that begins at t = 0 presses the mass against a stop without a gap."""
    nu = 1.3
    stop = vv.Structure(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]],
        elements=[vv.Gap(on="x1", gap=0.0, restitution=0.5)],
    )  # fmt: skip
    t_end = np.pi / nu + 1.0
    run = vv.simulate(stop, t_end, dt=dt, load=1.0, nu=nu)
    assert run.outcome == "completed"
    assert np.abs(run.state[run.t < np.pi / nu]).max() == 0
    exact = solve_ivp(
        lambda t, y: [y[1], np.sin(nu * t) - y[0] - 0.1 * y[1]], (np.pi / nu, t_end), [0.0, 0.0],
        "DOP853", rtol=1e-12, atol=1e-14,
    ).y[:, -1]  # fmt: skip
    assert run.t[-1] == pytest.approx(t_end)
    assert run.state[-1] == pytest.approx(exact, abs=1e-9)
