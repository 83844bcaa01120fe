"""
A load with harmonics
=====================

A saw-tooth force: each of its harmonics causes a resonance at a fraction of the natural frequency.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel)
saw = 0.1 * (1 - np.linspace(0, 2, 64, endpoint=False))
load = vv.fourier_coefficients(saw, orders=5)
response = vv.forced_response(mount, np.linspace(0.3, 3, 400), load=load, method="newton")

fig, ax = plt.subplots()
for k, style in ((1, "-"), (2, "--"), (3, ":")):
    ax.semilogy(response.nu, response.amplitude("x", harmonic=k), style, label=f"harmonic {k}")
ax.set(xlabel="circular frequency of the load (rad/s)", ylabel="amplitude of x (m)")
ax.legend()
