"""After how many periods of the load the driven pendulum repeats, over its frequency and size.

    python docs/examples/bifurcation_map.py [--size 160] [--out out/bifurcation_map]

Every point is a motion from the same start; its last states at whole periods of the load tell the
period, 0 standing for motions that do not repeat within eight (quasi-periodic or chaotic ones, and
those that have not settled yet).
"""

import argparse
import time
from pathlib import Path

import numpy as np
import viscovib as vv

PENDULUM = vv.Pendulum(
    e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.06, c2=0.06, c3=0.06, m02=0.1, p3=0.95
)
PERIODS, LONGEST, SAME = 150, 8, 1e-3


def period(p3: np.ndarray, m02: np.ndarray) -> dict[str, np.ndarray]:
    """Periods of the load after which each motion repeats."""
    motions = vv.simulate_ensemble(
        PENDULUM, initial=(0, 0, 0, 0, 0.1, 0), n_periods=PERIODS, discard=PERIODS - 2 * LONGEST,
        sections=3, dt=0.3, parameters={"p3": p3, "m02": m02}, n_threads=1,
    )  # fmt: skip
    points = motions.sections
    # Whole turns do not count.
    points[:, :, 2::2] = np.sin(points[:, :, 2::2])
    repeats = np.zeros(p3.size)
    for k in range(LONGEST, 0, -1):
        change = np.abs(points[:, k:] - points[:, :-k]).max(axis=(1, 2))
        repeats[change < SAME] = k
    repeats[motions.outcome != "completed"] = np.nan
    return {"period": repeats}


def main() -> None:
    """Compute and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=160, help="values of each parameter")
    parser.add_argument("--threads", type=int, help="as many as processors")
    parser.add_argument("--out", type=Path, default=Path("out/bifurcation_map"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    n = options.size
    grid = {"p3": np.linspace(0.75, 1.25, n), "m02": np.linspace(0.01, 0.4, n)}
    begun = time.perf_counter()
    data = vv.sweep(
        period, grid, checkpoint=options.out / f"map_{n}.zarr", vectorized=True,
        n_threads=options.threads,
    )  # fmt: skip
    taken = time.perf_counter() - begun
    print(f"{n * n} motions in {taken:.1f} s: {n * n / taken:.0f} a second")
    for k, count in zip(*np.unique(data.period, return_counts=True), strict=True):
        print(f"period {k:g}: {count / n**2:.4f}")

    import matplotlib

    matplotlib.use("Agg")
    ax = vv.plot_map(data.period.transpose(), label="period, in periods of the load")
    ax.set(xlabel=r"frequency of the load $p_3$", ylabel=r"size of the load $m_{02}$")
    ax.figure.savefig(options.out / f"map_{n}.png", dpi=150)
    print(options.out / f"map_{n}.png")


if __name__ == "__main__":
    main()
