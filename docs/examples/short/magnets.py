"""
A pendulum over three magnets
=============================

A steel ball hangs over three magnets. Each shade shows the magnet over which the ball comes to rest
after its release at this point. Near the centre the result is very sensitive.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

turns = 2 * np.pi * np.arange(3) / 3
magnets = np.stack([np.cos(turns), np.sin(turns)], axis=1)
pulls = {
    name: " + ".join(
        f"({name} - ({at[i]:.9f}))/((x1 - ({at[0]:.9f}))^2 + (x2 - ({at[1]:.9f}))^2 + 0.09)^1.5"
        for at in magnets
    )
    for i, name in enumerate(("x1", "x2"))
}
ball = vv.PolynomialSystem(mass=[1, 1], stiffness=[0.5, 0.5], damping=[0.3, 0.3], forces=pulls)
grid = np.linspace(-2, 2, 40)
found = vv.basins(ball, {"x1": grid, "x2": grid}, t_end=50, tolerance=1e-2, dt=0.1)
_, ax = plt.subplots()
ax.pcolormesh(grid, grid, found.labels, cmap="Greys", vmin=-1, vmax=3)
ax.plot(*magnets.T, "o", color="w", markeredgecolor="k")
ax.set(xlabel="$x_1$ at the start", ylabel="$x_2$ at the start", aspect="equal")
