"""Vibration of a rigid body on viscoelastic mounts with memory, and of a spring pendulum."""

from importlib.metadata import version as _version

from viscovib.branch import Branch, Crossing
from viscovib.characteristic import CharacteristicRoots
from viscovib.driven import DrivenResponse
from viscovib.driven_branch import BranchPoint, DrivenBranch
from viscovib.ensemble import Ensemble, simulate_ensemble
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
from viscovib.pendulum import Pendulum
from viscovib.periodic import forced_response, trace_response
from viscovib.plots import plot_branch, plot_response, plot_sections, plot_spectrum, plot_trajectory
from viscovib.response import Peak, Response, plan_response
from viscovib.scene import Scene, SceneResult, plan, run
from viscovib.spectrum import (
    Lines,
    Spectrum,
    amplitudes_at,
    dominant_frequencies,
    name_frequencies,
    spectrum,
)
from viscovib.transient import Trajectory, simulate

__version__ = _version("viscovib")

__all__ = [
    "AbelKernel",
    "Branch",
    "BranchPoint",
    "CharacteristicRoots",
    "ConvergenceWarning",
    "Crossing",
    "DrivenBranch",
    "DrivenResponse",
    "Ensemble",
    "FileError",
    "InputError",
    "Kernel",
    "Lines",
    "Mount",
    "Peak",
    "Pendulum",
    "PronyKernel",
    "RabotnovKernel",
    "Response",
    "RzhanitsynKernel",
    "Scene",
    "SceneResult",
    "Spectrum",
    "StabilityWarning",
    "TabulatedKernel",
    "Trajectory",
    "ViscovibError",
    "amplitudes_at",
    "dominant_frequencies",
    "forced_response",
    "fourier_coefficients",
    "name_frequencies",
    "plan",
    "plan_response",
    "plot_branch",
    "plot_response",
    "plot_sections",
    "plot_spectrum",
    "plot_trajectory",
    "run",
    "simulate",
    "simulate_ensemble",
    "spectrum",
    "trace_response",
]
