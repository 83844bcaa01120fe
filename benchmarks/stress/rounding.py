"""Units, last digits of the input, order of summation, which must not matter."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import viscovib as vv
from scenes import EPS, PENDULUM, START, far, parts_of
from steps import Job
from tally import Row, Tally

NU = np.array([0.7, 1.5, 1.9, 3.0, 7.0])
NAMES = ("mass", "inertia", "offset", "stiffness_x", "stiffness_phi", "amplitude", "beta",
         "damping", "load", "nu")  # fmt: skip
BASE = np.array([1.0, 0.1, 0.5, 10.0, 2.0, 0.03, 0.05, 0.02, 0.3, 1.0])
#: Powers of mass, length and time in each input.
POWERS = np.array([
    [1, 0, 0], [1, 2, 0], [0, 1, 0], [1, 0, -2], [1, 2, -2], [0, 0, -0.25], [0, 0, -1],
    [0, 0, 1], [1, 1, -2], [0, 0, -1],
], dtype=float)  # fmt: skip


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """One job per row."""
    exponents = (-9, -1, 9) if quick else (-9, -6, -3, -1, 1, 3, 6, 9)
    for name in OF_MOUNT:
        yield f"units, {name}", lambda n=name: units(n, exponents)
    for name in OF_MOUNT:
        yield f"ulp, {name}", lambda n=name: of_mount_by_ulp(n)
    for name in OF_PENDULUM:
        yield f"ulp, pendulum, {name}", lambda n=name: pendulum_by_ulp(n)


def body_of(p: np.ndarray, memory: bool = True) -> vv.Mount:
    """The mount with these ten numbers; its damping is proportional to the stiffness."""
    m, i, arm, cx, cp, amplitude, beta, damping = p[:8]
    kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=0.25, beta=beta) if memory else None
    matrix = damping * np.array([[cx, -cx * arm], [-cx * arm, cx * arm**2 + cp]])
    return vv.Mount(
        mass=m,
        inertia=i,
        offset=arm,
        stiffness_x=cx,
        stiffness_phi=cp,
        kernel=kernel,
        damping=matrix,
    )


def _scaled(x: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Rows (x, phi) divided by (offset, 1)."""
    return x / np.array([p[2], 1.0])


def _modes(p: np.ndarray) -> np.ndarray:
    return body_of(p).natural_frequencies() / p[9]


def _roots(p: np.ndarray) -> np.ndarray:
    roots = body_of(p).characteristic_roots()
    found = np.sort_complex(np.asarray(roots.oscillatory)) / p[9]
    return np.concatenate([found.real, found.imag])


def _response(method: str, nu: np.ndarray = NU) -> Callable[[np.ndarray], np.ndarray]:
    def run(p: np.ndarray) -> np.ndarray:
        r = vv.forced_response(
            body_of(p), nu * p[9], load=p[8], method=method, harmonics=9, tolerance=1e-14
        )
        x = r.coefficients[:, :, 0]
        return np.concatenate([_scaled(x.real, p), _scaled(x.imag, p)]).ravel()

    return run


def _motion(p: np.ndarray) -> np.ndarray:
    end = 20 / p[9]
    run = vv.simulate(body_of(p), end, dt=end / 100, load=p[8], nu=1.5 * p[9])
    return np.asarray(_scaled(run.state[:, ::2], p)).ravel()


def _branch(p: np.ndarray) -> np.ndarray:
    branch = vv.trace_response(
        body_of(p, memory=False), (0.5 * p[9], 4 * p[9]), load=1.5 * p[8], tolerance=1e-13
    )
    return np.concatenate([branch.folds / p[9], [branch.peak("x").amplitude / p[2]]])


def _expansion(p: np.ndarray) -> vv.MultipleScales:
    return vv.MultipleScales(body_of(p), load=0.1 * p[8], nu=1.5 * p[9])


def _scales(p: np.ndarray) -> np.ndarray:
    ms = _expansion(p)
    return np.concatenate([ms.frequencies, ms.decay]) / p[9]


def _interaction(p: np.ndarray) -> np.ndarray:
    """Per square of phi, so that units of length cancel."""
    ms = _expansion(p)
    return (ms.interaction / np.abs(ms.mode_shapes[1]) ** 2).ravel() / p[9]


def _exponents(p: np.ndarray) -> np.ndarray:
    branch = vv.trace_response(body_of(p), (0.8 * p[9], 3 * p[9]), load=p[8], tolerance=1e-13)
    first = np.asarray(branch.exponents)[:, 0] / p[9]
    return np.concatenate([first.real, np.abs(first.imag)])


def _backbone(p: np.ndarray) -> np.ndarray:
    body = replace(body_of(p, memory=False), damping=None)
    return np.asarray(vv.backbone(body, 0, (0.01 * p[2], 0.3 * p[2])).nu) / p[9]


OF_MOUNT: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "natural frequencies": _modes,
    "characteristic roots": _roots,
    "linear response": _response("linear"),
    "successive approximations": _response("successive", NU[[0, 1, 3, 4]]),
    "Newton response": _response("newton"),
    "motion with memory": _motion,
    "branch: folds and peak": _branch,
    "stability with memory: exponents": _exponents,
    "backbone": _backbone,
    "multiple scales: modes": _scales,
    "multiple scales: interaction": _interaction,
}
#: Rounding errors of a computation relative to those of its input: factor by which a good method
#: may exceed the condition.
ALLOWED = 200.0


def units(name: str, exponents: tuple[int, ...]) -> Row:
    """The same mount in other units: the change relative to the effect of rounding of its input."""
    job = OF_MOUNT[name]
    tally = Tally(
        "units", name, "mass, length and time in 1e-9 ... 1e9", ALLOWED,
        "change / (condition x epsilon)",
    )  # fmt: skip
    exact = job(BASE)
    condition = _condition(job, exact)
    for which, unit in enumerate(("mass", "length", "time")):
        for e in exponents:
            factors = 10.0 ** (POWERS[:, which] * e)
            label = f"{unit} x 1e{e}"
            made = tally.trial(label, lambda f=factors: job(BASE * f))
            _judge(tally, label, made, exact, condition)
    for e in exponents:
        factors = 10.0 ** (POWERS @ np.array([e, -e, e / 3]))
        made = tally.trial(f"all x 1e{e}", lambda f=factors: job(BASE * f))
        _judge(tally, f"all x 1e{e}", made, exact, condition)
    tally.notes.append(f"condition {condition:.2g}")
    return tally.row()


def _judge(
    tally: Tally, label: str, made: np.ndarray | None, exact: np.ndarray, condition: float
) -> None:
    if made is None:
        return
    tally.check(label, made.shape == exact.shape, f"{made.size} numbers instead of {exact.size}")
    if made.shape == exact.shape:
        tally.measure(label, far(made, exact) / condition / EPS)


def _condition(job: Callable[[np.ndarray], np.ndarray], exact: np.ndarray) -> float:
    """Sum over the inputs: relative change of the result per relative change of the input."""
    total = 1.0
    for i in range(BASE.size):
        up, down = BASE.copy(), BASE.copy()
        up[i] *= 1 + 1e-5
        down[i] *= 1 - 1e-5
        total += far(job(up), job(down)) / 2e-5
    return total


def of_mount_by_ulp(name: str) -> Row:
    """Change each input by one ulp up and down."""
    job = OF_MOUNT[name]
    tally = Tally("one ulp", name, ", ".join(NAMES), ALLOWED, "change / (condition x epsilon)")
    exact = job(BASE)
    condition = _condition(job, exact)
    for i, what in enumerate(NAMES):
        for to in (-np.inf, np.inf):
            p = BASE.copy()
            p[i] = np.nextafter(p[i], to)
            label = f"{what} {'+' if to > 0 else '-'} 1 ulp"
            _judge(tally, label, tally.trial(label, lambda p=p: job(p)), exact, condition)
    tally.notes.append(f"condition {condition:.2g}")
    return tally.row()


def _motion_of_pendulum(method: str) -> Callable[[vv.Pendulum, np.ndarray], np.ndarray]:
    dt = 0.05 if method == "rk4" else 0.25
    return lambda body, start: vv.simulate(
        body, 50, dt=dt, initial=start, method=method, keep="last"
    ).state[-1]


#: Results of a pendulum and an initial state, by name. Steady motions have more damping (by 0.05)
#: and the load p1 only.
OF_PENDULUM: dict[str, Callable[[vv.Pendulum, np.ndarray], np.ndarray]] = {
    "motion, gauss8": _motion_of_pendulum("gauss8"),
    "motion, gauss3": _motion_of_pendulum("gauss3"),
    "motion, rk4": _motion_of_pendulum("rk4"),
    "motion, verner9": _motion_of_pendulum("verner9"),
    "ensemble, dop8": lambda body, start: vv.simulate_ensemble(
        body, initial=np.stack([start, 0.5 * start]), t_end=50, dt=0.25, method="dop8", n_threads=1
    ).state,
    "spectrum of the motion": lambda body, start: parts_of(
        vv.spectrum(vv.simulate(body, 50, dt=0.25, initial=start).state, 0.25).coefficients
    ),
    "periodic motion": lambda body, start: vv.forced_response(
        _settled(body, m01=0.0, m02=0.0), harmonics=15, stability=False
    ).state(0, np.linspace(0, 7, 9)),
    "torus": lambda body, start: vv.forced_response(
        _settled(body, m02=0.0), harmonics=8, stability=False
    ).state(0, np.linspace(0, 50, 20)),
    "multiple scales": lambda body, start: vv.MultipleScales(
        _settled(body, m01=0.0, m02=0.0)
    ).response("p1", [0.9, 1.1]).order_sizes,
}  # fmt: skip


def _settled(body: vv.Pendulum, **change: float) -> vv.Pendulum:
    return replace(body, c1=body.c1 + 0.05, c2=body.c2 + 0.05, c3=body.c3 + 0.05, **change)


def pendulum_by_ulp(name: str) -> Row:
    """Change each parameter and each number of the initial state."""
    tally = Tally(
        "one ulp", f"pendulum: {name}", "14 parameters, 6 numbers of the start", ALLOWED,
        "change / (condition x epsilon)",
    )  # fmt: skip
    names = list(PENDULUM)
    base = np.array([*PENDULUM.values(), *START])

    def job(p: np.ndarray) -> np.ndarray:
        n = len(names)
        values: dict[str, Any] = dict(zip(names, p[:n], strict=True))
        return OF_PENDULUM[name](vv.Pendulum(**values), p[n:])

    exact = job(base)
    condition = 1.0
    moves = []
    for i in range(base.size):
        if base[i] == 0:
            continue
        p = base.copy()
        p[i] *= 1 + 1e-6
        condition += far(job(p), exact) / 1e-6
        moves += [(i, np.inf), (i, -np.inf)]
    for i, to in moves:
        p = base.copy()
        p[i] = np.nextafter(p[i], to)
        label = f"{[*names, 'z', 'vz', 'phi', 'vphi', 'psi', 'vpsi'][i]}"
        made = tally.trial(label, lambda p=p: job(p))
        if made is not None:
            tally.measure(label, far(made, exact) / condition / EPS)
    tally.notes.append(f"condition {condition:.2g}")
    return tally.row()
