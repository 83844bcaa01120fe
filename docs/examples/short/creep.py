"""
Creep under a constant load
===========================

A constant force acts from t = 0 on. The deflection of the rubber mount keeps increasing.
"""

import matplotlib.pyplot as plt
import viscovib as vv

kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
body = vv.PolynomialSystem(mass=1, stiffness=10, damping=2, kernel=kernel)
motion = vv.simulate(body, 100, load={0: 0.1j}, nu=1, tolerance=1e-8)
fig, ax = plt.subplots()
ax.plot(motion.t, motion.coordinate("x"))
ax.axhline(0.01, ls="--", color="0.5", label="without memory")
ax.set(xlabel="t (s)", ylabel="x (m)")
ax.legend()
