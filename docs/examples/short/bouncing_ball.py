"""
A ball that comes to rest
=========================

A ball falls on a rigid floor and returns with 0.8 of its speed. Infinitely many impacts follow
until t = 4.06, which the result reports. Then the ball rests.
"""

import matplotlib.pyplot as plt
import viscovib as vv

floor = vv.Gap(on={"x1": -1}, gap=0.0, restitution=0.8)
ball = vv.Structure(mass=[[1.0]], stiffness=[[0.0]], elements=[floor])
run = vv.simulate(ball, 5.0, dt=0.01, initial=[1.0, 0.0], load={0: -9.81j}, nu=1.0)
rest = run.resting_since[0, 0]
_, (place, speed) = plt.subplots(2, 1, figsize=(8, 4.4), sharex=True)
place.plot(run.t, run.state[:, 0], "k", linewidth=0.9)
place.set(ylabel="height (m)")
speed.plot(run.t, run.state[:, 1], "k", linewidth=0.9)
speed.set(xlabel="time (s)", ylabel="velocity (m/s)")
for axis in (place, speed):
    axis.axvline(rest, color="0.6", linestyle="--")
place.text(rest, 0.8, f"rests from {rest:.6f} s ", ha="right")
