"""
An engine on rubber mounts
==========================

A mode of an engine in space, the kinetic energies of all modes, and the transmissibility from the
floor.
"""

import matplotlib.pyplot as plt
import viscovib as vv

rubber = vv.RzhanitsynKernel(amplitude=0.6, alpha=0.4, beta=20)
places = {"left": (0, 0.46, 0.1), "right": (0, -0.46, 0.1), "rear": (0.25, 0, -0.2)}
stiffness = {"left": (3e5, 3e5, 4e5), "right": (2e5, 1e5, 4e5), "rear": (6e5, 4e5, 2e5)}
mounts = [
    vv.MountPoint(name=name, position=place, stiffness=stiffness[name], kernel=rubber)
    for name, place in places.items()
]
engine = vv.Body(mass=164, inertia=(9.9, 4.1, 9.1), mounts=mounts, gravity=9.81)

fig = plt.figure(figsize=(10, 7), layout="constrained")
vv.plot_body(engine, fig.add_subplot(2, 2, (1, 3), projection="3d"), mode=1, torque_about="y")
vv.plot_energy(engine.modes(), fig.add_subplot(2, 2, 2))
vv.plot_transmissibility(engine, fig.add_subplot(2, 2, 4))
