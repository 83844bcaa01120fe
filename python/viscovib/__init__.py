"""Vibration of a rigid body on viscoelastic mounts with memory, and of a spring pendulum."""

from importlib.metadata import version as _version

from viscovib._backbone import Backbone, BackbonePoint
from viscovib._plan import Plan
from viscovib._spectrum import Spectrum, name_frequencies, spectrum
from viscovib._sweep import sweep
from viscovib.branch import Branch
from viscovib.characteristic import CharacteristicRoots
from viscovib.cubic_system import CubicSystem
from viscovib.curves import BranchPoint, Crossing
from viscovib.decay import FreeDecay, free_decay
from viscovib.driven import DrivenResponse
from viscovib.driven_branch import DrivenBranch
from viscovib.ensemble import Ensemble, simulate_ensemble
from viscovib.errors import (
    ConvergenceWarning,
    FileError,
    InputError,
    RangeWarning,
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
from viscovib.lines import Lines, amplitudes_at, dominant_frequencies
from viscovib.load import fourier_coefficients
from viscovib.load_table import LoadTable
from viscovib.maps import plot_map
from viscovib.mount import Mount
from viscovib.multiple_scales import MultipleScales
from viscovib.past import Past
from viscovib.pendulum import Pendulum
from viscovib.periodic import backbone, forced_response, plan_response, trace_response
from viscovib.periodic_motions import PeriodicMotions
from viscovib.plots import (
    plot_backbone,
    plot_branch,
    plot_response,
    plot_sections,
    plot_spectrum,
    plot_trajectory,
)
from viscovib.polynomial_system import Monomial, PolynomialSystem, Springs
from viscovib.response_result import Peak, Response
from viscovib.results import Result
from viscovib.scales_plots import plot_modulation, plot_scales_response
from viscovib.scales_results import Modulation, Resonance, ScalesMotion, ScalesResponse
from viscovib.scene import Scene
from viscovib.scene_job import SceneResult, plan
from viscovib.scene_run import run
from viscovib.table_result import TableResult
from viscovib.trajectory import Trajectory
from viscovib.transient import simulate

__version__ = _version("viscovib")

__all__ = [
    "AbelKernel",
    "Backbone",
    "BackbonePoint",
    "Branch",
    "BranchPoint",
    "CharacteristicRoots",
    "ConvergenceWarning",
    "Crossing",
    "CubicSystem",
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
    "Modulation",
    "Monomial",
    "Mount",
    "MultipleScales",
    "Past",
    "Peak",
    "Pendulum",
    "PeriodicMotions",
    "Plan",
    "PolynomialSystem",
    "PronyKernel",
    "RabotnovKernel",
    "RangeWarning",
    "Resonance",
    "Response",
    "Result",
    "RzhanitsynKernel",
    "ScalesMotion",
    "ScalesResponse",
    "Scene",
    "SceneResult",
    "Spectrum",
    "Springs",
    "StabilityWarning",
    "SweepError",
    "TableResult",
    "TabulatedKernel",
    "Trajectory",
    "ViscovibError",
    "amplitudes_at",
    "backbone",
    "dominant_frequencies",
    "forced_response",
    "fourier_coefficients",
    "free_decay",
    "name_frequencies",
    "plan",
    "plan_response",
    "plot_backbone",
    "plot_branch",
    "plot_map",
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
    "sweep",
    "trace_response",
]
