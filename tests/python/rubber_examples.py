"""Synthetic measurements of kernels, with and without noise."""

import numpy as np
import viscovib as vv

KERNELS = {
    "rabotnov": vv.RabotnovKernel(amplitude=2.0, alpha=0.5, beta=3.0),
    "rzhanitsyn": vv.RzhanitsynKernel(amplitude=0.05, alpha=0.3, beta=0.05),
    "abel": vv.AbelKernel(amplitude=0.02, alpha=0.1),
}
MODULUS = 2e6
PARAMETERS = ("amplitude", "alpha", "beta")


def made(kernel, noise=0.0, seed=0, n=80, low=1e-3, high=1e5, **more):
    """Storage and loss of a kernel with relative noise on each."""
    nu = np.geomspace(low, high, n)
    scatter = 1 + noise * np.random.default_rng(seed).standard_normal((2, n))
    stiff = MODULUS * (1 - kernel.transform(nu))
    return vv.ModulusData(
        frequencies=nu, storage=stiff.real * scatter[0], loss=stiff.imag * scatter[1], **more
    )


def truth(kernel):
    """True parameters by name."""
    names = [name for name in PARAMETERS if hasattr(kernel, name)]
    return {"modulus": MODULUS, **{name: getattr(kernel, name) for name in names}}
