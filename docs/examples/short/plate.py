"""
A plate on rubber mounts, reduced
=================================

1156 coordinates in sparse matrices are reduced to a few modes and static corrections, with an
error estimate. Right: the motion of the plate at its peak. ``docs/examples/plate_on_mounts.py``
does the same with 1e5 coordinates and a hole.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv
from scipy.sparse import csc_array, kron

n, h, sheet = 16, 1 / 16, 0.006
# Integrals of a beam element's four cubics with each other, of their slopes and bends.
value = h / 420 * np.array(
    [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
     [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
)  # fmt: skip
slope = np.array(
    [[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)],
     [-36, -3 * h, 36, -3 * h], [3 * h, -(h**2), -3 * h, 4 * h**2]]
) / (30 * h)  # fmt: skip
bend = np.array(
    [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
     [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
) / h**3  # fmt: skip
twist = -slope
twist[3, 2], twist[1, 0] = twist[3, 2] + 1, twist[1, 0] - 1
a, b, c, d = (np.zeros((2 * n + 2, 2 * n + 2)) for _ in range(4))
for i in range(n):
    for whole, part in zip((a, b, c, d), (value, slope, bend, twist), strict=True):
        whole[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += part
both = kron(c, a) + kron(a, c) + 1.4 * kron(b, b) + 0.3 * (kron(d, d.T) + kron(d.T, d))
stiffness = 2.05e11 * sheet**3 / 12 / 0.91 * csc_array(both)


def at(i: int, j: int) -> str:
    """Coordinate of the deflection of a node."""
    return f"x{2 * i * (2 * n + 2) + 2 * j + 1}"


rubber = vv.RabotnovKernel(amplitude=4.0, alpha=0.55, beta=16.0)
corners = [at(1, 1), at(1, n - 1), at(n - 1, 1), at(n - 1, n - 1)]
mounts = [vv.Spring(on=on, stiffness=1e5, law="1e11*d^3", kernel=rubber) for on in corners]
plate = vv.Structure(
    mass=7800 * sheet * csc_array(kron(a, a)), stiffness=stiffness, rayleigh=(0.5, 2e-6),
    elements=mounts,
)  # fmt: skip
small = plate.reduce(frequency=2500, loads=[at(5, 6)])
branch = vv.trace_response(
    small, (60, 100), load={at(5, 6): 25.0}, coordinates=[at(5, 6)], tolerance=1e-6, stability=False
)
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
left.plot(branch.nu / 2 / np.pi, 1e3 * branch.amplitude(at(5, 6)))
left.set(xlabel="frequency (Hz)", ylabel="amplitude where it is pushed (mm)")
places = [at(i, j) for i in range(n + 1) for j in range(n + 1)]
peak = int(branch.amplitude(at(5, 6)).argmax())
shape = 1e3 * np.abs(branch.at(places).coefficients[peak, :, 0]).reshape(n + 1, n + 1)
lines = np.linspace(0, 1, n + 1)
fig.colorbar(right.contourf(lines, lines, shape.T, 12), label="amplitude (mm)")
right.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
