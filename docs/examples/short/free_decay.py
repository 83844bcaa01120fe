"""
Free decay with memory
======================

The body is released from a deflection. Dashed: the decay of the slowest mode of the linear mount.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel)
motion = vv.simulate(mount, 30, dt=0.05, initial=[0.05, 0, 0, 0])
root = mount.characteristic_roots().oscillatory[0]
fig, ax = plt.subplots()
ax.plot(motion.t, motion.coordinate("x"))
for sign in (1, -1):
    ax.plot(motion.t, sign * 0.05 * np.exp(root.real * motion.t), "--", color="0.5")
ax.set(xlabel="t (s)", ylabel="x (m)")
