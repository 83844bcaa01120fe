"""
A beam on a hardening spring
============================

A clamped beam of twenty finite elements with a cubic spring at its tip: 40 coordinates are
condensed to a single one.
"""

import numpy as np
import viscovib as vv

n, h, area, bending = 20, 0.7 / 20, 0.014**2, 2.05e11 * 0.014**4 / 12
k = bending / h**3 * np.array(
    [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
     [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
)  # fmt: skip
m = 7800 * area * h / 420 * np.array(
    [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
     [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
)  # fmt: skip
stiffness, mass = np.zeros((2, 2 * n + 2, 2 * n + 2))
for i in range(n):
    stiffness[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += k
    mass[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += m
spring = vv.Spring(on="x39", law="6e9*d^3")
beam = vv.Structure(
    mass=mass[2:, 2:], stiffness=stiffness[2:, 2:], modal_damping=0.01, elements=[spring]
)
branch = vv.trace_response(
    beam, (2 * np.pi * 15, 2 * np.pi * 60), load={"x39": 1.0}, coordinates=["x39"], tolerance=1e-6
)
vv.plot_branch(branch)
