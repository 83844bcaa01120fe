"""Vibration of a rigid body on viscoelastic mounts with memory, and of a spring pendulum."""

from importlib.metadata import version as _version

from viscovib.branch import Branch, Crossing, trace_response
from viscovib.characteristic import CharacteristicRoots
from viscovib.decay import FreeDecay, free_decay
from viscovib.ensemble import Ensemble, simulate_ensemble
from viscovib.errors import (
    ConvergenceWarning,
    FileError,
    InputError,
    StabilityWarning,
    SweepError,
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
from viscovib.maps import plot_map
from viscovib.mount import Mount
from viscovib.pendulum import Pendulum
from viscovib.plots import plot_branch, plot_response, plot_sections, plot_spectrum, plot_trajectory
from viscovib.response import Peak, Response, forced_response, plan_response
from viscovib.scene import Scene, SceneResult, plan, run
from viscovib.spectrum import (
    Lines,
    Spectrum,
    amplitudes_at,
    dominant_frequencies,
    name_frequencies,
    spectrum,
)
from viscovib.sweep import sweep
from viscovib.trajectory import Trajectory
from viscovib.transient import simulate

__version__ = _version("viscovib")

__all__ = [
    "AbelKernel",
    "Branch",
    "CharacteristicRoots",
    "ConvergenceWarning",
    "Crossing",
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
    "SweepError",
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
    "plot_map",
    "plot_response",
    "plot_sections",
    "plot_spectrum",
    "plot_trajectory",
    "run",
    "simulate",
    "simulate_ensemble",
    "spectrum",
    "sweep",
    "trace_response",
]
