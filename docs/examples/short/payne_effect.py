"""
Rubber that softens with amplitude
==================================

The Payne effect of filled rubber: the kernel makes the stiffness increase with frequency. Sliders
in parallel (`Iwan`) make it decrease with amplitude, with a maximum of the loss in between. Lines:
sum of the first harmonics. Circles: periodic motions of a mass on this mount.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

kernel = vv.RabotnovKernel(amplitude=1.5, alpha=0.5, beta=2.5)
slips, springs = np.geomspace(1e-4, 3e-3, 24), np.full(24, 0.04)
rubber = vv.Spring(on="x1", stiffness=1.0, kernel=kernel)
sliders = vv.Iwan(on="x1", stiffness=springs, limit=springs * slips)
x = np.geomspace(3e-5, 3e-2, 120)
parts = zip(springs, slips, strict=True)
payne = sum(vv.jenkins_stiffness(x, stiffness=k, slip=s) for k, s in parts)
_, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for nu, style in ((0.1, "-"), (1.0, "--"), (10.0, "-.")):
    total = 1 - kernel.transform(nu) + payne
    inertia = 30.0  # m nu^2, so large that the deflection is a sine
    heavy = vv.Structure(mass=[inertia / nu**2], stiffness=[[0.0]], elements=[rubber, sliders])
    given = dict(method="newton", harmonics=11, tolerance=1e-2)
    loads = np.abs((total - inertia) * x)[8::20]
    motions = [vv.forced_response(heavy, [nu], load=[q], **given) for q in loads]
    # u = Im c exp(i nu t) under q sin(nu t).
    c = np.array([found.coefficients[0, 0, list(found.harmonics).index(1)] for found in motions])
    found = loads / c + inertia
    for ax, line, marks in ((axes[0], total.real, found.real), (axes[1], total.imag, found.imag)):
        ax.semilogx(x * 1e3, line, style, color="k", label=f"{nu:g} rad/s")
        ax.plot(np.abs(c) * 1e3, marks, "o", color="k", markerfacecolor="w")
axes[0].set(xlabel="amplitude (mm)", ylabel="storage stiffness (N/m)")
axes[1].set(xlabel="amplitude (mm)", ylabel="loss stiffness (N/m)")
axes[0].legend()
