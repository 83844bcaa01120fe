"""Vibration of a rigid body on viscoelastic mounts with memory, and of a spring pendulum."""

from importlib.metadata import version as _version

from viscovib.branch import Branch, Crossing, trace_response
from viscovib.characteristic import CharacteristicRoots
from viscovib.ensemble import Ensemble, simulate_ensemble
from viscovib.errors import (
    ConvergenceWarning,
    FileError,
    InputError,
    RangeWarning,
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
from viscovib.multiple_scales import MultipleScales
from viscovib.pendulum import Pendulum
from viscovib.plots import plot_branch, plot_response, plot_sections, plot_spectrum, plot_trajectory
from viscovib.polynomial import PolynomialSystem
from viscovib.response import Peak, Response, forced_response, plan_response
from viscovib.scales_plots import plot_modulation, plot_scales_response
from viscovib.scales_results import Modulation, Resonance, ScalesMotion, ScalesResponse
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
    "CharacteristicRoots",
    "ConvergenceWarning",
    "Crossing",
    "Ensemble",
    "FileError",
    "InputError",
    "Kernel",
    "Lines",
    "Modulation",
    "Mount",
    "MultipleScales",
    "Peak",
    "Pendulum",
    "PolynomialSystem",
    "PronyKernel",
    "RabotnovKernel",
    "RangeWarning",
    "Resonance",
    "Response",
    "RzhanitsynKernel",
    "ScalesMotion",
    "ScalesResponse",
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
    "plot_modulation",
    "plot_response",
    "plot_scales_response",
    "plot_sections",
    "plot_spectrum",
    "plot_trajectory",
    "run",
    "simulate",
    "simulate_ensemble",
    "spectrum",
    "trace_response",
]
