"""Time saved by each skip of a plan: a job, and its twin that needs the skipped part.

The twin differs by a coefficient too small to change a digit, or by an additional output. Both are
run alternately. The table contains the times and the largest difference of the results. Times are
processor times, since the load of the machine would hide gains of a tenth.
"""

import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import viscovib as vv
from timing import show_time

Row = dict[str, Any]
SCENES = Path(__file__).parents[1] / "data" / "scenes"
NU = np.linspace(0.2, 0.9, 1000)
KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
NOTHING = vv.RzhanitsynKernel(amplitude=1e-30, alpha=0.1, beta=0.05)
MOUNT = vv.Mount(
    mass=1.0, inertia=0.1, offset=0.5, stiffness_x=10.0, stiffness_phi=2.0,
    damping=0.02 * np.array([[10.0, -5.0], [-5.0, 4.5]]),
)  # fmt: skip
BODY = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.05, c2=0.05, c3=0.05)
#: Nonzero, but smaller than any digit of a result.
TINY = 1e-30


class Skip(NamedTuple):
    """A job that skips a computation, and its twin; both return numbers that must agree."""

    skip: str
    job: str
    skipping: Callable[[], np.ndarray]
    twin: Callable[[], np.ndarray]


def chain(n: int, coupling: float, kernel: vv.Kernel | None = None) -> vv.PolynomialSystem:
    """Return n Duffing oscillators, neighbours coupled by a spring."""
    stiffness = np.diag(2.0 + np.arange(n)) + coupling * (np.eye(n, k=1) + np.eye(n, k=-1))
    names = [f"x{d + 1}" for d in range(n)]
    return vv.PolynomialSystem(
        mass=np.ones(n), damping=0.1 * np.ones(n), stiffness=stiffness, kernel=kernel,
        names=names, forces={name: f"{name}^3" for name in names},
    )  # fmt: skip


def response(system: Any, **options: Any) -> Callable[[], np.ndarray]:
    """Return the first harmonics, which exist for any number of harmonics."""

    def job() -> np.ndarray:
        found = vv.forced_response(system, NU, **options)
        return np.asarray(found.coefficients[:, :, list(found.harmonics).index(1)])

    return job


def motion(system: Any, t_end: float = 100.0, **options: Any) -> Callable[[], np.ndarray]:
    """Return states in time."""
    return lambda: np.asarray(vv.simulate(system, t_end, **options).state)


def branch(load: Any, **options: Any) -> Callable[[], np.ndarray]:
    """Return the folds of the branch, which do not depend on the location of its points."""
    return lambda: np.asarray(
        vv.trace_response(MOUNT, (0.5, 10), load=load, stability=False, **options).folds
    )


def linear() -> Iterator[Skip]:
    """Linear scenes against negligible nonlinear terms."""
    flat, bent = replace(MOUNT, cubic_scale=0.0), replace(MOUNT, cubic_scale=TINY)
    load = {"load": 0.1}
    for method in ("successive", "newton"):
        yield Skip(
            "linear scene", f"response, {method}",
            response(flat, method=method, **load), response(bent, method=method, **load),
        )  # fmt: skip
    load = {"load": 0.1, "nu": 1.3, "dt": 0.1}
    flat, bent = replace(flat, kernel=KERNEL), replace(bent, kernel=KERNEL)
    yield Skip("linear scene", "motion with memory", motion(flat, **load), motion(bent, **load))


def memory() -> Iterator[Skip]:
    """No memory against negligible kernels."""
    remembering = replace(MOUNT, kernel=NOTHING)
    for method in ("linear", "successive", "newton"):
        load = {"load": 0.02, "method": method}
        yield Skip(
            "no memory", f"response, {method}",
            response(MOUNT, **load), response(remembering, **load),
        )  # fmt: skip
    load = {"load": 0.1, "nu": 1.3, "dt": 0.1}
    yield Skip("no memory", "motion", motion(MOUNT, **load), motion(remembering, **load))


def symmetry() -> Iterator[Skip]:
    """Odd loads against a load with a negligible mean."""
    for method in ("successive", "newton"):
        yield Skip(
            "odd symmetry", f"response, {method}",
            response(MOUNT, load=0.02, method=method),
            response(MOUNT, load={0: 1j * TINY, 1: 0.02}, method=method),
        )  # fmt: skip
    yield Skip("odd symmetry", "branch", branch(0.5), branch({0: 1j * TINY, 1: 0.5}))
    swinging = replace(BODY, m01=0.003, p2=0.37)
    upset = replace(swinging, f0=TINY, p1=0.37)

    def steady(pend: vv.Pendulum) -> Callable[[], np.ndarray]:
        values = np.linspace(0.3, 0.6, 20)
        return lambda: (
            vv.forced_response(pend, nu=values, harmonics=15, stability=False).coefficients
        )

    yield Skip("odd symmetry", "pendulum, harmonic balance", steady(swinging), steady(upset))


def uncoupled() -> Iterator[Skip]:
    """Coordinates at rest against a negligible coupling."""
    for method in ("linear", "successive", "newton"):
        load = {"load": 0.02, "method": method}
        yield Skip(
            "uncoupled mode", f"response of 1 of 6, {method}",
            response(chain(6, 0.0), **load), response(chain(6, TINY), **load),
        )  # fmt: skip
    load = {"load": 0.1, "nu": 1.3, "dt": 0.1}
    yield Skip(
        "uncoupled mode", "motion of 1 of 6", motion(chain(6, 0.0), **load),
        motion(chain(6, TINY), **load),
    )  # fmt: skip
    yield Skip(
        "uncoupled mode", "motion with memory of 1 of 6",
        motion(chain(6, 0.0, KERNEL), **load), motion(chain(6, TINY, KERNEL), **load),
    )  # fmt: skip
    start = np.array([0.05, 0, 0, 0, 0, 0])
    still = replace(BODY, f0=0.01, p1=0.9)
    yield Skip(
        "uncoupled mode", "pendulum that does not swing",
        motion(still, 1000.0, dt=0.25, initial=start),
        motion(replace(still, m01=TINY), 1000.0, dt=0.25, initial=start),
    )  # fmt: skip


def scene(changes: dict[str, str], table: bool = False) -> Callable[[], np.ndarray]:
    """Run the scene of the pendulum with replaced lines; return the last coordinate phi."""
    text = (SCENES / "pendulum_paper.nml").read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    folder = Path(tempfile.mkdtemp())
    (folder / "scene.nml").write_text(text)
    read = vv.Scene.read(folder / "scene.nml")

    def job() -> np.ndarray:
        result = vv.run(read)
        if table:
            result.to_csv(folder / "table.csv")
            if result.spectrum is not None:
                result.spectrum.to_csv(folder / "spectrum.csv")
        return result.trajectory.state[-1, 2:3]

    return job


def outputs() -> Iterator[Skip]:
    """Outputs that are not requested."""
    text = (SCENES / "pendulum_paper.nml").read_text()
    group = text[text.index("&spectrum") :]
    plain = {group: ""}
    yield Skip("no spectrum wanted", "motion of the pendulum", scene(plain), scene({}))
    only = {
        "dt = 0.25\n": "dt = 0.25\n  coordinates = 'phi'\n",
        "window = 'hann'\n": "window = 'hann'\n  coordinates = 'phi'\n",
    }
    yield Skip(
        "one coordinate wanted", "motion, spectrum and tables", scene(only, True), scene({}, True)
    )
    mount = replace(MOUNT, kernel=KERNEL)

    def curve(coordinates: list[str] | None) -> Callable[[], np.ndarray]:
        path = Path(tempfile.mkdtemp()) / "table.csv"

        def job() -> np.ndarray:
            found = vv.forced_response(mount, NU, load=0.02)
            found.to_csv(path, coordinates=coordinates)
            return found.coefficient("x")

        return job

    yield Skip("one coordinate wanted", "response and its table", curve(["x"]), curve(None))
    start = np.array([0.05, 0, 0.3, 0, -0.2, 0])
    long = {"t_end": 50_000.0, "dt": 0.25, "initial": start}

    def last(**options: Any) -> Callable[[], np.ndarray]:
        job = motion(BODY, **long, **options)
        return lambda: job()[-1]

    yield Skip("no trajectory kept", "2e5 steps of the pendulum", last(keep="last"), last())
    last_only = {**plain, "dt = 0.25\n": "dt = 0.25\n  keep = 'last'\n"}
    yield Skip(
        "no trajectory kept", "motion and its table", scene(last_only, True), scene(plain, True)
    )


def zeros() -> Iterator[Skip]:
    """Coefficients that are 0 against negligible ones."""
    powers = [(2, 1), (1, 2), (0, 3), (4, 1), (3, 2), (2, 3), (1, 4), (0, 5)]

    def system(c: float, kernel: vv.Kernel | None = None) -> vv.PolynomialSystem:
        forces = [vv.Monomial(coefficient=1.0, powers=(3, 0), on=0)]
        forces += [vv.Monomial(coefficient=c, powers=p, on=i) for p in powers for i in (0, 1)]
        return vv.PolynomialSystem(
            mass=[1.0, 1.0], damping=[0.1, 0.1], stiffness=[[3.0, -1.0], [-1.0, 4.0]],
            forces=forces, kernel=kernel,
        )  # fmt: skip

    for method in ("successive", "newton"):
        load = {"load": 0.02, "method": method}
        yield Skip(
            "zero coefficients", f"16 of 17 monomials, response, {method}",
            response(system(0.0), **load), response(system(TINY), **load),
        )  # fmt: skip
    load = {"load": 0.1, "nu": 1.3, "dt": 0.1}
    yield Skip(
        "zero coefficients", "16 of 17 monomials, motion", motion(system(0.0), **load),
        motion(system(TINY), **load),
    )  # fmt: skip
    silent = replace(MOUNT, kernel=replace(NOTHING, amplitude=0.0))
    remembering = replace(MOUNT, kernel=NOTHING)
    yield Skip(
        "zero coefficients", "kernel, response", response(silent, load=0.02),
        response(remembering, load=0.02),
    )  # fmt: skip
    yield Skip(
        "zero coefficients", "kernel, motion", motion(silent, **load), motion(remembering, **load)
    )
    series = {k: 0.0 for k in range(3, 41, 2)}
    yield Skip(
        "zero coefficients", "19 of 20 orders of a load",
        response(MOUNT, load={1: 0.02, **series}, method="linear"),
        response(MOUNT, load={1: 0.02, **dict.fromkeys(series, TINY)}, method="linear"),
    )  # fmt: skip


def skips() -> list[Skip]:
    """All pairs."""
    parts = (linear, memory, symmetry, uncoupled, outputs, zeros)
    return [one for part in parts for one in part()]


def difference(one: Skip) -> float:
    """Largest difference of the two results, relative to the largest value."""
    a, b = one.skipping(), one.twin()
    if a.ndim == 3 and a.shape != b.shape:
        raise ValueError(f"{one.skip}, {one.job}: shapes {a.shape} and {b.shape}")
    return float(np.abs(a - b).max() / np.abs(b).max())


def processor_time(job: Callable[[], object], count: int) -> float:
    """Processor time of one call, from ``count`` calls."""
    start = time.process_time()
    for _ in range(count):
        job()
    return (time.process_time() - start) / count


def in_turn(one: Skip, repeats: int = 9, shortest: float = 0.02) -> tuple[float, float, float]:
    """Medians of both times, and of the ratio twin/job."""
    count = max(1, int(shortest / max(processor_time(one.skipping, 1), 1e-6)))
    ours, twins = [], []
    for _ in range(repeats):
        ours.append(processor_time(one.skipping, count))
        twins.append(processor_time(one.twin, count))
    gains = [b / a for a, b in zip(ours, twins, strict=True)]
    return statistics.median(ours), statistics.median(twins), statistics.median(gains)


def run() -> list[Row]:
    """Times of each job and its twin, measured in turn, and their ratio: the gain."""
    rows = []
    for one in skips():
        apart = difference(one)
        ours, twin, gain = in_turn(one)
        rows.append(
            {"skip": one.skip, "job": one.job, "seconds": ours, "twin": twin, "gain": gain,
             "difference": apart}
        )  # fmt: skip
        print(
            f"{one.skip:24} {one.job:40} {show_time(ours):>8} twin {show_time(twin):>8} "
            f"gain {gain:.2f} difference {apart:.1e}"
        )
    return rows
