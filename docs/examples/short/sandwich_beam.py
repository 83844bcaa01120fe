"""
A sandwich beam with a viscoelastic core
========================================

A clamped beam of two aluminium faces on a core with fractional memory. The shear of each piece of
the core is a spring with a kernel. The loss factors are those of the characteristic roots.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

n, h, face, core = 24, 0.3 / 24, 1e-3, 0.5e-3
bend = 7e10 * face**3 / 6 / h**3 * np.array(
    [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
     [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
)  # fmt: skip
# Coordinates of a node: deflection, slope, and how far the faces slide against each other.
stiffness, mass, shears = np.zeros((75, 75)), np.zeros(75), np.zeros((n, 75))
for i in range(n):
    w, s = [3 * i, 3 * i + 1, 3 * i + 3, 3 * i + 4], [3 * i + 2, 3 * i + 5]
    stiffness[np.ix_(w, w)] += bend
    stiffness[np.ix_(s, s)] += 7e10 * face / 2 / h * np.array([[1, -1], [-1, 1]])
    mass[w] += 5.9 * h * np.array([0.5, h**2 / 420, 0.5, h**2 / 420])
    mass[s] += 2700 * face * h / 4
    shears[i, w], shears[i, s] = (face + core) / core / h * np.array([-1, 0, 1, 0]), 0.5 / core
rubber = vv.RabotnovKernel(amplitude=30.0, alpha=0.6, beta=31.0)
pieces = [vv.Spring(on=e[3:], stiffness=4e6 * core * h, kernel=rubber) for e in shears]
beam = vv.Structure(mass=mass[3:], stiffness=stiffness[3:, 3:], elements=pieces)
hertz = np.linspace(10, 600, 800)
response = vv.forced_response(beam, 2 * np.pi * hertz, load={"x70": 1.0}, coordinates=["x70"])
amplitude = 1e3 * response.amplitude("x70")
fig, ax = plt.subplots()
ax.semilogy(hertz, amplitude)
for s in beam.characteristic_roots(4).oscillatory:
    at = np.argmin(np.abs(hertz - s.imag / 2 / np.pi))
    ax.text(hertz[at], 1.4 * amplitude[at], f"loss {(s**2).imag / (s**2).real:.3f}")
ax.set(xlabel="frequency (Hz)", ylabel="tip under 1 N (mm)", ylim=(None, 4 * amplitude.max()))
