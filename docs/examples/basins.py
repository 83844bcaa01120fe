"""Basins of attraction of the driven pendulum: a million motions in chunks, on disk as they come.

    python docs/examples/basins.py [--size 1000] [--out out/basins]

The body is driven near its second resonance, where three steady motions exist side by side. The
picture shows to which of them it settles from each initial angle and angular velocity of the body.
Stopped at any time, it goes on from its checkpoint.
"""

import argparse
import resource
import time
from pathlib import Path

import numpy as np
import viscovib as vv

PENDULUM = vv.Pendulum(
    e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.03, c2=0.03, c3=0.03, m02=0.1, p3=0.95
)
PERIODS, STEP = 90, 0.3
#: Sections of one steady motion lie this close to each other once it has settled.
NEAR = 0.05


def sections(psi: np.ndarray, psi_dot: np.ndarray) -> np.ndarray:
    """Last state at a whole period from each start, angles within half a turn of rest."""
    states = np.zeros((psi.size, 6))
    states[:, 4], states[:, 5] = psi, psi_dot
    motions = vv.simulate_ensemble(
        PENDULUM, initial=states, n_periods=PERIODS, discard=PERIODS - 1, sections=3, dt=STEP,
        n_threads=1,
    )  # fmt: skip
    last = motions.sections[:, -1]
    last[:, 2::2] -= 2 * np.pi * np.round(last[:, 2::2] / (2 * np.pi))
    return last


def find_attractors(psi: np.ndarray, psi_dot: np.ndarray) -> np.ndarray:
    """The steady motions that a coarse grid of starts leads to, the most frequent first."""
    meshes = np.meshgrid(psi, psi_dot, indexing="ij")
    found: list[list[np.ndarray]] = []
    for state in sections(*(mesh.ravel() for mesh in meshes)):
        for group in found:
            if np.abs(group[0] - state).max() < NEAR:
                group.append(state)
                break
        else:
            found.append([state])
    found.sort(key=len, reverse=True)
    return np.array([np.mean(group, axis=0) for group in found if len(group) > 2])


def main() -> None:
    """Compute and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=1000, help="starts along each axis")
    parser.add_argument("--threads", type=int, help="as many as processors")
    parser.add_argument("--out", type=Path, default=Path("out/basins"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    attractors = find_attractors(np.linspace(-3, 3, 16), np.linspace(-2, 2, 16))
    print(f"{len(attractors)} steady motions, at whole periods of the load:", attractors.round(4))

    def basin(psi: np.ndarray, psi_dot: np.ndarray) -> dict[str, np.ndarray]:
        distance = np.abs(sections(psi, psi_dot)[:, np.newaxis] - attractors).max(axis=2)
        nearest = distance.argmin(axis=1)
        settled = distance.min(axis=1) < NEAR
        return {"attractor": np.where(settled, nearest + 1.0, np.nan)}

    n = options.size
    grid = {"psi": np.linspace(-np.pi, np.pi, n), "psi_dot": np.linspace(-2, 2, n)}
    begun = time.perf_counter()
    data = vv.sweep(
        basin, grid, checkpoint=options.out / f"basins_{n}.zarr", vectorized=True, chunk=4096,
        n_threads=options.threads,
    )  # fmt: skip
    taken = time.perf_counter() - begun
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{n * n} motions in {taken:.1f} s: {n * n / taken:.0f} a second, {held:.0f} MiB at most")
    shares = [float((data.attractor == k + 1).mean()) for k in range(len(attractors))]
    print("shares:", *(f"{share:.4f}" for share in shares), f"unsettled: {1 - sum(shares):.4f}")

    import matplotlib

    matplotlib.use("Agg")
    ax = vv.plot_map(data.attractor.transpose(), label="steady motion")
    ax.set(xlabel=r"initial $\psi$ (rad)", ylabel=r"initial $\psi'$")
    ax.figure.savefig(options.out / f"basins_{n}.png", dpi=150)
    print(options.out / f"basins_{n}.png")


if __name__ == "__main__":
    main()
