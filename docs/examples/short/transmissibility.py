"""
Transmissibility of a rubber mount in dB
========================================

The supports move by 1 mm. The curve is the motion of the machine relative to it.
Above 0 dB the mount amplifies, below 0 dB it isolates.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel)
nu = np.geomspace(0.3, 30, 800)
response = vv.forced_response(mount, nu, base=1e-3)

fig, ax = plt.subplots()
ax.semilogx(nu / (2 * np.pi), 20 * np.log10(response.amplitude("x") / 1e-3))
ax.axhline(0, color="0.6", lw=0.8)
ax.set(xlabel="frequency (Hz)", ylabel="transmissibility (dB)")
ax.grid(alpha=0.3)
