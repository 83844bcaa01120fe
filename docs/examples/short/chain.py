"""
A chain of ten masses
=====================

Ten equal masses between springs. The force acts on the first mass.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

n = 10
stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
chain = vv.PolynomialSystem(mass=np.ones(n), stiffness=stiffness, damping=0.02 * stiffness)
nu = np.linspace(0.05, 2.2, 1000)
response = vv.forced_response(chain, nu, load=0.01)
fig, ax = plt.subplots()
for name, style in (("x1", "-"), ("x5", "--"), ("x10", ":")):
    ax.semilogy(nu, response.amplitude(name), style, label=name)
ax.set(xlabel="circular frequency (rad/s)", ylabel="amplitude (m)")
ax.legend()
