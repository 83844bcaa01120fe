"""Vibration of a rigid body on viscoelastic mounts with memory, and of a spring pendulum."""

from importlib.metadata import version as _version

from viscovib.branch import Branch, Crossing
from viscovib.characteristic import CharacteristicRoots
from viscovib.decay import FreeDecay, free_decay
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
    ExponentialSum,
    Kernel,
    PronyKernel,
    RabotnovKernel,
    RzhanitsynKernel,
    TabulatedKernel,
)
from viscovib.load import fourier_coefficients
from viscovib.load_table import LoadTable
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
from viscovib.trajectory import Trajectory
from viscovib.transient import simulate

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
    "ExponentialSum",
    "FileError",
    "FreeDecay",
    "InputError",
    "Kernel",
    "Lines",
    "LoadTable",
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
    "free_decay",
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
