"""
A joint that sticks and slips
=============================

A slider with dry friction connects two masses. Small motions stick and only deflect its spring.
Large motions slide and lose energy. So the resonance shifts and is damped as the load increases.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

chain = np.array([[2.0, -1.0], [-1.0, 1.5]])
slider = vv.Jenkins(on=("x1", "x2"), stiffness=1.0, limit=0.1)
joint = vv.Structure(mass=[1, 1], stiffness=chain, damping=0.03 * chain, elements=[slider])
_, ax = plt.subplots()
for load, style in ((0.002, "-"), (0.06, "--"), (0.1, "-.")):
    found = vv.forced_response(
        joint,
        np.linspace(0.7, 1.0, 91),
        load=[0, load],
        method="newton",
        harmonics=31,
        tolerance=1e-2,
    )
    ax.plot(found.nu, found.amplitude("x2") / load, style, color="k", label=f"{load:g} N")
ax.set(xlabel=r"circular frequency $\nu$ (rad/s)", ylabel="amplitude of $x_2$ per load (m/N)")
ax.legend()
