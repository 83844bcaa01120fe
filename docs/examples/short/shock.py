"""
A shock
=======

A pulse of force acts for 3 s on a body on a rubber mount with memory.
"""

import numpy as np
import viscovib as vv

kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel)
t = np.linspace(0, 3, 61)
pulse = vv.LoadTable(times=t, values=np.sin(np.pi * t / 3) ** 2, interpolation="cubic")
vv.plot_trajectory(vv.simulate(mount, 40, dt=0.05, force=pulse))
