"""
Sweeps up and down
==================

Newton's method starts each frequency from the motion at the previous one, like a slow sweep.
The sweeps up and down differ between the folds.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*x^3")
nu = np.linspace(0.6, 2.6, 300)
up = vv.forced_response(duffing, nu, load=0.2, method="newton")
down = vv.forced_response(duffing, nu[::-1], load=0.2, method="newton")

fig, ax = plt.subplots()
ax.plot(up.nu, up.amplitude("x"), ">", ms=3, label="up")
ax.plot(down.nu, down.amplitude("x"), "<", ms=3, mfc="white", label="down")
ax.set(xlabel="circular frequency (rad/s)", ylabel="amplitude of x (m)")
ax.legend()
