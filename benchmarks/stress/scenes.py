"""Systems of the stress test, and small tools."""

import math
from typing import Any

import numpy as np
import viscovib as vv

PENDULUM: dict[str, Any] = dict(
    e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01,
    f0=0.005, m01=0.0025, m02=0.005, p1=0.93, p2=0.37, p3=0.71,
)  # fmt: skip
START = (0.05, 0.0, 0.3, 0.0, -0.2, 0.0)
EPS = float(np.finfo(float).eps)
MOUNT: dict[str, Any] = dict(mass=1.0, inertia=0.1, offset=0.5, stiffness_x=10.0, stiffness_phi=2.0)
DAMPING = [[0.2, -0.1], [-0.1, 0.09]]


def kernel_of(integral: float, alpha: float, beta: float = 0.05) -> vv.RzhanitsynKernel:
    """Koltunov-Rzhanitsyn with a given integral A Gamma(alpha) beta^(-alpha)."""
    amplitude = integral * beta**alpha / math.gamma(alpha)
    return vv.RzhanitsynKernel(amplitude=amplitude, alpha=alpha, beta=beta)


def mount(**changes: Any) -> vv.Mount:
    """The reference mount with memory and the given changes."""
    return vv.Mount(**(MOUNT | {"kernel": kernel_of(0.8, 0.25)} | changes))


def far(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference divided by the largest magnitude."""
    size = float(np.abs(other).max())
    gap = float(np.abs(np.asarray(one) - np.asarray(other)).max())
    return gap / size if size > 0 else gap


def parts_of(z: np.ndarray) -> np.ndarray:
    """Real and imaginary parts."""
    return np.stack([np.real(z), np.imag(z)])
