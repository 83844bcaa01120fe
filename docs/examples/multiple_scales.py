"""The paper on the spring pendulum, section by section, by the method of multiple scales.

Run as ``python docs/examples/multiple_scales.py [FOLDER]``. FOLDER of the figures:
out/multiple_scales by default.
Numbers of the set P1: e = 0.1, w2 = 0.4, w3 = 0.8, alpha = 0.5.
"""

import sys
import time
import warnings
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

matplotlib.use("Agg")

BODY = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5}
_DARK, _WARM = "#0b1d51", "#c8452e"
DAMPED = {**BODY, "c1": 0.005, "c2": 0.005, "c3": 0.005}


def _section(title):
    print(f"\n== {title}")


def _model():
    _section("1. Model, its modes, and what the modes do to each other")
    ms = vv.MultipleScales(vv.Pendulum(**BODY))
    print("natural frequencies", ms.frequencies)
    print("mode shapes (columns; z, phi, psi)", *ms.mode_shapes, sep="\n  ")
    print(
        "interaction gamma: frequency j shifts by sum_k gamma_jk b_k^2", *ms.interaction, sep="\n  "
    )


def _resonances():
    _section("2. Conditions of resonance up to third order, under three loads")
    pend = vv.Pendulum(**BODY, f0=0.01, m01=0.01, m02=0.01, p1=0.93, p2=0.37, p3=0.71)
    found = vv.MultipleScales(pend).resonances()
    orders = [sum(r.order == k for r in found) for k in (1, 2, 3)]
    print(f"{len(found)} conditions, {orders} of orders 1, 2, 3; near are")
    for resonance in found:
        if resonance.near:
            print("  ", resonance)


def _free_motion(folder):
    _section("3. Motion far from resonance with the loads, and its error")
    sizes = 0.2 * 2.0 ** -np.arange(7.0)
    errors, estimates = [], []
    t = np.linspace(0, 60, 241)
    for size in sizes:
        pend = vv.Pendulum(**BODY, m02=0.02 * size, p3=0.55)
        initial = size * np.array([0.3, 0.1, 0.2, -0.05, -0.15, 0.05])
        motion = vv.MultipleScales(pend).motion(t, initial)
        exact = vv.simulate(pend, 60, times=t, initial=initial, tolerance=1e-13).state
        errors.append(abs(motion.state - exact)[:, ::2].max())
        estimates.append(motion.error_estimate.max())
    powers = np.log2(np.array(errors[:-1]) / errors[1:])
    print("error falls by the powers", powers.round(2), "of the amplitude: 4 is the theory")
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    axis.loglog(sizes, errors, "o-", color=_DARK, label="against integration, to t = 60")
    axis.loglog(sizes, estimates, "s--", color=_WARM, ms=4, label="own estimate")
    axis.loglog(
        sizes, errors[-1] * (sizes / sizes[-1]) ** 4, ":", color="0.4", label="amplitude$^4$"
    )
    axis.set_xlabel("size of the motion")
    axis.set_ylabel("largest error of a coordinate")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False)
    figure.savefig(folder / "error.png", dpi=110)


def _integrated(pend, state, periods=150):
    """First harmonic of z after a long time, by direct integration."""
    period = 2 * np.pi / pend.p1
    times = np.linspace((periods - 1) * period, periods * period, 65)[:-1]
    run = vv.simulate(pend, periods * period, times=times, initial=state, tolerance=1e-9)
    return 2 * abs(np.fft.fft(run.state[:, 0])[1]) / 64


def _one_resonance(folder):
    _section("4. Steady motion near p1 ~ w1: all branches, stability, two references")
    pend = vv.Pendulum(**DAMPED, f0=0.002, p1=1.02)
    ms = vv.MultipleScales(pend)
    values = np.linspace(1.0, 1.05, 1000)
    start = time.perf_counter()
    response = ms.response("p1", values)
    print(f"{response.index.size} motions at 1000 values in {time.perf_counter() - start:.4f} s")
    print("Routh's column of the first:", response.routh_hurwitz(0).round(4))
    figure, axis = plt.subplots(figsize=(7, 4.2), layout="constrained")
    branch = vv.trace_response(pend, p1=(1.0, 1.05), stability=False)
    axis.plot(branch.parameter, branch.amplitude("z"), color="0.75", lw=4, label="harmonic balance")
    vv.plot_scales_response(response, axis, dofs=["z"])
    points = []
    for p1 in np.linspace(1.0, 1.04, 9):
        here = vv.Pendulum(**DAMPED, f0=0.002, p1=p1)
        at_value = vv.MultipleScales(here)
        steady = at_value.response("p1", [p1])
        for i in np.flatnonzero(steady.stable):
            state = at_value.motion([0.0], amplitudes=steady.amplitudes[i]).state[0]
            points.append((p1, _integrated(here, state), steady.amplitude("z")[i]))
    points = np.array(points)
    error = abs(points[:, 2] / points[:, 1] - 1)
    print(f"against direct integration: {len(points)} stable motions differ by {error.max():.2%}")
    print(f"folds of the balance at {branch.folds.round(4)}")
    axis.plot(points[:, 0], points[:, 1], "o", mfc="none", mec="black", ms=9, label="integrated")
    lines, labels = axis.get_legend_handles_labels()
    labels = [f"multiple scales, {t}" if t.endswith("stable") else t for t in labels]
    axis.legend(lines, labels, frameon=False, loc="upper left")
    axis.set_ylim(bottom=0)
    figure.savefig(folder / "response.png", dpi=110)


def _mount_response(folder):
    _section("5. The mount with memory, against harmonic balance")
    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    body = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
    mount = vv.Mount(**body, kernel=kernel)
    nu = np.linspace(1.3, 1.75, 136)
    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    for load, colour in ((0.05, "#7fa7d9"), (0.1, "#3566ab"), (0.15, _DARK)):
        steady = vv.MultipleScales(mount, load=load, nu=1.5).response("nu", nu)
        exact = vv.forced_response(mount, nu, load=load, method="newton")
        axis.plot(steady.at, steady.amplitude("x"), color=colour, label=f"{load} N")
        last = axis.plot(nu[::9], exact.amplitude("x")[::9], "o", mfc="none", color=_WARM, ms=5)
        error = abs(steady.harmonics - exact.coefficients[:, :, 0])[:, 0] / steady.amplitude("x")
        estimate = steady.harmonic_errors[:, 0] / steady.amplitude("x")
        print(f"load {load}: differs by at most {error.max():.2%}, estimate {estimate.max():.2%}")
    last[0].set_label("harmonic balance")
    axis.set_xlabel(r"$\nu$ (rad/s)")
    axis.set_ylabel(r"amplitude $|x_1|$ (m)")
    axis.set_ylim(bottom=0)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False)
    figure.savefig(folder / "mount.png", dpi=110)


def _three_resonances():
    _section("6. Three loads at once, each near its mode")
    pend = vv.Pendulum(**DAMPED, f0=0.001, m01=0.0004, m02=0.002, p1=1.03, p2=0.375, p3=1.08)
    ms = vv.MultipleScales(pend)
    response = ms.response("p2", np.linspace(0.36, 0.39, 7))
    counts = np.bincount(response.index)
    print("steady motions at each value of p2:", counts)
    print("of them stable:", np.bincount(response.index, response.stable).astype(int))


def _transient(folder):
    _section("7. Non-steady motion at w1 ~ 2 w2: exchange of energy")
    pend = vv.Pendulum(e=0.05, w2=0.525, w3=0.75, alpha=0.1, c1=0.001, c2=0.001, c3=0.001)
    initial = [0.04, 0, 0.01, 0, 0, 0]
    t = np.linspace(0, 600, 6001)
    motion = vv.MultipleScales(pend).motion(t, initial)
    exact = vv.simulate(pend, 600, times=t, initial=initial, tolerance=1e-10)
    # Steps are counted where both give the end alone.
    end = vv.MultipleScales(pend).modulation([600.0], initial, accuracy=1e-8)
    alone = vv.simulate(pend, 600, initial=initial, tolerance=1e-8, keep="last")
    print(f"{end.steps} steps of the modulation equations, {alone.stats['steps']} of the motion")
    axes = vv.plot_modulation(motion, exact)
    axes[-1].set_xlabel(r"$\tau = \omega_1 t$")
    axes[0].figure.savefig(folder / "modulation.png", dpi=100)


def _main():
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/multiple_scales")
    folder.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", vv.RangeWarning)
    _model()
    _resonances()
    _free_motion(folder)
    _one_resonance(folder)
    _mount_response(folder)
    _three_resonances()
    _transient(folder)
    print(f"\npictures in {folder}")


if __name__ == "__main__":
    _main()
