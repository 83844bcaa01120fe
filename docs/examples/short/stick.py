"""
Dry friction that sticks
========================

Dry friction, 0.6 sign(v), holds a mass while the other forces on it are less than 0.6. Left: a
motion that rests twice in each period (grey). Right: the fraction of a period at rest, over
frequency and load. Black: always at rest. White: never at rest.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

brake = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.6*sign(x_dot)")
run = vv.simulate(brake, 50, dt=0.05, load=1.0, nu=0.4)
late = run.t > 20
t, x, v = run.t[late], *run.state[late].T
_, (time, plane) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
time.plot(t, x, "k", label="x (m)")
time.plot(t, v, "k--", label="velocity (m/s)")
time.fill_between(t, -1.2, 1.8, where=v == 0, color="0.85")
time.set(xlabel="time (s)", ylim=(-1.2, 1.8))
time.legend(loc="upper center", ncols=2)
nu, loads = np.linspace(0.2, 1.6, 15), np.linspace(0.4, 2.0, 17)
held = np.empty((loads.size, nu.size))
for i, j in np.ndindex(held.shape):
    period = 2 * np.pi / nu[j]
    tail = vv.simulate(brake, 6 * period, dt=period / 40, load=loads[i], nu=nu[j])
    held[i, j] = np.mean(tail.state[-40:, 1] == 0)
shades = plane.pcolormesh(nu, loads, held, cmap="Greys", vmin=0, vmax=1)
plt.colorbar(shades, label="held part of a period")
plane.set(xlabel=r"circular frequency $\nu$ (rad/s)", ylabel="load (N)")
