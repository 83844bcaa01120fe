"""
A Poincare section of a chaotic motion
======================================

States at 2000 whole periods of the load, for a body with two equilibria.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

duffing = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
period = 2 * np.pi / 1.2
motion = vv.simulate(
    duffing,
    2100 * period,
    initial=[0.5, 0],
    load=0.5,
    nu=1.2,
    dt=period / 20,
    times=period * np.arange(100, 2100),
)
fig, ax = plt.subplots()
ax.plot(motion.coordinate("x"), motion.coordinate("x_dot"), ".", ms=2)
ax.set(xlabel="x (m)", ylabel="velocity (m/s)")
