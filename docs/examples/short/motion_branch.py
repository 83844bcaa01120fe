"""
Periodic motions with a contact, followed in time
=================================================

Two masses, one with a stiff spring behind a gap of 1. The motion becomes unstable by a period
doubling just before the branch folds. Both are located in time, with exact contact times.
"""

import numpy as np
import viscovib as vv

springs = np.array([[1, -1], [-1, 2]])
masses = vv.PolynomialSystem(
    mass=[1, 1], stiffness=springs, damping=0.03 * springs, forces={"x1": "100*max(x1 - 1, 0)"}
)
near = [-1.7437, -0.5182, -0.6096, 0.2772]
branch = vv.trace_motion(masses, (0.754, 0.757), load=[0, 0.1], initial=near, max_step=0.2)
print(branch.summary())
branch.plot()
