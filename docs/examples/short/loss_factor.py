"""
Loss factor of five kernels
===========================

The loss factor is the imaginary part divided by the real part of the complex stiffness.
"""

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

kernels = {
    "Rzhanitsyn": vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05),
    "Abel": vv.AbelKernel(amplitude=0.05, alpha=0.3),
    "Rabotnov": vv.RabotnovKernel(amplitude=0.3, alpha=0.5, beta=1),
    "Prony": vv.PronyKernel(weights=[0.02, 0.2, 2], rates=[0.1, 1, 10]),
    "measured": vv.TabulatedKernel(times=[0, 0.5, 1, 2, 4], values=[0.4, 0.2, 0.12, 0.05, 0]),
}
nu = np.geomspace(0.01, 1000, 400)
fig, ax = plt.subplots()
for (name, kernel), style in zip(kernels.items(), ["-", "--", "-.", ":", (0, (5, 1))], strict=True):
    ax.loglog(nu, kernel.sine(nu) / (1 - kernel.cosine(nu)), ls=style, label=name)
ax.set(xlabel="circular frequency (rad/s)", ylabel="loss factor", ylim=(1e-3, None))
ax.grid(alpha=0.3)
ax.legend()
