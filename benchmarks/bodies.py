"""A body in space on its mounts: times of common analyses, compared with NumPy and SciPy."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import scipy.signal
import viscovib as vv
from timing import least, pair, show_time
from viscovib.units import degree, hz, mm, newton_per_mm

Row = dict[str, Any]
DATA = json.loads((Path(__file__).parents[1] / "data" / "engine_on_mounts.json").read_text())
RUBBER = vv.RzhanitsynKernel(amplitude=0.6, alpha=0.4, beta=20)


def engine(kernel: vv.Kernel | None = None, law: str | None = None, directions: int = 1) -> vv.Body:
    """The engine of the table, its mounts nonlinear along local z or in all three directions."""
    mounts = [
        vv.MountPoint(
            name=f"m{i}", position=np.multiply(given["position_mm"], mm),
            stiffness=np.multiply(given["stiffness"], newton_per_mm),
            angles=np.multiply(given["angles"], degree), kernel=kernel,
            law=law if directions == 3 else (None, None, law),
        )
        for i, given in enumerate(DATA["mounts"])
    ]  # fmt: skip
    return vv.Body(mass=DATA["mass"], inertia=DATA["inertia"], mounts=mounts)


def one_by_one(body: vv.Body, n: int) -> np.ndarray:
    """Frequencies of bodies with scattered mounts, one call of SciPy each."""
    springs = body._mount_springs
    factors = np.random.default_rng(0).uniform(0.85, 1.15, (n, springs.stiffness.size))
    rows = springs.rows
    squares = [
        scipy.linalg.eigh((rows.T * (f * springs.stiffness)) @ rows, body.mass, eigvals_only=True)
        for f in factors
    ]
    return np.sqrt(squares) / (2 * np.pi)


def run() -> list[Row]:
    """Time of each job, time of an alternative method if there is one, and their difference."""
    rows: list[Row] = []

    def add(job: str, time: float, other: float, difference: float) -> None:
        rows.append({"job": job, "seconds": time, "other": other, "difference": difference})
        beside = show_time(other) if other == other else ""
        print(f"{job:66} {show_time(time):>8} {beside:>8}  {difference:.1e}")

    nan = float("nan")
    plain, rubber, bent = engine(), engine(RUBBER), engine(RUBBER, "1e10*d^3")
    worst = np.abs(plain.modes().hz - DATA["frequencies_hz"]).max()
    time = least(lambda: (plain.modes(), plain.torque_roll_axis("y")))
    add("modes, energies, torque-roll axis", time, nan, float(worst))

    nu = np.linspace(5, 40, 1000) * hz
    torque = rubber.load(torque=(0, 400, 0))

    def ours() -> np.ndarray:
        found = vv.forced_response(rubber, nu, load=torque, method="linear")
        rubber.mount_forces(found)
        rubber.base_transmissibility(nu, "z")
        return found.coefficients[..., 0]

    def theirs() -> np.ndarray:
        stiffness = np.real(plain.dynamic_stiffness(0.0))
        kept = 1 - RUBBER.transform(nu)[:, None, None]
        dynamic = kept * stiffness - nu[:, None, None] ** 2 * np.asarray(rubber.mass)
        return np.array([np.linalg.solve(d, torque) for d in dynamic])

    mine, others = least(ours), least(theirs)
    difference = np.abs(ours() / theirs() - 1).max()
    add("1000 frequencies: response, 9 mount forces, transmissibility", mine, others, difference)

    point = DATA["nonlinear_with_memory"]["points"][1]

    def branch(stability: bool, harmonics: int) -> vv.Branch:
        return vv.trace_response(
            bent, (5 * hz, 30 * hz), load=torque, harmonics=harmonics, stability=stability,
            at=[24 * hz], tolerance=1e-5,
        )  # fmt: skip

    found = branch(False, 9)
    at = np.flatnonzero(np.isclose(found.nu, 24 * hz))[0]
    off = np.abs(np.abs(found.coefficients[at, :, 0]) / point["first"] - 1).max()
    add(f"branch, {found.nu.size} points, orders to 9", least(lambda: branch(False, 9)), nan, off)
    add("the same with stability", least(lambda: branch(True, 9)), nan, off)
    nine = engine(RUBBER, "1e10*d^3", directions=3)
    points = 0

    def of_nine() -> None:
        nonlocal points
        points = vv.trace_response(
            nine, (5 * hz, 30 * hz), load=torque, harmonics=9, stability=False, tolerance=1e-4
        ).nu.size

    time = least(of_nine)
    add(f"nine nonlinear directions, {points} points, orders to 9", time, nan, nan)

    times = np.array([0, 0.005, 0.011, 1.0])
    push = vv.LoadTable(times=times, values=np.array([0, 1e4, 0, 0])[:, None] * np.eye(6)[2])

    def shocked(tolerance: float) -> vv.Trajectory:
        return vv.simulate(bent, 1.0, force=push, dt="auto", tolerance=tolerance)

    fine, coarse = shocked(1e-11), shocked(1e-8)
    off = np.abs(fine.state[-1] - coarse.state[-1]).max() / np.abs(fine.state).max()
    add("a shock of 1 s at 1e-8", least(lambda: shocked(1e-8)), nan, float(off))

    names = [f"m{i}.{axis}" for i in range(3) for axis in "xyz"]
    names += [f"{name}_ddot" for name in bent.dof_names]

    def with_peaks() -> None:
        run = shocked(1e-8)
        for name in names:
            run.peak(name)

    add("the same with 15 peaks of forces and accelerations", least(with_peaks), nan, nan)

    def in_steps() -> vv.Trajectory:
        return vv.simulate(bent, 1.0, force=push, dt=0.005, method="gauss4", tolerance=1e-8)

    off = np.abs(fine.state[-1] - in_steps().state[-1]).max() / np.abs(fine.state).max()
    add("the same in steps of 5 ms by gauss4", least(in_steps), nan, float(off))

    step, hertz = 1e-4, np.geomspace(0.1, 1000, 1000)
    record = np.cumsum(np.random.default_rng(0).standard_normal(100_001))
    record -= record[0]
    table = vv.LoadTable(times=step * np.arange(record.size), values=record)

    def at_samples(count: int) -> np.ndarray:
        """Largest accelerations at the samples, one call of SciPy for each frequency."""
        found = []
        for w in 2 * np.pi * hertz[:count]:
            parts = ([0.1 * w, w**2], [1, 0.1 * w, w**2])
            above, below, _ = scipy.signal.cont2discrete(parts, step, "foh")
            found.append(np.abs(scipy.signal.lfilter(above[0], below, record)).max())
        return np.array(found)

    def spectrum() -> np.ndarray:
        found = vv.shock_response_spectrum(table, hertz, damping=0.05)
        return np.asarray(found.primary)

    off = np.abs(spectrum()[:100] / at_samples(100) - 1).max()
    mine, others, _ = pair(spectrum, lambda: at_samples(1000))
    add("shock spectrum, 1000 frequencies, 1e5 samples", mine, others, float(off))

    mine, others, _ = pair(lambda: plain.scatter(10_000)[0], lambda: one_by_one(plain, 10_000))
    difference = np.abs(plain.scatter(100)[0] - one_by_one(plain, 100)).max()
    add("10 000 engines, stiffnesses +-15 %", mine, others, float(difference))
    return rows
