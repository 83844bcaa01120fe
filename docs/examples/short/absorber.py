"""
A vibration absorber
====================

A small mass on a soft spring replaces the resonance peak of the body by two small peaks.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

nu = np.linspace(0.6, 1.4, 400)
alone = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02)
absorber = vv.PolynomialSystem(
    mass=[1, 0.05],
    stiffness=[[1.045, -0.045], [-0.045, 0.045]],
    damping=[[0.032, -0.012], [-0.012, 0.012]],
    names=("body", "absorber"),
)
fig, ax = plt.subplots()
ax.semilogy(nu, vv.forced_response(alone, nu, load=0.02).amplitude("x"), "--", label="alone")
ax.semilogy(
    nu, vv.forced_response(absorber, nu, load=0.02).amplitude("body"), label="with absorber"
)
ax.set(xlabel="circular frequency (rad/s)", ylabel="amplitude of the body (m)")
ax.legend()
