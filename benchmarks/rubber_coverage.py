"""Coverage of 95 % intervals of fitted kernels, counted over random noise.

python benchmarks/rubber_coverage.py [--draws 500] [--out docs/benchmarks/rubber_coverage.csv]
"""

import argparse
import csv
from pathlib import Path

import numpy as np
import viscovib as vv

KERNELS = {
    "rabotnov": vv.RabotnovKernel(amplitude=2.0, alpha=0.5, beta=3.0),
    "rzhanitsyn": vv.RzhanitsynKernel(amplitude=0.05, alpha=0.3, beta=0.05),
    "abel": vv.AbelKernel(amplitude=0.02, alpha=0.1),
}
MODULUS = 2e6


def draw(kernel: vv.Kernel, noise: float, seed: int) -> vv.ModulusData:
    """80 frequencies over eight decades, noise relative to each value."""
    nu = np.geomspace(1e-3, 1e5, 80)
    scatter = 1 + noise * np.random.default_rng(seed).standard_normal((2, nu.size))
    stiff = MODULUS * (1 - kernel.transform(nu))
    return vv.ModulusData(
        frequencies=nu, storage=stiff.real * scatter[0], loss=stiff.imag * scatter[1]
    )


def count(draws: int) -> list[dict[str, object]]:
    """One row per kernel, noise, weights and parameter."""
    rows: list[dict[str, object]] = []
    for kind, kernel in KERNELS.items():
        for noise, weights in ((0.01, "model"), (0.05, "model"), (0.05, "data")):
            fits = [
                vv.fit_kernel(draw(kernel, noise, seed), kind=kind, weights=weights)
                for seed in range(draws)
            ]
            for name in fits[0].interval:
                true = MODULUS if name == "modulus" else getattr(kernel, name)
                ends = np.array([fit.interval[name] for fit in fits])
                inside = np.mean((ends[:, 0] <= true) & (true <= ends[:, 1]))
                rows.append(
                    {
                        "kernel": kind, "noise": noise, "weights": weights, "parameter": name,
                        "draws": draws, "coverage": f"{inside:.3f}",
                    }
                )  # fmt: skip
                print(*rows[-1].values())
    return rows


def main() -> None:
    """Count and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/rubber_coverage.csv"))
    given = parser.parse_args()
    rows = count(given.draws)
    with given.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
