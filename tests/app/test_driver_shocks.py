"""The standalone driver: shocks, accelerations of the base, shock response spectra."""

import warnings

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused, read_csv, silence

RUBBER = vv.PronyKernel(weights=[0.1], rates=[2.0])
CHAIN = {"mass": np.diag([1.0, 2.0]), "stiffness": [[300.0, -100.0], [-100.0, 100.0]]}
CHAIN |= {"damping": np.eye(2), "base_direction": [1.0, 1.0]}
#: Each system as a scene and in Python, and the coordinate along which its base may accelerate.
SYSTEMS = {
    "system": (
        "&system coordinates='a', 'b', mass=1 2, stiffness=300 -100 -100 100, damping=1 1,"
        " base_direction=1 1 /\n&force on='a', law='5e4*a^3' /\n",
        lambda: vv.PolynomialSystem(**CHAIN, names=("a", "b"), forces={"a": "5e4*a^3"}),
        "b",
    ),
    "system with memory and a stop": (
        "&system coordinates='a', 'b', mass=1 2, stiffness=300 -100 -100 100, damping=1 1,"
        " base_direction=1 1 /\n&kernel kind='prony', weights=0.1, rates=2 /\n"
        "&force on='a', law='500*max(a - 0.01, 0)', kernel=0 /\n",
        lambda: vv.PolynomialSystem(
            mass=CHAIN["mass"], damping=np.eye(2), base_direction=[1.0, 1.0], names=("a", "b"),
            springs=[
                vv.Springs(stiffness=CHAIN["stiffness"], kernel=RUBBER),
                vv.Springs(forces={"a": "500*max(a - 0.01, 0)"}),
            ],
        ),
        "b",
    ),
    "mount": (
        "&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=100, stiffness_phi=20 /\n"
        "&kernel kind='prony', weights=0.1, rates=2 /\n",
        lambda: vv.Mount(
            mass=1, inertia=0.1, offset=0.5, stiffness_x=100, stiffness_phi=20, kernel=RUBBER
        ),
        None,
    ),
    "structure": (
        "&structure coordinates='a', 'b', mass=1 2, stiffness=300 -100 -100 100, damping=1 1,"
        " base_direction=1 1 /\n&kernel kind='prony', weights=0.1, rates=2 /\n"
        "&element on='a', stiffness=10, law='200*d^3', kernel=1 /\n",
        lambda: vv.Structure(
            **CHAIN, names=("a", "b"),
            elements=[vv.Spring(on={"a": 1}, stiffness=10, law="200*d^3", kernel=RUBBER)],
        ),
        None,
    ),
    "structure with a stop": (
        "&structure coordinates='a', 'b', mass=1 2, stiffness=300 -100 -100 100, damping=1 1,"
        " base_direction=1 1 /\n&element on='a', law='1000*max(d - 0.01, 0)' /\n",
        lambda: vv.Structure(
            **CHAIN, names=("a", "b"), elements=[vv.Spring(on={"a": 1}, law="1000*max(d-0.01, 0)")]
        ),
        None,
    ),
    "body": (
        "&body mass=10, inertia=0.1 0.2 0.3 /\n&mount_point name='foot', position=0.1 0 -0.1,"
        " stiffness=1e4 1e4 2e4, rotational_stiffness=300 300 300, damping=9 9 9 /\n",
        lambda: vv.Body(
            mass=10, inertia=(0.1, 0.2, 0.3), mounts=[vv.MountPoint(
                name="foot", position=(0.1, 0, -0.1), stiffness=(1e4, 1e4, 2e4),
                rotational_stiffness=(300, 300, 300), damping=(9, 9, 9),
            )],
        ),
        "z",
    ),
}  # fmt: skip
SHAPES = {
    "half_sine": (vv.HalfSine, ()), "haversine": (vv.Haversine, ()), "sawtooth": (vv.Sawtooth, ()),
    "trapezoid": (vv.Trapezoid, ("rise", "fall")), "chirp": (vv.Chirp, ("hz", "sweep")),
    "step": (vv.Step, ()), "record": (None, ()),
}  # fmt: skip


def drawn(random, shape):
    """A shock of one shape as keys of &load, and the arguments in Python."""
    kind, more = SHAPES[shape]
    start, duration = random.uniform(0, 0.1, 2).round(4)
    size = round(float(random.uniform(1, 50)), 3)
    if shape == "record":
        times = (start + np.append(0, np.cumsum(random.uniform(0.01, 0.05, 9)))).round(4)
        values = random.normal(size=10).round(4)
        keys = f"times={' '.join(map(str, times))}, values={' '.join(map(str, values))}"
        return f"{keys}, amplitude={size}", lambda on, **unit: vv.LoadTable(
            times=times, values=np.multiply.outer(values, size * on), **unit
        )
    numbers = {"start": start}
    if shape != "step":
        numbers["duration"] = duration + 0.02
    if "rise" in more and random.random() < 0.5:
        numbers |= {"rise": 0.2 * numbers["duration"], "fall": 0.5 * numbers["duration"]}
    if "hz" in more:
        numbers |= {"hz": (5.0, 40.0), "sweep": str(random.choice(["linear", "logarithmic"]))}
    keys = [f"amplitude={size}"]
    for name, value in numbers.items():
        shown = f"'{value}'" if isinstance(value, str) else " ".join(map(str, np.atleast_1d(value)))
        keys.append(f"{name}={shown}")
    return ", ".join(keys), lambda on, **unit: kind(amplitude=size * on, **numbers, **unit)


@pytest.mark.parametrize("name", ["system", "structure", "body"])
def test_random_shocks_have_the_motion_of_python(solve, tmp_path, name):
    random = np.random.default_rng(sum(map(ord, name)))
    head, build, along = SYSTEMS[name]
    system = build()
    names = system.dof_names
    for case, shape in enumerate(SHAPES):
        unit = str(random.choice(["g", "m/s^2"]))
        keys, load = drawn(random, shape)
        call = {"dt": 0.005} if case % 2 else {"dt": "auto", "tolerance": 1e-8}
        if shape in ("half_sine", "chirp", "haversine"):
            call = {"dt": 0.005}
        text = f"{head}&load kind='acceleration', shape='{shape}', unit='{unit}', {keys}"
        given = {"base_acceleration": load(1.0, unit=unit)}
        if along is not None and (case % 3 == 1 or name == "body"):
            text += f", on='{along}'"
            given["base_acceleration"] = {along: given["base_acceleration"]}
        if case % 2:
            which = int(random.integers(len(names)))
            text += " /\n&load shape='sawtooth', amplitude=3, duration=0.05, start=0.02"
            text += f", on='{names[which]}'"
            on = np.eye(len(names))[which]
            given["force"] = vv.Sawtooth(amplitude=3 * on, duration=0.05, start=0.02)
        step = "dt=0.005" if call["dt"] != "auto" else "tolerance=1e-8"
        scene = tmp_path / "shock.nml"
        # A shock in Python may begin at rest; a scene too.
        scene.write_text(f"{text} /\n&transient t_end=0.3, {step}, acceleration='yes' /\n")
        with silence():
            done = solve(scene, "--out", tmp_path)
            run = vv.simulate(system, 0.3, **call, **given)
        assert done.returncode == 0, done.stderr
        table = read_csv(tmp_path / "shock_transient.csv")
        assert np.abs(table["t"] - run.t).max() < 1e-14 * run.t[-1]
        assert run.relative_to_base
        # Rounding decides whether an acceleration at a jump is that before or after it.
        ends = np.concatenate([one.times for one in _tables(given)])
        smooth = np.abs(run.t[:, np.newaxis] - ends).min(axis=1) > 1e-12
        for i, one in enumerate(names):
            columns = (one, run.state[:, ::2]), (f"{one}_dot", run.state[:, 1::2])
            columns = (*columns, (f"{one}_ddot", run.acceleration))
            for column, wanted in columns:
                kept = smooth if column.endswith("_ddot") else slice(None)
                off = np.abs(table[column] - wanted[:, i])[kept].max()
                assert off < 1e-12 * np.abs(wanted).max(), (shape, column)


@pytest.mark.parametrize("name", ["system", "body"])
def test_run_ups_have_the_motion_of_python(solve, tmp_path, name):
    """In two coordinates, and of a body along directions at a point."""
    random = np.random.default_rng(5 + len(name))
    head, build, _ = SYSTEMS[name]
    system = build()
    size, turn, start, hold = random.uniform(0.001, 0.01, 4).round(4).tolist()
    keys = f"start={start}, duration=0.2, speed=0 150, hold={hold}"
    ons = [f"on='{one}'" for one in system.dof_names[:2]]
    directions = np.eye(len(system.dof_names))[:2]
    if name == "body":
        ons = ["force=0 1 0, at=0.1 0.2 0", "force=0 0 1, at=0.1 0.2 0"]
        directions = [system.load(force=one, at=(0.1, 0.2, 0)).real for one in np.eye(3)[1:]]
    text = head
    for on, phase in zip(ons, (turn, turn + np.pi / 2), strict=True):
        text += f"&load kind='unbalance', shape='run_up', amplitude={size}, phase={phase!r}, {on}"
        text += f", {keys} /\n"
    scene = tmp_path / "run_up.nml"
    scene.write_text(f"{text}&transient t_end=0.3, dt=0.002 /\n")
    load = vv.RunUp(
        unbalance=size * (directions[0] + 1j * np.asarray(directions[1])), phase=turn,
        speed=(0, 150), duration=0.2, start=start, hold=hold,
    )  # fmt: skip
    with silence():
        done = solve(scene, "--out", tmp_path)
        run = vv.simulate(system, 0.3, dt=0.002, force=load)
        if name in ("system", "mount"):
            again = vv.run(scene).trajectory
            assert np.abs(again.state - run.state).max() < 1e-12 * np.abs(run.state).max()
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "run_up_transient.csv")
    size = np.abs(run.state).max()
    for i, one in enumerate(system.dof_names):
        assert np.abs(table[one] - run.state[:, 2 * i]).max() < 1e-12 * size
        assert np.abs(table[f"{one}_dot"] - run.state[:, 2 * i + 1]).max() < 1e-12 * size


def _tables(given):
    """The tables of the arguments of a call."""
    for one in given.values():
        yield from one.values() if isinstance(one, dict) else (one,)


@pytest.mark.parametrize(
    ("name", "kind"), [("system", "absolute_acceleration"), ("body", "pseudo_velocity")]
)
def test_spectra_are_those_of_python(solve, tmp_path, name, kind):
    head, build, along = SYSTEMS[name]
    scene, system = tmp_path / "spectrum.nml", build()
    shock = vv.Trapezoid(amplitude=20.0, duration=0.08, start=0.03)
    run = vv.simulate(system, 0.5, dt=0.002, base_acceleration={along: shock})
    t = np.arange(400) * 0.001
    record = 3 * np.exp(-20 * t) * np.sin(200 * t)
    np.savetxt(tmp_path / "record.csv", np.c_[t, record], delimiter=",", header="t,a")
    hz = np.geomspace(2, 200, 15)
    loaded = vv.LoadTable(times=t, values=record, unit="g")
    for text, wanted in [
        (f"coordinate='{along}', frequencies=2 30 7, kind='{kind}'",
         vv.shock_response_spectrum(run, [2, 30, 7], coordinate=along, kind=kind)),
        (f"file='record.csv', unit='g', from=2, to=200, count=15, damping=0.1, kind='{kind}'",
         vv.shock_response_spectrum(loaded, hz, damping=0.1, kind=kind)),
    ]:  # fmt: skip
        scene.write_text(
            f"{head}&load kind='acceleration', on='{along}', shape='trapezoid', amplitude=20,"
            f" duration=0.08, start=0.03 /\n&transient t_end=0.5, dt=0.002 /\n"
            f"&shock_spectrum {text} /\n"
        )
        done = solve(scene, "--out", tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        table = read_csv(tmp_path / "spectrum_shock_spectrum.csv")
        found = vv.run(scene).shock_spectrum
        assert isinstance(found, vv.ShockResponseSpectrum)
        assert (found.unit, found.quantity) == (wanted.unit, kind)
        assert (found.peak, found.duration) == pytest.approx((wanted.peak, wanted.duration))
        np.testing.assert_allclose(table["frequency"], wanted.frequencies, rtol=1e-14)
        for column in table.dtype.names[1:]:
            wanted_column = getattr(wanted, column)
            np.testing.assert_allclose(table[column], wanted_column, rtol=1e-12)
            np.testing.assert_allclose(getattr(found, column), wanted_column, rtol=1e-12)


def test_scenes_give_python_its_shocks(tmp_path):
    """Two forces and two accelerations, which are added."""
    head, build, _ = SYSTEMS["system"]
    scene = tmp_path / "sum.nml"
    one, other = vv.HalfSine(amplitude=2.0, duration=0.1), vv.Step(amplitude=0.5, unit="g")
    scene.write_text(
        f"{head}&load kind='acceleration', shape='half_sine', amplitude=2, duration=0.1 /\n"
        "&load kind='acceleration', shape='step', amplitude=0.5, unit='g' /\n"
        "&load shape='sawtooth', amplitude=3, duration=0.05, on='b' /\n"
        "&load shape='record', times=0 0.1 0.2, values=0 2 0, on='a' /\n"
        "&transient t_end=0.3, dt=0.01, initial=0 0 0.001 0 /\n"
    )
    run = vv.run(scene).trajectory
    t = np.union1d(np.linspace(0, 0.1, 513), other.times)
    push = vv.LoadTable(times=[0, 0.05, 0.05 + 1e-12, 0.1, 0.2],
                        values=[[0, 0], [1, 3], [1, 0], [2, 0], [0, 0]])  # fmt: skip
    both = vv.LoadTable(times=t, values=one(t) + 9.80665 * other(t))
    with silence():
        wanted = vv.simulate(
            build(), 0.3, dt=0.01, force=push, base_acceleration=both, initial=[0, 0, 0.001, 0]
        )
    # Straight lines between samples of the half sine.
    assert np.abs(run.state - wanted.state).max() < 1e-5 * np.abs(wanted.state).max()


@pytest.mark.parametrize(
    ("load", "says"),
    [
        ("shape='half_sine', amplitude=1", "duration"),
        ("shape='half_sine', amplitude=1, duration=0", "duration = 0: must be greater than 0"),
        ("shape='half_sine', amplitude=1, duration=1, phase=1", "phase"),
        ("shape='half_sine', amplitude=1, duration=1, unit='g'", "unit"),
        ("shape='half', amplitude=1, duration=1", "did you mean 'half_sine'"),
        ("shape='sawtooth', kind='base', amplitude=1, duration=1", "must be 'force' or 'accel"),
        ("kind='acceleration', amplitude=1", "needs a shock"),
        ("shape='trapezoid', amplitude=1, duration=1, rise=0.7, fall=0.5",
         "rise + fall = 1.2: must be at most the duration, 1"),
        ("shape='chirp', amplitude=1, duration=1, hz=0 2, sweep='logarithmic'",
         "hz = 0, 2: must be greater than 0"),
        ("shape='chirp', amplitude=1, duration=1, hz=0 1e6", "cycles, must be at most"),
        ("kind='unbalance', shape='run_up', amplitude=1, duration=1, speed=0 0",
         "speed = 0, 0: must not be negative, and not both 0"),
        ("kind='unbalance', shape='run_up', amplitude=1, duration=1", "speed"),
        ("shape='run_up', amplitude=1, duration=1, speed=0 9", "kind = 'force': must be 'unbal"),
        ("kind='unbalance', shape='step', amplitude=1", "must be 'force' or 'acceleration'"),
        ("kind='unbalance', shape='run_up', amplitude=1, duration=1, speed=0 9, phase='nu'",
         "phase"),
        ("shape='record', times=0 1 1, values=0 1 2", "after 1: must be strictly increasing"),
        ("shape='record', times=0 1 2, values=0 1", "must match"),
        ("shape='record', times=0, values=1", "must have at least 2 times"),
        ("shape='record', times=0 1, values=0 nan", "finite"),
        ("shape='record', file='bad.csv'", "bad.csv:2: a line must be two finite numbers"),
        ("shape='record', file='../bad.csv'", "must be in the folder"),
        ("kind='acceleration', shape='step', amplitude=1, on='c'", "on"),
        ("kind='acceleration', shape='step', amplitude=1, on='a' /\n"
         "&load kind='acceleration', shape='step', amplitude=1", "must have on, or none"),
    ],
)  # fmt: skip
def test_what_a_shock_cannot_be_is_refused_in_a_line(solve, tmp_path, load, says):
    (tmp_path / "bad.csv").write_text("0 1\n1 nan\n")
    scene = f"{SYSTEMS['system'][0]}&load {load} /\n&transient t_end=1 /\n"
    check_refused(solve, tmp_path, scene, says)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("frequencies=1", "coordinate"),
        ("coordinate='c', frequencies=1", "c"),
        ("coordinate='a', frequencies=0", "must be greater than 0"),
        ("coordinate='a', frequencies=1, damping=1",
         "damping = 1: must be less than 1 (a damping ratio: 5 % of critical is 0.05)"),
        ("coordinate='a', frequencies=1, damping=-0.1", "damping = -0.1: must not be negative"),
        ("coordinate='a', from=2, to=1, count=5", "to = 1: must be greater than from = 2"),
        ("coordinate='a', frequencies=1, unit='g'", "unit"),
        ("times=0 1, values=0 1, coordinate='a', frequencies=1", "coordinate"),
    ],
)  # fmt: skip
def test_what_a_shock_spectrum_cannot_be_is_refused_in_a_line(solve, tmp_path, text, says):
    head = f"{SYSTEMS['system'][0]}&load shape='step', amplitude=1 /\n"
    scene = f"{head}&transient t_end=1, dt=0.1 /\n&shock_spectrum {text} /\n"
    check_refused(solve, tmp_path, scene, says)


def test_shocks_of_other_results_are_refused(solve, tmp_path):
    head = f"{SYSTEMS['system'][0]}&load shape='step', amplitude=1 /\n"
    for result, says in [
        ("&response nu=1", "is a load of &transient only"),
        ("&transient t_end=1 /\n&spectrum", "must have dt"),
        ("&transient t_end=1, dt=0.1, keep='last' /\n&shock_spectrum coordinate='a', frequencies=1",
         "needs the states all along"),
    ]:  # fmt: skip
        check_refused(solve, tmp_path, f"{head}{result} /\n", says)


def test_doubtful_records_are_reported_in_the_same_words(solve, tmp_path):
    scene = tmp_path / "doubts.nml"
    t = np.arange(100) * 0.01
    for values, unit in [
        (5000 * np.sin(t), "m/s^2"), (600 * np.sin(20 * t) * (t < 0.5), "g"),
        (0.3 + 2 * np.sin(40 * t) * (abs(t - 0.5) < 0.1), "m/s^2"),
        (2 * np.sin(40 * t), "m/s^2"),
    ]:  # fmt: skip
        numbers = f"times={' '.join(map(str, t))}, values={' '.join(map(str, values))}"
        scene.write_text(
            f"{SYSTEMS['system'][0]}&load kind='acceleration', shape='record', unit='{unit}',"
            f" {numbers} /\n&transient t_end=0.1, dt=0.01 /\n"
        )
        lines = [x for x in solve(scene, "--out", tmp_path).stderr.splitlines() if x]
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            vv.run(scene)
        assert lines == [f"warning: {one.message}" for one in caught]
        assert bool(lines) == (values.max() > 2 or values[0] > 0)
