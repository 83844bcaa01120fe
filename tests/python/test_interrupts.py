"""Ctrl-C in native calls that would take minutes, in parts or in a thread."""

import contextlib
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
import viscovib as vv
from viscovib import _native

KERNEL = vv.RabotnovKernel(amplitude=0.05, alpha=0.3, beta=1)
TIMES = np.linspace(0.1, 10, 3_000_000)


@pytest.fixture
def interrupted():
    """Run something and interrupt it; return the processor time of this thread after that."""

    def stop(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, stop)

    def run(work, after):
        begun = time.thread_time()
        signal.setitimer(signal.ITIMER_REAL, after)
        try:
            with pytest.raises(KeyboardInterrupt):
                work()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        return time.thread_time() - begun - after

    yield run
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize(
    "work",
    [
        # Minutes of work each.
        lambda: KERNEL.relaxation(TIMES),
        lambda: vv.PronyKernel(weights=np.ones(3000), rates=np.arange(3000.0)).transform(TIMES),
        lambda: vv.TabulatedKernel(
            times=np.arange(3000.0), values=np.exp(-0.01 * np.arange(3000.0))
        ).laplace(TIMES),
    ],
)
def test_long_work_is_left_between_its_parts(interrupted, work):
    assert interrupted(work, 0.2) < 5


def test_modulation_over_a_long_time_is_left(interrupted):
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.001, forces="0.1*x^3")
    scales = vv.MultipleScales(system, load=0.05, nu=1.02)
    assert interrupted(lambda: scales.motion([1e10], [0.1, 0]), 0.2) < 1


def test_work_apart_leaves_its_caller_free(interrupted):
    """A task that cannot be divided runs in its own thread; its caller only waits."""
    going_on = threading.Event()

    def work():
        going_on.wait(20)

    assert interrupted(lambda: _native.apart(work), 0.2) < 0.2
    going_on.set()


FAST = vv.RabotnovKernel(amplitude=6.0, alpha=0.3, beta=1000)
REMEMBERING = {
    "mount": vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
        kernel=vv.SumKernel(parts=[FAST, KERNEL]),
    ),
    "structure": vv.Structure(
        mass=[1.0, 1.0], stiffness=[[2.0, -1], [-1, 2]],
        elements=[vv.Spring(on="x2", stiffness=1, law="d^3", kernel=FAST)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REMEMBERING)
def test_first_steps_with_memory_are_left(interrupted, name):
    """A step with unbounded work takes seconds of quadrature; the core stops it too."""
    before = threading.active_count()
    load = {"x1": 1e300} if name == "structure" else 1e300

    def work():
        for _ in range(100):
            with contextlib.suppress(vv.ViscovibError), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                vv.simulate(REMEMBERING[name], 10, load=load, nu=2.0)

    assert interrupted(work, 0.5) < 0.3
    until = time.monotonic() + 60
    while threading.active_count() > before and time.monotonic() < until:
        time.sleep(0.01)
    assert threading.active_count() <= before


CLOSED = vv.RzhanitsynKernel(amplitude=0.05, alpha=0.1, beta=0.05)
WITHOUT_QUADRATURE = {
    "mount": vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
        kernel=vv.PronyKernel(weights=[0.1], rates=[1]), kernel_phi=CLOSED,
    ),
    "structure": vv.Structure(
        mass=[1.0, 1.0], stiffness=[[2.0, -1], [-1, 2]],
        elements=[vv.Spring(on="x2", stiffness=1, law="d^3", kernel=CLOSED)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WITHOUT_QUADRATURE)
def test_short_motions_need_no_thread(monkeypatch, name):
    """A thread costs a third of the time of a motion without quadrature of weights."""
    monkeypatch.setattr(_native, "apart", lambda *_: pytest.fail("a thread"))
    load = {"x1": 0.5} if name == "structure" else 0.5
    vv.simulate(WITHOUT_QUADRATURE[name], 10, load=load, nu=2.0, dt=0.1, keep="last")


LONG = """&structure mass=1 2 stiffness=2 1 damping=0.1 0.1 /
&kernel kind='rabotnov' amplitude=0.5 alpha=0.4 beta=1.5 /
&element on='x1' law='5*max(d - 0.1, 0) + 0.3*d' kernel=1 /
&element on='x2' law='0.2*sign(v)' kernel=0 /
&load on='x1' amplitude=0.8 /
&transient t_end=1e7 nu=0.9 tolerance=1e-6 /
"""


@pytest.mark.parametrize("way", ["run", "sweep"])
def test_scenes_that_the_core_computes_are_left(interrupted, tmp_path, way):
    """The core releases the lock meanwhile, and stops."""
    scene = tmp_path / "a.nml"
    scene.write_text(LONG)
    before, begun = threading.active_count(), time.monotonic()
    if way == "run":
        interrupted(lambda: vv.run(scene), 0.5)
    else:
        grid = {"transient.t_end": [1e7, 1e7 + 1]}
        interrupted(lambda: vv.sweep(scene, grid, progress=False, n_threads=1), 0.5)
    # Each of the two alone would take ten minutes.
    assert time.monotonic() - begun < 60
    until = time.monotonic() + 60
    while threading.active_count() > before and time.monotonic() < until:
        time.sleep(0.01)
    assert threading.active_count() <= before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGALRM, signal.SIGTERM])
def test_handlers_that_raise_nothing_change_nothing(number):
    """The work is repeated, and the signal handler is restored."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.01, forces="x^3")
    plain = vv.simulate(system, 3e4, initial=[1, 0], dt=0.05, keep="last")
    heard = []

    def handler(*_):
        heard.append(1)

    before = signal.signal(number, handler)
    sender = threading.Timer(0.02, signal.pthread_kill, (threading.get_ident(), number))
    try:
        sender.start()
        run = vv.simulate(system, 3e4, initial=[1, 0], dt=0.05, keep="last")
        sender.join()
        assert heard == [1]
        assert (run.state == plain.state).all()
        assert run.outcome == "completed"
        assert signal.getsignal(number) is handler
    finally:
        signal.signal(number, before)


def test_long_signals_are_transformed_apart(monkeypatch):
    """The same numbers in both ways, also from several threads at once."""
    signal_ = np.random.default_rng(1).normal(size=4096)
    plain = vv.spectrum(signal_, 0.1).coefficients
    lines = vv.amplitudes_at(signal_, 0.1, [3.0]).amplitude
    series = vv.fourier_coefficients(signal_, 5)
    seen = []
    apart = _native.apart
    monkeypatch.setattr(_native, "MANY_SAMPLES", 100)
    monkeypatch.setattr(_native, "apart", lambda work, *a: seen.append(1) or apart(work, *a))
    assert (vv.spectrum(signal_, 0.1).coefficients == plain).all()
    assert (vv.amplitudes_at(signal_, 0.1, [3.0]).amplitude == lines).all()
    assert vv.fourier_coefficients(signal_, 5) == series
    assert len(seen) >= 3


def test_parts_are_the_whole(monkeypatch):
    mu = np.linspace(0.1, 10, 1001)
    pendulum = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, f0=0.1, p1=0.9)
    states = np.random.default_rng(1).uniform(-0.5, 0.5, (7, 11, 6))
    body = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=KERNEL)

    def found():
        return [
            KERNEL.transform(mu), KERNEL.laplace(mu + 1j), KERNEL.relaxation(mu[:20]),
            pendulum.rhs(0.3, states), pendulum.jacobian(0.3, states), pendulum.energy(states),
            body.dynamic_stiffness(mu),
        ]  # fmt: skip

    whole = found()
    monkeypatch.setattr(_native, "_PART", 3e-6)
    for one, other in zip(whole, found(), strict=True):
        assert one.shape == other.shape
        assert (one == other).all()


DOUBLE_WELL = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3", names=("x",))
TURNING = vv.Body(
    mass=10, inertia=[0.2, 0.2, 0.3], geometry="exact",
    mounts=[
        vv.MountPoint(name="f", position=[0.1, 0.1, -0.1], stiffness=[1e5, 1e5, 2e5],
                      damping=[1, 1, 1], law="1e10*d^3", rotational_stiffness=[1e3] * 3)
    ],
)  # fmt: skip
CHAIN = {
    "mass": [1] * 6, "stiffness": 2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1),
    "rayleigh": (0.01, 0.01),
}  # fmt: skip
SOFT = vv.Structure(**CHAIN, elements=[vv.Spring(on="x3", law="0.1*tanh(3*d)")])
STICKING = vv.Structure(**CHAIN, elements=[vv.Jenkins(on="x3", stiffness=2, limit=0.1)])
LOAD = {"x1": 0.3}
#: A short call of each analysis, with the latest kinds of systems.
SHORT = {
    "basins": lambda: vv.basins(
        DOUBLE_WELL, {"x": [0.5, -0.5], "x_dot": [0.1, 0.2]}, t_end=5, dt=0.1
    ),
    "Lyapunov": lambda: vv.simulate_ensemble(
        DOUBLE_WELL, t_end=5, dt=0.1, initial=np.ones((3, 2)), lyapunov="all"
    ),
    "turning branch": lambda: vv.trace_response(
        TURNING, (1, 3), load=10 * TURNING.load([0, 0, 1]), harmonics=3
    ),
    "turning response": lambda: vv.forced_response(
        TURNING, [1, 2], load=10 * TURNING.load([0, 0, 1]), method="newton", harmonics=3,
        stability=True,
    ),
    "structure branch": lambda: vv.trace_response(SOFT, (0.05, 0.2), load=LOAD, harmonics=3),
    "structure response": lambda: vv.forced_response(
        SOFT, [0.1, 0.2], load=LOAD, method="newton", harmonics=3, stability=True
    ),
    "structure backbone": lambda: vv.backbone(
        SOFT, mode=0, amplitude_range=(1e-3, 0.1), harmonics=3
    ),
    "friction branch": lambda: vv.trace_response(STICKING, (0.05, 0.2), load=LOAD, harmonics=3),
}  # fmt: skip
#: Plans, readers and systems, which take microseconds, and retrieval of results.
QUICK = {
    "branch plan", "end_call", "free_object", "law compile", "law values",
    "response modes", "response plan", "system lost modes", "system oscillator",
}  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", SHORT)
def test_what_may_take_long_is_called_apart(monkeypatch, name):
    """Only plans, and parts of a result, run in the main thread, where native calls do not end."""
    monkeypatch.setattr(_native, "_HEARS", False)
    here, apart = set(), set()

    def watched(routine, function):
        def called(*arguments):
            alone = threading.current_thread() is threading.main_thread()
            name = arguments[0].partition(b";")[0].decode() if routine == "begin_call" else routine
            (here if alone else apart).add(name)
            return function(*arguments)

        return called

    for routine in dir(_native.core):
        if not routine.startswith("_"):
            found = watched(routine, getattr(_native.core, routine))
            monkeypatch.setattr(_native.core, routine, found)
    # Short ensembles run directly.
    monkeypatch.setattr("viscovib.analyses.ensemble._SHORT", 0)
    SHORT[name]()
    assert apart
    assert here <= QUICK


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", [name for name in SHORT if "branch" in name])
def test_what_is_cancelled_begins_no_piece(monkeypatch, name):
    """Native loops check the flag of Ctrl-C before each part."""
    SHORT[name]()
    pieces = []
    apart = _native.apart

    def cancelled(work):
        def given_up():
            _native._listening.flag[0] = 1
            return work()

        before = _native.core.pieces_of_work()
        try:
            return apart(given_up)
        finally:
            pieces.append(_native.core.pieces_of_work() - before)

    monkeypatch.setattr(_native, "_HEARS", False)
    monkeypatch.setattr(_native, "apart", cancelled)
    with contextlib.suppress(vv.InputError):
        SHORT[name]()
    assert pieces == [0]


ROOM = """
import resource, viscovib as vv
body = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
branch = vv.trace_response(body, (0.5, 0.52), load=0.05, max_points=100_000, harmonics=151,
                           symmetric=False)
assert branch.nu.size < 100
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def test_room_for_many_points_is_not_touched():
    """f2py zeroes returned arrays while holding the GIL: seconds for gigabytes."""
    done = subprocess.run([sys.executable, "-c", ROOM], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 300_000, "kB; the room has 490 MB"
