"""Extreme kernels: alpha from 1e-3 to 1, integral from 0 to above 1."""

from collections.abc import Iterator

import mpmath as mp
import numpy as np
import viscovib as vv
from scenes import DAMPING, MOUNT, far, kernel_of, mount
from scipy.integrate import solve_ivp
from steps import Job
from tally import Row, Tally

ALPHAS = (1e-3, 1e-2, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.999, 1.0)
INTEGRALS = (0.0, 1e-12, 0.1, 0.9, 1 - 1e-12, 1.0, 1.5)
SPAN = "alpha = 1e-3 ... 1, integral = 0 ... 1.5"


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """One job per row."""
    alphas = ALPHAS[::2] if quick else ALPHAS
    integrals = INTEGRALS[::3] if quick else INTEGRALS
    yield "amplitude 0", no_amplitude
    for name in ("rzhanitsyn", "abel", "rabotnov"):
        yield f"transforms of {name}", lambda n=name: transforms(n, alphas)
    yield "relaxation", lambda: relaxation(alphas, integrals)
    for tolerance in (1e-4, 1e-8, 1e-12):
        yield "sums of exponentials", lambda e=tolerance: exponentials(alphas, e)
    yield "linear responses", lambda: responses(alphas, integrals)
    yield "responses at rest", lambda: static(alphas, integrals)
    yield "motions", lambda: motions(alphas, integrals, 6 if quick else 24)
    yield "one exponential", lambda: one_exponential(integrals)


def no_amplitude() -> Row:
    """A kernel of amplitude 0 has no effect."""
    tally = Tally(
        "kernel", "amplitude 0 against no kernel", "every kind, t = 0 ... 20", 1e-13,
        "difference of the states over their size",
    )  # fmt: skip
    kinds = (
        vv.RzhanitsynKernel(amplitude=0, alpha=0.3, beta=0.05),
        vv.RzhanitsynKernel(amplitude=0, alpha=1, beta=0.05),
        vv.RabotnovKernel(amplitude=0, alpha=0.3, beta=0.05),
        vv.AbelKernel(amplitude=0, alpha=0.3),
        vv.PronyKernel(weights=[0], rates=[1]),
        vv.TabulatedKernel(times=[0, 1, 2], values=[0, 0, 0]),
        None,
    )

    def run(kernel: vv.Kernel | None) -> vv.Trajectory:
        return vv.simulate(mount(kernel=kernel), 20, dt=0.25, load=0.5, nu=1.5)

    bare = run(None)
    for kernel in kinds[:-1]:
        label = type(kernel).__name__
        made = tally.trial(label, lambda k=kernel: run(k))
        if made is not None:
            tally.check(label, made.outcome == "completed", f"ended {made.outcome}")
            tally.measure(label, far(made.state, bare.state) if made.t.size == bare.t.size else 1)
        if not isinstance(kernel, vv.TabulatedKernel):
            few = tally.trial(label, lambda k=kernel: k.sum_of_exponentials(t_min=0.1, t_max=10))
            tally.check(label, few is None or np.size(few.rates) == 1, "terms of nothing")
    return tally.row()


def transforms(name: str, alphas: tuple[float, ...]) -> Row:
    """R_c and R_s against values with 50 digits."""
    mu = np.concatenate([[1e-300, 1e-30], np.geomspace(1e-9, 1e9, 13), [1e30, 1e300]])
    tally = Tally(
        "kernel", f"transforms, {name}", "alpha = 1e-3 ... 1, beta and mu = 1e-9 ... 1e9, 1e+-300",
        2e-15, "relative error of R_c and of R_s",
    )  # fmt: skip
    for alpha in alphas:
        for beta in (0.0,) if name == "abel" else (1e-9, 0.05, 1.0, 1e9):
            label = f"alpha = {alpha:g}, beta = {beta:g}"
            made = tally.trial(label, lambda a=alpha, b=beta: _kernel(name, a, b).transform(mu))
            if made is None:
                continue
            with mp.workdps(50):
                exact = [_transform(name, alpha, beta, float(m)) for m in mu]
                worst = 0.0
                for value, true in zip(made, exact, strict=True):
                    for part, right in ((value.real, true.real), (value.imag, true.imag)):
                        if abs(right) > 1e-290:
                            worst = max(worst, float(abs(mp.mpf(float(part)) / right - 1)))
            tally.measure(label, worst)
    return tally.row()


def _kernel(name: str, alpha: float, beta: float) -> vv.Kernel:
    if name == "abel":
        return vv.AbelKernel(amplitude=0.05, alpha=alpha)
    kind = vv.RzhanitsynKernel if name == "rzhanitsyn" else vv.RabotnovKernel
    return kind(amplitude=0.05, alpha=alpha, beta=beta)


def _transform(name: str, alpha: float, beta: float, mu: float) -> mp.mpc:
    if name == "rabotnov":
        return mp.mpf(0.05) / (mp.mpc(0, mu) ** mp.mpf(alpha) + mp.mpf(beta))
    return mp.mpf(0.05) * mp.gamma(mp.mpf(alpha)) * mp.mpc(beta, mu) ** -mp.mpf(alpha)


def relaxation(alphas: tuple[float, ...], integrals: tuple[float, ...]) -> Row:
    """1 - integral of R from 0 to t, against the incomplete gamma function with 40 digits."""
    t = np.geomspace(1e-12, 1e6, 19)
    tally = Tally("kernel", "relaxation 1 - int R", SPAN, 1e-14, "absolute error")
    for alpha in alphas:
        for integral in integrals:
            label = f"alpha = {alpha:g}, integral = {integral:g}"
            made = tally.trial(label, lambda a=alpha, i=integral: kernel_of(i, a).relaxation(t))
            if made is None:
                continue
            k = kernel_of(integral, alpha)
            with mp.workdps(40):
                a, b = mp.mpf(k.alpha), mp.mpf(k.beta)
                exact = [
                    float(1 - mp.mpf(k.amplitude) * b**-a * mp.gammainc(a, 0, b * mp.mpf(float(s))))
                    for s in t
                ]
            tally.measure(label, float(np.abs(made - exact).max()))
    return tally.row()


def exponentials(alphas: tuple[float, ...], tolerance: float) -> Row:
    """Sums of exponentials at times that the package does not sample."""
    tally = Tally(
        "kernel", f"sum of exponentials to {tolerance:g}", "alpha = 1e-3 ... 1, 1e-8 < t < 1e3",
        1.5, "relative error / tolerance",
    )  # fmt: skip
    times = np.random.default_rng(1).uniform(np.log(1e-8), np.log(1e3), 3000)
    times = np.exp(np.concatenate([times, np.log([1e-8, 1e3])]))
    most = 0
    for alpha in alphas:
        kernel = kernel_of(0.5, alpha)
        label = f"alpha = {alpha:g}"
        made = tally.trial(
            label,
            lambda k=kernel: k.sum_of_exponentials(tolerance=tolerance, t_min=1e-8, t_max=1e3),
        )
        if made is None:
            continue
        rates, weights = np.asarray(made.rates), np.asarray(made.weights)
        exact = kernel.amplitude * np.exp(-kernel.beta * times) * times ** (alpha - 1)
        close = np.exp(-np.outer(times, rates)) @ weights
        # If both underflow there is nothing to compare.
        seen = exact > 1e-290
        error = np.abs(close[seen] / exact[seen] - 1).max()
        most = max(most, rates.size)
        tally.measure(label, error / tolerance)
    tally.notes.append(f"at most {most} terms")
    return tally.row()


def responses(alphas: tuple[float, ...], integrals: tuple[float, ...]) -> Row:
    """Linear response against the 2 x 2 system with 40 digits, relative to its condition."""
    nu = np.geomspace(1e-6, 1e4, 41)
    tally = Tally(
        "kernel", "linear response of the mount", f"{SPAN}, nu = 1e-6 ... 1e4", 10.0,
        "error / (condition x epsilon)",
    )  # fmt: skip
    for alpha in alphas:
        for integral in integrals:
            label = f"alpha = {alpha:g}, integral = {integral:g}"
            r = tally.trial(
                label,
                lambda a=alpha, i=integral: vv.forced_response(
                    vv.Mount(**MOUNT, kernel=kernel_of(i, a), damping=DAMPING),
                    nu, load=1.0, method="linear", harmonics=1,
                ),
            )  # fmt: skip
            if r is None:
                continue
            k = kernel_of(integral, alpha)
            for i, frequency in enumerate(nu):
                x, condition = linear_response(k, float(frequency))
                made = r.coefficients[i, :, 0]
                error = float(
                    max(abs(mp.mpc(complex(m)) - e) for m, e in zip(made, x, strict=True))
                )
                size = float(max(abs(e) for e in x))
                tally.measure(f"{label}, nu = {frequency:.3g}", error / size / condition / 2.2e-16)
    return tally.row()


def linear_response(kernel: vv.RzhanitsynKernel, nu: float) -> tuple[list[mp.mpc], float]:
    """Solve D X = (1, 0) with 40 digits; condition of D, entry by entry (Skeel)."""
    with mp.workdps(40):
        c, cp, arm = mp.mpf(10), mp.mpf(2), mp.mpf(0.5)
        keep = 1 - mp.mpf(kernel.amplitude) * mp.gamma(kernel.alpha) * mp.mpc(
            kernel.beta, nu
        ) ** -mp.mpf(kernel.alpha)
        n = mp.mpf(nu)
        stiffness = mp.matrix([[c, -c * arm], [-c * arm, c * arm * arm + cp]])
        mass = mp.diag([mp.mpf(1), mp.mpf(0.1)])
        damping = mp.matrix(DAMPING)
        d = stiffness * keep - mass * n**2 + mp.mpc(0, 1) * n * damping
        x = mp.lu_solve(d, mp.matrix([1, 0]))
        inverse = mp.inverse(d)
        # Entries before cancellation, because R and the input have rounding errors.
        size = mp.matrix(2, 2)
        for i in range(2):
            for j in range(2):
                size[i, j] = abs(stiffness[i, j]) * (1 + abs(1 - keep))
                size[i, j] += abs(mass[i, j]) * n**2 + n * abs(damping[i, j])
        moved = [
            sum(abs(inverse[i, j]) * size[j, k] * abs(x[k]) for j in range(2) for k in range(2))
            for i in range(2)
        ]
        top = max(abs(v) for v in x)
        return list(x), max(1.0, float(max(moved) / top))


def static(alphas: tuple[float, ...], integrals: tuple[float, ...]) -> Row:
    """A constant load on a softening spring: only 1 - integral of the stiffness remains."""
    tally = Tally(
        "kernel", "mean under a constant load", SPAN, 100.0, "error / (condition x epsilon)"
    )
    for alpha in alphas:
        for integral in integrals:
            label = f"alpha = {alpha:g}, integral = {integral:g}"
            kernel = tally.trial(label, lambda a=alpha, i=integral: kernel_of(i, a))
            if kernel is None:
                continue
            r = tally.trial(
                label,
                lambda k=kernel: vv.forced_response(
                    vv.Mount(**MOUNT, kernel=k), [1.0], load={0: 0.1j, 1: 0.0},
                    method="linear", harmonics=1,
                ),
            )  # fmt: skip
            if r is None or not r.converged.all():
                continue
            left = 1 - kernel.integral
            if abs(left) < 1e-15:
                # The remaining stiffness is 0 or a rounding error: "singular" or a large result.
                continue
            # 10 left (x - phi/2) = 0.1, 2 left phi = -0.1 (-1/2): phi = 0.025/left.
            exact = np.array([0.01 + 0.0125, 0.025]) / left
            error = far(r.coefficients[0, :, 0].imag, exact)
            tally.measure(label, error / 2.2e-16 / (1 + abs(1 / left)))
    return tally.row()


def motions(alphas: tuple[float, ...], integrals: tuple[float, ...], n: int) -> Row:
    """Memory as exponentials against the whole past, nonlinear, from rest."""
    tally = Tally(
        "kernel", "motion in time, exponentials against direct", f"{SPAN}, t = 0 ... {n}", 1e-11,
        "difference of the states over their size",
    )  # fmt: skip
    for alpha in alphas:
        for integral in integrals:
            label = f"alpha = {alpha:g}, integral = {integral:g}"

            def run(memory: str, alpha: float = alpha, integral: float = integral) -> vv.Trajectory:
                return vv.simulate(
                    mount(kernel=kernel_of(integral, alpha)), n, dt=0.25, load=0.5, nu=1.5,
                    memory=memory,
                )  # fmt: skip

            both = [tally.trial(label, lambda m=m, r=run: r(m)) for m in ("exponentials", "direct")]
            if both[0] is None or both[1] is None:
                continue
            ends = [run.outcome for run in both]
            tally.check(label, ends[0] == ends[1] in ("completed", "diverged"), f"ended {ends}")
            if ends[0] != "completed" or both[0].state.shape != both[1].state.shape:
                continue
            tally.measure(label, far(both[0].state, both[1].state))
    return tally.row()


def one_exponential(integrals: tuple[float, ...]) -> Row:
    """With alpha = 1 memory is one additional differential equation, solved by DOP853 of SciPy."""
    tally = Tally(
        "kernel", "motion in time, alpha = 1, against SciPy", "integral = 0 ... 1.5, t = 0 ... 24",
        1e-10, "difference of the states over their size",
    )  # fmt: skip
    for integral in integrals:
        label = f"integral = {integral:g}"
        run = tally.trial(
            label,
            lambda i=integral: vv.simulate(
                mount(kernel=kernel_of(i, 1.0)), 24, dt=0.125, load=0.5, nu=1.5
            ),
        )
        if run is None:
            continue
        weight = integral * 0.05

        def rates(t: float, y: np.ndarray, weight: float = weight) -> np.ndarray:
            x, phi = y[0], y[2]
            # Spring forces of the cubic geometry; the last four states are their memory.
            sx = 10 * (x - 0.5 * phi) + 10 * 0.5 / 6 * phi**3
            sp = -5 * x + 2.5 * phi + 2.5 * phi**2 * x - 10 * 0.25 * 2 / 3 * phi**3 + 2 * phi
            gx, gp = sx - weight * y[4], sp - weight * y[5]
            return np.array(
                [
                    y[1], 0.5 * np.sin(1.5 * t) - gx, y[3], -gp / 0.1,
                    sx - 0.05 * y[4], sp - 0.05 * y[5],
                ]
            )  # fmt: skip

        exact = solve_ivp(
            rates, (0, 24), np.zeros(6), "DOP853", t_eval=run.t, rtol=1e-13, atol=1e-14
        )
        tally.measure(label, far(run.state, exact.y[:4].T))
    return tally.row()
