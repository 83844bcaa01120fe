"""
A symmetry-breaking bifurcation
===============================

A second branch bifurcates where motions lose their half-wave symmetry.
"""

import matplotlib.pyplot as plt
import viscovib as vv

duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
options = {"load_range": (0.1, 4), "nu": 1, "load": 1, "symmetric": False, "tolerance": 1e-6}
main = vv.trace_response(duffing, **options)
side = vv.trace_response(duffing, **options, leave=main.branch_points[0], max_points=300)

fig, ax = plt.subplots()
for branch, style, name in ((main, "-", "symmetric"), (side, "--", "broken symmetry")):
    ax.plot(branch.parameter, abs(branch.coefficients[:, 0, 0]), style, label=name)
ax.set(xlabel="load (N)", ylabel="mean of x (m)")
ax.legend()
