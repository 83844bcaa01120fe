"""
Branch of a pendulum
====================

The angle of the body over the frequency of a moment, through its folds.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

pend = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.02, c2=0.02, c3=0.02, m01=0.005, p2=0.37)
branch = vv.trace_response(pend, p2=(0.25, 0.6))
stable = np.array(branch.stable) == 1
phi = branch.amplitude("phi")

fig, ax = plt.subplots()
ax.plot(branch.parameter, np.where(stable, phi, np.nan), "-", label="stable")
ax.plot(branch.parameter, np.where(stable, np.nan, phi), "--", label="unstable")
ax.set(xlabel="frequency of the moment", ylabel="amplitude of phi (rad)")
ax.legend()
