"""
Grazing of a stop
=================

Far from its resonance a mass moves freely in front of a stop at 0.5 (dashed). Where it first
touches the stop (circles) the curve departs from the curve without a stop (grey). On the right it
turns back there in a fold. Dotted: unstable motions.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

given = dict(mass=1, stiffness=1, damping=0.08)
free = vv.PolynomialSystem(**given)
stop = vv.PolynomialSystem(**given, forces="5*max(x - 0.5, 0)")
nu = np.linspace(0.7, 1.6, 300)
alone = vv.forced_response(free, nu, load=0.12, method="newton")
branch = vv.trace_response(stop, (0.7, 1.6), load=0.12, harmonics=9, tolerance=1e-2, stability=True)
height = np.array([branch.waveform(i)[1].max() for i in range(branch.nu.size)])
_, ax = plt.subplots()
ax.plot(nu, alone.amplitude("x"), color="0.6")
for part, style in ((branch.stable, "-"), (~branch.stable, ":")):
    ax.plot(branch.nu, np.where(part, height, np.nan), "k" + style)
touched = nu[np.flatnonzero(np.diff(alone.amplitude("x") > 0.5))]
ax.plot(touched, np.full(touched.size, 0.5), "o", color="k", markerfacecolor="w")
ax.axhline(0.5, color="0.6", linestyle="--")
ax.set(xlabel=r"circular frequency $\nu$ (rad/s)", ylabel="largest x (m)")
