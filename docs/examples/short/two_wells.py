"""
Basins of two wells
===================

A buckled beam has two equilibria, left and right. The final one depends on the initial state: the
two basins are interleaved.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

beam = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.15, forces="x^3")
x, v = np.linspace(-2, 2, 120), np.linspace(-2, 2, 120)
found = vv.basins(beam, {"x": x, "x_dot": v}, t_end=150, tolerance=1e-3, dt=0.1)
_, ax = plt.subplots()
ax.pcolormesh(x, v, found.labels.T, cmap="Greys", vmin=-1, vmax=2)
for rest in found.attractors:
    ax.plot(*rest[0], "o", color="w", markeredgecolor="k")
ax.set(xlabel="x at the start", ylabel="velocity at the start")
