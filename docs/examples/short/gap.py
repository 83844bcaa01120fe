"""
A gap that closes
=================

A mass hits a stop at 0.5. Time steps end at each contact, so the method keeps its order. Circles
are contacts, located as events.
"""

import matplotlib.pyplot as plt
import viscovib as vv

stop = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="30*max(x - 0.5, 0)")
hit = vv.Event("x - 0.5", direction="up")
run = vv.simulate(stop, 60, dt=0.02, load=0.8, nu=0.7, events=[hit])
contacts = run.events[0]
_, (time, plane) = plt.subplots(1, 2, figsize=(9, 3.2), width_ratios=(2, 1), layout="constrained")
time.plot(run.t, run.state[:, 0], "k", linewidth=0.9)
time.plot(contacts.t, contacts.state[:, 0], "o", color="k", markerfacecolor="w")
time.axhline(0.5, color="0.6", linestyle="--")
time.set(xlabel="time (s)", ylabel="x (m)")
late = run.t > 25
plane.plot(run.state[late, 0], run.state[late, 1], "k", linewidth=0.9)
plane.axvline(0.5, color="0.6", linestyle="--")
plane.set(xlabel="x (m)", ylabel="velocity (m/s)")
