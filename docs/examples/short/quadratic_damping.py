"""
A hardening spring in water
===========================

Drag is proportional to the square of the speed, c v|v|. Small motions are almost undamped, large
motions strongly damped. Linear damping that suits the middle load is too strong for smaller and
too weak for larger loads. Solid: quadratic damping. Dashed: linear damping.
"""

import matplotlib.pyplot as plt
import viscovib as vv

_, ax = plt.subplots()
for forces, style in (("0.4*x_dot*abs(x_dot)", "-"), ("0.22*x_dot", "--")):
    drag = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.01, forces=f"0.5*x^3 + {forces}")
    for load, grey in ((0.05, "0.6"), (0.15, "0.35"), (0.45, "0")):
        branch = vv.trace_response(drag, (0.6, 2.0), load=load, harmonics=9, tolerance=1e-3)
        amplitude = branch.amplitude("x") / load
        ax.plot(branch.nu, amplitude, style, color=grey, label=f"{load:g} N" * (style == "-"))
ax.set(xlabel=r"circular frequency $\nu$ (rad/s)", ylabel="amplitude per load (m/N)")
ax.legend()
