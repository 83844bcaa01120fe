"""
Response of a body on rubber
============================

Displacement and rotation over the frequency of a force, with as many harmonics as each frequency
needs.
"""

import numpy as np
import viscovib as vv

kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel)
response = vv.forced_response(mount, np.linspace(0.3, 12, 600), load=0.1)
vv.plot_response(response)
