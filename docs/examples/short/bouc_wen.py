"""
Bouc-Wen hysteresis loops
=========================

A wire-rope damper: its force depends on the deflection and on the last reversal. Left: loops at
three amplitudes. Right: a mass on the damper under increasing loads. The energy loss per cycle
limits the resonance, and the stiffness decreases as the loops open.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

rope = vv.BoucWen(on="x1", stiffness=1.0, ratio=0.2, beta=0.7, gamma=0.3, exponent=2)
turn = 2 * np.pi * np.arange(401) / 400
_, (loops, response) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for amplitude, style in ((0.5, "-"), (1.0, "--"), (2.0, "-.")):
    d = amplitude * np.sin(turn[:-1])
    lost = float(rope.energy(d))
    force = np.append(rope.loop(d), rope.loop(d)[0])
    loops.plot(amplitude * np.sin(turn), force, style, color="k", label=f"{lost:.2g} J")
loops.set(xlabel="deflection (m)", ylabel="force (N)")
loops.legend(title="lost in a cycle")
mass = vv.Structure(mass=[[1.0]], stiffness=[[0.0]], damping=[[0.02]], elements=[rope])
for load, style in ((0.05, "-"), (0.2, "--"), (0.5, "-.")):
    nu = np.linspace(0.4, 1.3, 61)
    found = vv.forced_response(mass, nu, load=[load], method="newton", harmonics=11, tolerance=1e-2)
    response.plot(nu, found.amplitude("x1") / load, style, color="k", label=f"{load:g} N")
response.set(xlabel=r"circular frequency $\nu$ (rad/s)", ylabel="amplitude per load (m/N)")
response.legend(title="load")
