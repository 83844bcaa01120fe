"""Vibration of a rigid body on viscoelastic mounts with memory."""

from importlib.metadata import version as _version

from viscovib.errors import (
    ConvergenceWarning,
    FileError,
    InputError,
    StabilityWarning,
    ViscovibError,
)
from viscovib.kernels import (
    AbelKernel,
    Kernel,
    PronyKernel,
    RabotnovKernel,
    RzhanitsynKernel,
    TabulatedKernel,
)
from viscovib.load import fourier_coefficients
from viscovib.mount import Mount
from viscovib.plots import plot_response
from viscovib.response import Peak, Response, forced_response, plan_response
from viscovib.scene import Scene, SceneResult, plan, run

__version__ = _version("viscovib")

__all__ = [
    "AbelKernel",
    "ConvergenceWarning",
    "FileError",
    "InputError",
    "Kernel",
    "Mount",
    "Peak",
    "PronyKernel",
    "RabotnovKernel",
    "Response",
    "RzhanitsynKernel",
    "Scene",
    "SceneResult",
    "StabilityWarning",
    "TabulatedKernel",
    "ViscovibError",
    "forced_response",
    "fourier_coefficients",
    "plan",
    "plan_response",
    "plot_response",
    "run",
]
