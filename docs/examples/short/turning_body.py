"""
A body with large rotations
===========================

A body that spins about its intermediate axis turns over repeatedly: its spin leaves the axis and
returns to it in the opposite direction. Energy and angular momentum are constant.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

soft = vv.MountPoint(name="m", position=[0, 0, 0], stiffness=[1e-9, 1e-9, 1e-9])
body = vv.Body(mass=1, inertia=[1.0, 2.0, 3.0], mounts=[soft], geometry="exact")
start = np.zeros(12)
start[7::2] = [0.01, 2.0, 0.01]  # rates of the rotation vector (rad/s)
run = vv.simulate(body, 30.0, initial=start, dt=0.02)
vector, angle = run.state[:, 6::2], np.linalg.norm(run.state[:, 6::2], axis=1)
along = vector[:, 1] / np.maximum(angle, 1e-300)
tilt = np.degrees(np.arccos(np.clip(np.cos(angle) + (1 - np.cos(angle)) * along**2, -1, 1)))
momentum, energy = body.angular_momentum(run.state), body.energy(run.state)
lost = np.linalg.norm(momentum - momentum[0], axis=1) / np.linalg.norm(momentum[0])

_, (over, kept) = plt.subplots(2, 1, figsize=(8, 5.4), sharex=True, layout="constrained")
over.plot(run.t, tilt, "k", linewidth=0.9)
over.set(ylabel="tilt of this axis (degrees)", yticks=[0, 90, 180])
kept.plot(run.t, 1e15 * lost, "k", linewidth=0.9, label="angular momentum")
kept.plot(run.t, 1e15 * (energy / energy[0] - 1), "0.5", linestyle="--", label="energy")
kept.set(xlabel="time (s)", ylabel=r"relative change ($10^{-15}$)")
kept.legend(frameon=False)
