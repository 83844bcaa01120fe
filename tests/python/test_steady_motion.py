"""Periodic motions by shooting: against closed forms, harmonic balance and differences."""

import warnings

import numpy as np
import pytest
import viscovib as vv

SPRINGS = np.array([[1.0, -1.0], [-1.0, 2.0]])
#: Example 03 of NLvib (Krack and Gross).
MASSES = vv.PolynomialSystem(
    mass=[1, 1], stiffness=SPRINGS, damping=0.03 * SPRINGS, forces={"x1": "100*max(x1 - 1, 0)"}
)


def start_of(response):
    """State at t = 0 of a motion in harmonics."""
    turning = 1j * response.nu[0] * response.harmonics
    x = response.coefficients[0]
    return np.stack([x.imag.sum(axis=1), (x * turning).imag.sum(axis=1)], axis=-1).ravel()


@pytest.mark.parametrize("n", [1, 2, 8])
def test_smooth_as_by_harmonics(n):
    """Smooth laws, few coordinates or modal sections: the motion of harmonic balance."""
    rng = np.random.default_rng(n)
    for _ in range(3):
        a = rng.normal(size=(n, n))
        system = vv.PolynomialSystem(
            mass=np.diag(rng.uniform(0.5, 2, n)),
            stiffness=a @ a.T + 2 * np.eye(n),
            damping=0.3 * np.eye(n),
            forces={"x1": "0.2*x1^3 + 0.1*x1^2*x1_dot"} if n > 1 else "0.2*x^3 + 0.1*x^2*x_dot",
        )
        nu, load = rng.uniform(0.5, 1.0), list(rng.uniform(0.1, 0.4, n))
        motion = vv.steady_motion(system, nu, load=load)
        response = vv.forced_response(system, [nu], load=load, rtol=1e-12)
        expected = start_of(response)
        assert motion.outcome == "converged"
        assert motion.stable
        np.testing.assert_allclose(motion.state[0], expected, atol=1e-10)
        np.testing.assert_allclose(motion(motion.period * 7.0), motion.state[0], atol=1e-11)


def test_memory_as_by_harmonics():
    """Exponentials of the memory are part of the state; each has a multiplier."""
    kernel = vv.PronyKernel(weights=[0.2, 0.3], rates=[0.5, 3.0])
    spring = vv.Spring(on={"x1": 1, "x2": -1}, stiffness=2.0, law="0.5*d^3", kernel=kernel)
    system = vv.Structure(
        mass=np.eye(2), stiffness=np.eye(2), damping=0.05 * np.eye(2), elements=[spring]
    )
    motion = vv.steady_motion(system, 0.8, load=[0.3, 0.1])
    expected = start_of(vv.forced_response(system, [0.8], load=[0.3, 0.1], rtol=1e-12))
    np.testing.assert_allclose(motion.state[0], expected, atol=1e-10)
    assert motion.remembered.size == motion.multipliers.size - 4 > 0
    assert motion.stable


@pytest.mark.parametrize(("nu", "limit"), [(0.8, 0.2), (1.2, 0.3)])
def test_den_hartog(nu, limit):
    """Den Hartog's closed form without sticking (1931), to 1e-10."""
    ratio = np.sin(np.pi / nu) / (nu * (1 + np.cos(np.pi / nu)))
    expected = np.sqrt(1 / (1 - nu**2) ** 2 - (limit * ratio) ** 2)
    block = vv.PolynomialSystem(mass=1, stiffness=1, forces=f"{limit}*sign(x_dot)")
    motion = vv.steady_motion(block, nu, load={1: 1j})
    assert motion.switches == 2
    assert motion.extremes("x") == pytest.approx((-expected, expected), abs=1e-10)
    assert motion.error < 1e-10


def test_sticking_forgets():
    """A mass that sticks during the period has a multiplier that is 0."""
    block = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.7*sign(x_dot)")
    motion = vv.steady_motion(block, 0.4, load=1.0)
    assert motion.switches > 2
    assert abs(motion.multipliers[-1]) < 1e-14
    assert motion.stable


SYSTEMS = {
    "gap": vv.PolynomialSystem(
        mass=[1, 2], stiffness=SPRINGS, damping=0.1 * SPRINGS, forces={"x1": "9*max(x1 - 0.1, 0)"}
    ),
    "jump": vv.PolynomialSystem(
        mass=[1, 2], stiffness=SPRINGS, damping=0.1 * SPRINGS,
        forces={"x1": "where(x1 + 0.3*x1^3 > 0.1, 0.3, 0)"},
    ),
    "friction that grows": vv.PolynomialSystem(
        mass=[1, 2], stiffness=SPRINGS, damping=0.1 * SPRINGS,
        forces={"x1": "0.3*(1 + x1^2)*sign(x1_dot - 0.1)"},
    ),
    "belt whose speed varies": vv.PolynomialSystem(
        mass=[1, 2], stiffness=SPRINGS, damping=0.1 * SPRINGS,
        forces={"x1": "0.9*sign(x1_dot - 0.3*x2 - 0.1*x2^2)"},
    ),
    "friction that turns": vv.PolynomialSystem(
        mass=[1, 2], stiffness=SPRINGS, damping=0.1 * SPRINGS,
        forces={"x1": "0.9*sign(x1_dot - 0.1)", "x2": "0.4*x2*sign(x1_dot - 0.1)"},
    ),
    "impact and friction": vv.Structure(
        mass=np.diag([1.0, 2.0]), stiffness=SPRINGS, damping=0.1 * SPRINGS,
        elements=[
            vv.Gap(on={"x1": 1}, gap=0.2, restitution=0.6),
            vv.Spring(on="x2", stiffness=0, law="0.1*sign(v)"),
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SYSTEMS)
def test_derivatives_across_switches(name):
    """Propagated perturbations agree with neighbouring motions."""
    from viscovib.analyses.period_map import PeriodMap

    mapping = PeriodMap.checked(SYSTEMS[name], [0.7, 0.4], 0.8, 1, "auto")
    # Near a sliding surface a neighbouring motion returns after a time of order h.
    steps, state, h = 40, np.zeros(4), 2e-7
    for _ in range(3):
        state = mapping.run(state, steps).last
        ran = mapping.run(state, steps)
        assert ran.passed > 0
        nearby = [
            (mapping.run(state + h * one, steps).last - mapping.run(state - h * one, steps).last)
            / (2 * h)
            for one in np.eye(4)
        ]
        np.testing.assert_allclose(ran.by_start, np.array(nearby).T, atol=2e-7)


ELEMENTS = [
    lambda rng, on: vv.Gap(on=on, stiffness=rng.uniform(5, 60), gap=rng.uniform(0.01, 0.1)),
    lambda rng, on: vv.Spring(on=on, stiffness=rng.uniform(0, 20), law="50*d^3 + 3*d^2"),
    lambda rng, on: vv.Spring(on=on, stiffness=0, law="v*abs(v) + 0.1*tanh(v/0.3)"),
    lambda rng, on: vv.Spring(on=on, stiffness=0, law="0.1*sign(v)"),
    lambda rng, on: vv.Gap(on=on, gap=rng.uniform(0.05, 0.1), restitution=0.6),
]


@pytest.mark.parametrize("seed", range(6))
def test_derivatives_in_many_coordinates(seed):
    """Repeated step sizes share the linear part of perturbations: in any unit."""
    from viscovib.analyses.period_map import PeriodMap

    rng = np.random.default_rng(seed)
    n = int(rng.integers(8, 20))
    units = 10 ** rng.uniform(-3, 3, n) if seed % 2 else np.ones(n)
    springs = rng.uniform(5, 30, n + 1)
    matrix = np.diag(springs[1:] + springs[:-1]) - np.diag(springs[1:-1], 1)
    matrix = matrix - np.diag(springs[1:-1], -1)
    mass = np.diag(rng.uniform(0.5, 2, n))
    places = rng.permutation(n)[: int(rng.integers(1, 4))]
    elements = [
        ELEMENTS[int(rng.integers(len(ELEMENTS)))](rng, {f"x{i + 1}": units[i]}) for i in places
    ]
    system = vv.Structure(
        mass=mass * np.outer(units, units),
        stiffness=matrix * np.outer(units, units),
        damping=0.02 * matrix * np.outer(units, units),
        elements=elements,
    )
    load = rng.normal(size=n) * units
    mapping = PeriodMap.checked(system, load, rng.uniform(0.8, 2), 1, "auto")
    turn = np.repeat(units, 2)
    state = rng.normal(size=2 * n) * 0.03 / turn
    steps, h = 2 * mapping.run(state, 0).n_steps, 3e-7
    state = mapping.run(state, steps, derivatives=False).last
    ran = mapping.run(state, steps)
    assert ran.outcome == "completed"
    np.testing.assert_array_equal(ran.last, mapping.run(state, steps, derivatives=False).last)
    for i in rng.permutation(2 * n)[:6]:
        one = np.zeros(2 * n)
        one[i] = h / turn[i]
        ahead, back = (mapping.run(state + a * one, steps, derivatives=False) for a in (1, -1))
        by = (ahead.last - back.last) * turn / (2 * h)
        np.testing.assert_allclose(ran.by_start[:, i] * turn / turn[i], by, atol=3e-6)


def test_period_of_two_loads():
    """After a period doubling the motion repeats after two periods; the old one is unstable."""
    near = [-1.7437, -0.5182, -0.6096, 0.2772]
    one = vv.steady_motion(MASSES, 0.7554, load=[0, 0.1], initial=near)
    assert one.stable is False
    assert one.multipliers[0].real < -1
    assert abs(one.multipliers[0].imag) == 0
    two = vv.steady_motion(MASSES, 0.7554, load=[0, 0.1], initial=one, n_periods=2)
    np.testing.assert_allclose(two.state[0], one.state[0], atol=1e-9)
    assert (one.repeats_after, two.repeats_after) == (1, 1)
    assert "repeats after 1 period\n" in repr(two)
    largest = np.abs(two.multipliers[0])
    assert largest == pytest.approx(np.abs(one.multipliers[0]) ** 2, rel=1e-6)


def test_doubling_seen_over_two_periods():
    """A doubling is a branch point of motions over two periods, at the same location."""
    near = [-1.7437, -0.5182, -0.6096, 0.2772]
    # Next to the branch point motions are ill-conditioned, and their errors above the default.
    branch = vv.trace_motion(
        MASSES, (0.755, 0.7556), load=[0, 0.1], initial=near, max_step=0.2, n_periods=2,
        tolerance=1e-9,
    )  # fmt: skip
    (one,) = branch.crossings
    assert one.kind == "branch point"
    assert one.parameter == pytest.approx(0.755586159, abs=2e-9)
    assert (branch.repeats_after == 1).all()
    assert "of a shorter period than 2" in repr(branch)


@pytest.mark.parametrize("time", [1e-12, 1e9])
def test_units_of_time(time):
    """In other units of time the same motion is found; multipliers have no unit."""
    motions = [
        vv.steady_motion(
            vv.PolynomialSystem(
                mass=1, stiffness=t**-2, damping=0.1 / t, forces=f"{9 / t**2}*max(x - 0.2, 0)"
            ),
            0.8 / t,
            load=0.5 / t**2,
            initial=[0.0, 0.0],
        )
        for t in (1.0, time)
    ]
    x, v = motions[1].state[0]
    np.testing.assert_allclose([x, v * time], motions[0].state[0], atol=1e-12)
    np.testing.assert_allclose(
        np.abs(motions[1].multipliers), np.abs(motions[0].multipliers), atol=1e-11
    )


def test_small_with_large():
    """A jump in a coordinate 1e-12 as large as another is found: each has its own scale."""
    small = vv.PolynomialSystem(mass=1, stiffness=1.7, damping=0.1, forces="0.3*sign(x_dot)")
    both = vv.PolynomialSystem(
        mass=[1, 1], stiffness=np.diag([1, 1.7]), damping=0.1 * np.eye(2),
        forces={"x1": "x1^3", "x2": "0.3e-12*sign(x2_dot)"},
    )  # fmt: skip
    alone = vv.steady_motion(small, 0.8, load=0.6)
    nearby = vv.steady_motion(both, 0.8, load=[0.5, 0.6e-12])
    np.testing.assert_allclose(
        np.sort(np.abs(nearby.multipliers))[:2], np.sort(np.abs(alone.multipliers)), atol=1e-9
    )


def test_refused():
    """One-line messages for systems without such motions and for failures."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    with pytest.raises(vv.InputError, match="load: must be given"):
        vv.steady_motion(system, 1.0)
    with pytest.raises(vv.InputError, match="nu = 0: must be greater than 0"):
        vv.steady_motion(system, 0.0, load=1.0)
    joint = vv.Structure(
        mass=[[1.0]], stiffness=[[1.0]],
        elements=[vv.Jenkins(on="x1", stiffness=1.0, limit=0.1)],
    )  # fmt: skip
    with pytest.raises(vv.InputError, match="hysteresis elements"):
        vv.steady_motion(joint, 1.0, load=1.0)
    held = vv.PolynomialSystem(mass=1, stiffness=1, forces="sign(x_dot)")
    with pytest.raises(vv.InputError, match="cannot be followed, because it is not isolated"):
        vv.trace_motion(held, (0.8, 0.9), load=0.1)
    falls = vv.PolynomialSystem(mass=1, stiffness=-1.0, forces="-x^3")
    with pytest.warns(vv.ConvergenceWarning, match="no motion was found"):
        found = vv.steady_motion(falls, 1.0, load=5.0, initial=[9.0, 9.0])
    assert not found.complete
    assert found.stable is None


def test_rest_against_a_stop():
    """The motion may start at rest in contact; where necessary, short steps are used."""
    stop = vv.Structure(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]],
        elements=[vv.Gap(on={"x1": 1}, gap=0, restitution=0.5)],
    )  # fmt: skip
    motion = vv.steady_motion(stop, 1.0, load=1.0)
    assert motion.stable
    run = vv.simulate(stop, 40 * motion.period, load=1.0, nu=1.0, keep="last")
    np.testing.assert_allclose(motion.state[0], run.state[-1], atol=1e-7)


def test_resonance_without_damping():
    """Without a periodic motion none is found, in spite of small residuals."""
    with pytest.warns(vv.ConvergenceWarning, match="stalled: no motion was found"):
        motion = vv.steady_motion(vv.PolynomialSystem(mass=1, stiffness=1), 1.0, load=1.0)
    assert not motion.complete
    assert motion.stable is None


def test_result():
    """It can be printed, saved and used as a start."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motion = vv.steady_motion(SYSTEMS["gap"], 0.8, load=[0.7, 0.4])
    assert "converged, stable" in repr(motion)
    data = motion.to_dataset()
    np.testing.assert_array_equal(data["state"], motion.state)
    again = vv.steady_motion(SYSTEMS["gap"], 0.8, load=[0.7, 0.4], initial=motion)
    np.testing.assert_allclose(again.state[0], motion.state[0], atol=2 * motion.error)
    run = vv.simulate(
        SYSTEMS["gap"], motion.period, dt=motion.step, initial=motion.state[0], load=[0.7, 0.4],
        nu=0.8, keep="last",
    )  # fmt: skip
    np.testing.assert_allclose(run.state[-1], motion.state[0], atol=1e-12)


def test_crossings_with_a_gap():
    """A fold and the doubling near it of example 03 of NLvib, also with other steps."""
    near = [-1.7437, -0.5182, -0.6096, 0.2772]
    found = []
    for options in ({"max_step": 0.05}, {"method": "gauss16", "max_step": 0.1}):
        with warnings.catch_warnings(record=True) as reported:
            warnings.simplefilter("always")
            branch = vv.trace_motion(
                MASSES, (0.755, 0.757), load=[0, 0.1], initial=near, tolerance=1e-10, **options
            )
        # Near the fold errors at a given frequency are amplified, and stated.
        above = "exceeds the tolerance at" in "".join(str(one.message) for one in reported)
        assert above == (branch.error > 1e-10).any()
        assert branch.outcome == "completed"
        assert [one.kind for one in branch.crossings] == ["period doubling", "fold"]
        assert (branch.error < 1e-8).all()
        found.append(np.array([(one.parameter, one.error) for one in branch.crossings]).T)
        assert branch.fold_errors.tolist() == [branch.crossings[1].error]
        i = branch.crossings[0].before
        assert branch.stable[i] is False
        assert branch.stable[i + 1] is True
        motion = branch.motion(i)
        np.testing.assert_allclose(motion.state[0], branch.state[i], atol=1e-12)
    (places, errors), (others, more) = found
    assert (errors < 1e-12).all()
    assert (abs(places - others) <= 2 * (errors + more)).all()
    assert places == pytest.approx([0.75559, 0.75563], abs=5e-6)


def test_neimark_sacker_with_a_gap():
    """The published digits of example 03."""
    near = [-0.23824, 0.55031, -0.19346, 0.42285]
    branch = vv.trace_motion(MASSES, (0.6200, 0.6177), load=[0, 0.1], initial=near, max_step=0.2)
    (one,) = branch.crossings
    assert one.kind == "Neimark-Sacker"
    assert one.parameter == pytest.approx(0.61861, abs=5e-6)


@pytest.mark.parametrize("max_step", [0.05, 0.5])
def test_pairs_are_not_mixed(max_step):
    """One pair crosses the unit circle where its damping is 0; other pairs are closer to it."""
    system = vv.PolynomialSystem(
        mass=np.eye(3), stiffness=np.diag([1.0, 1.7, 2.3]), damping=np.diag([0.1, 0.002, 0.004]),
        forces={"x1": "0.01*x1^3"},
    )  # fmt: skip
    branch = vv.trace_motion(
        system, vary="damping[x1,x1]", vary_range=(0.1, -0.08), nu=0.8, load=[0.01, 0.01, 0.02],
        max_step=max_step,
    )  # fmt: skip
    (one,) = branch.crossings
    assert one.kind == "Neimark-Sacker"
    assert one.parameter == pytest.approx(0.0, abs=1e-9)
    undamped = vv.trace_motion(
        vv.PolynomialSystem(mass=np.eye(2), stiffness=np.diag([1.0, 1.7]), forces={"x1": "x1^3"}),
        (0.75, 0.8), load=[0.05, 0.05], initial=np.zeros(4), max_step=max_step,
    )  # fmt: skip
    # On the circle everywhere, within rounding error.
    assert undamped.crossings == ()


def test_errors_hold():
    """Effects of too long steps are stated, for the state and the multipliers."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="300*x^3")
    weights = np.array([1, 1 / 0.7])
    exact = vv.steady_motion(system, 0.7, load=1.0, tolerance=1e-12)
    motion = vv.steady_motion(system, 0.7, load=1.0, tolerance=1e-1, initial=exact)
    (point, *_) = (
        vv.trace_motion(system, (0.7, 0.71), load=1.0, tolerance=1e-1, initial=exact, max_points=2),
    )
    for state, error, multipliers in (
        (motion.state[0], motion.error, motion.multipliers),
        (point.state[0], point.error[0], point.multipliers[0]),
    ):
        apart = np.abs(weights * (state - exact.state[0])).max()
        assert 1e-9 < apart <= error < 10 * apart
        change = np.abs(np.abs(multipliers[0]) - np.abs(exact.multipliers[0]))
        assert 1e-7 < change <= motion.multiplier_error < 100 * change


@pytest.mark.parametrize("span", [(0.551, 1.739), (1.739, 0.551)])
def test_branch_turns_back_where_impacts_begin(span):
    """Below the grazing frequency of the linear motion there are motions with impacts."""
    k, c, force, gap = 0.982, 0.287, 0.228, 0.25
    stop = vv.Structure(
        mass=[[1.0]], stiffness=[[k]], damping=[[c]],
        elements=[vv.Gap(on="x1", gap=gap, restitution=0.63)],
    )  # fmt: skip
    branch = vv.trace_motion(stop, span, load=force, max_step=0.1)
    # |k - nu^2 + i c nu| = force/gap.
    half = k - c**2 / 2
    grazed = np.sqrt(half + np.sqrt(half**2 - k**2 + (force / gap) ** 2))
    assert branch.outcome == "completed"
    assert branch.grazings == pytest.approx(grazed, abs=1e-10)
    # The branch has two folds: at grazing, and at the end of motions with impacts.
    assert np.sort(branch.folds)[0] == pytest.approx(grazed, abs=1e-10)
    assert np.sort(branch.folds)[1] == pytest.approx(1.502277916028, abs=1e-10)
    assert (branch.switches[branch.nu > 1.51] == 0).all()


def test_branch_as_by_harmonics():
    """Folds of a smooth branch; its end along frequency, load and a parameter."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="x^3")
    for span, rest in (
        ({"nu_range": (1.0, 2.0)}, {}),
        ({"load_range": (0.2, 2.0)}, {"nu": 0.9}),
        ({"vary": "damping", "vary_range": (0.4, 0.3)}, {"nu": 0.9}),
    ):
        one = vv.trace_motion(system, load=0.6, max_step=0.1, **span, **rest)
        other = vv.trace_response(system, load=0.6, rtol=1e-12, **span, **rest)
        assert one.outcome == "completed"
        np.testing.assert_allclose(one.folds, other.folds, atol=1e-9)
        x = other.coefficients[-1, 0]
        expected = [x.imag.sum(), (1j * other.nu[-1] * other.harmonics * x).imag.sum()]
        np.testing.assert_allclose(one.state[-1], expected, atol=1e-9)


def test_extremes_along_a_branch():
    """Extremes of the motions; the curve is smooth also for short contacts."""
    near = [-1.7437, -0.5182, -0.6096, 0.2772]
    branch = vv.trace_motion(
        MASSES, (0.7540, 0.7545), load=[0, 0.1], initial=near, max_step=0.2, max_points=4
    )
    for i in range(branch.parameter.size):
        motion = branch.motion(i)
        dense = motion(np.linspace(0, motion.period, 4000))[:, ::2]
        for d, name in enumerate(branch.dof_names):
            low, high = motion.extremes(name)
            assert (branch.smallest[i, d], branch.largest[i, d]) == pytest.approx(
                (low, high), rel=1e-9
            )
            assert 0 <= high - dense[:, d].max() < 1e-4
            assert 0 <= dense[:, d].min() - low < 1e-4


def test_contact_begins():
    """Grazing: the linear motion reaches the gap, at a known frequency."""
    stop = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="20*max(x - 0.5, 0)")
    branch = vv.trace_motion(stop, (0.5, 1.0), load=0.3, max_step=0.1)
    # 0.3^2 = 0.5^2 ((1 - nu^2)^2 + (0.2 nu)^2).
    squares = np.roots([1.0, -2 + 0.04, 1 - 0.36])
    assert branch.grazings == pytest.approx([np.sqrt(squares.min())], abs=1e-9)
    assert branch.switches[0] == 0
    assert branch.switches[-1] == 2


@pytest.mark.parametrize("kernel", [None, vv.PronyKernel(weights=[0.5], rates=[10.0])])
def test_a_body_with_gaps_as_by_harmonics(kernel):
    """A machine on four mounts that strike their stops: amplitude and largest multipliers."""
    gap = (None, None, "1e7*max(d - 0.002, 0) + 1e7*min(d + 0.002, 0)")
    corners = [(-0.6, -0.4), (-0.6, 0.4), (0.6, -0.4), (0.6, 0.4)]
    mounts = [
        vv.MountPoint(
            name=f"m{i}", position=(x, y, -0.3), stiffness=(4e5, 4e5, 8e5), damping=100, law=gap,
            kernel=kernel,
        )
        for i, (x, y) in enumerate(corners)
    ]  # fmt: skip
    body = vv.Body(mass=800, inertia=(40, 70, 90), mounts=mounts)
    load = {1: {"z": 500.0, "ry": 50.0}}
    motion = vv.steady_motion(body, 62.0, load=load)
    response = vv.forced_response(body, [62.0], load=load, stability=True)
    assert motion.outcome == "converged"
    low, high = motion.extremes("z")
    assert (high - low) / 2 == pytest.approx(response.peak_to_peak("z")[0] / 2, rel=1e-5)
    assert np.abs(motion.multipliers[:4] - response.multipliers[0, :4]).max() < 1e-4
    if kernel is None:
        branch = vv.trace_motion(body, (61, 62), load=load, max_step=0.3)
        assert branch.outcome == "completed"
    turning = vv.Body(mass=800, inertia=(40, 70, 90), mounts=mounts, geometry="exact")
    with pytest.raises(vv.InputError, match="geometry = 'exact'"):
        vv.steady_motion(turning, 62.0, load=load)
