"""Draws the picture of the README's first screen and of the landing page.

python docs/first_screen.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

LOADS = {0.05: "#7aa6c2", 0.12: "#3c6e97", 0.2: "#0b2d51"}


def main() -> None:
    """Compute and draw."""
    rubber = vv.RzhanitsynKernel(amplitude=0.012, alpha=0.1, beta=0.05)
    machine = vv.PolynomialSystem(mass=1, stiffness=10, forces="60*x^3", kernel=rubber)
    fig, ax = plt.subplots(figsize=(7.2, 3.4), layout="constrained")
    for load, colour in LOADS.items():
        branch = vv.trace_response(machine, (2, 5), load=load)
        stable = np.array(branch.stable) == 1
        amplitude = branch.amplitude("x")
        for wanted, style in ((stable, "-"), (~stable, "--")):
            near = wanted | np.roll(wanted, 1) | np.roll(wanted, -1) if style == "--" else wanted
            ax.plot(
                branch.nu,
                np.where(near, amplitude, np.nan),
                style,
                color=colour,
                lw=1.8,
                label=f"{load:g} N" if style == "-" else None,
            )
        if len(branch.folds):
            folds = [c.parameter for c in branch.crossings if c.kind == "fold"]
            at = [int(np.abs(branch.nu - nu).argmin()) for nu in folds]
            ax.plot(branch.nu[at], amplitude[at], "o", color=colour, ms=5, mfc="white")
    ax.set(xlabel="circular frequency of the load (rad/s)", ylabel="displacement (m)")
    ax.set(xlim=(2, 5), ylim=(0, None))
    ax.grid(alpha=0.25)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(title="force", frameon=False, loc="upper left")
    fig.savefig(Path(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
