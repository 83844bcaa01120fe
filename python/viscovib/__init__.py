"""Vibration of a rigid body on viscoelastic mounts with memory, and of a spring pendulum.

A public name is loaded when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: The public names of each module. Type checkers and editors read the imports below, which a
#: test holds against this table.
_NAMES = {
    "_backbone": "Backbone BackbonePoint",
    "_kramers_kronig": "KramersKronig kramers_kronig",
    "_master_curve": "MasterCurve master_curve",
    "_plan": "Plan",
    "_prony_terms": "PronyTerms prony_terms",
    "_propagate": "Band propagate",
    "_spectrum": "Spectrum name_frequencies spectrum",
    "_sweep": "sweep",
    "amplitude_fit": "AmplitudeFit ProgressiveLaw fit_amplitude fit_progressive jenkins_stiffness",
    "animation": "animate",
    "body": "Body",
    "body_forces": "MountForces",
    "body_modes": "BodyModes",
    "body_plots": "plot_body plot_energy plot_transmissibility",
    "body_report": "report",
    "body_statics": "Sag",
    "branch_result": "Branch",
    "characteristic": "CharacteristicRoots",
    "cubic_system": "CubicSystem",
    "curves": "BranchPoint Crossing",
    "decay": "FreeDecay free_decay",
    "driven": "DrivenResponse",
    "driven_branch": "DrivenBranch",
    "elements": "Coupling Spring",
    "ensemble": "Ensemble simulate_ensemble",
    "errors": "ConvergenceWarning FileError InputError RangeWarning StabilityWarning SweepError "
    "ViscovibError",
    "fit_files": "read_fit read_kernel write_kernel",
    "fit_result": "KernelFit Optimum ParametricFit Profile Sample",
    "kernel_fit": "fit_kernel",
    "kernels": "AbelKernel ExponentialSum Kernel PronyKernel RabotnovKernel RzhanitsynKernel "
    "TabulatedKernel",
    "lines": "Lines amplitudes_at dominant_frequencies",
    "load": "fourier_coefficients",
    "load_table": "LoadTable",
    "maps": "plot_map",
    "motion_plots": "plot_sections plot_spectrum plot_trajectory",
    "mount": "Mount",
    "mount_point": "FluidTrack MountPoint",
    "multiple_scales": "MultipleScales",
    "notebook": "Explorer explore",
    "past": "Past",
    "pendulum": "Pendulum",
    "periodic": "backbone forced_response plan_response trace_response",
    "periodic_motions": "PeriodicMotions",
    "plots": "plot_backbone plot_branch plot_response",
    "polynomial_system": "Monomial PolynomialSystem Springs",
    "prony_fit": "PronyFit",
    "response_result": "Peak Response",
    "results": "Result",
    "rubber_data": "CreepData ModulusData RelaxationData read_creep read_dma "
    "read_dynamic_stiffness read_relaxation",
    "rubber_plots": "plot_cole_cole plot_modulus plot_nomogram plot_van_gurp",
    "scales_plots": "plot_modulation plot_scales_response",
    "scales_results": "Modulation Resonance ScalesMotion ScalesResponse",
    "scene": "Scene",
    "scene_job": "SceneResult plan",
    "scene_run": "run",
    "shift_fit": "ShiftFit ShiftTable fit_shift_law",
    "structure": "Structure",
    "sum_kernel": "SumKernel",
    "table_result": "TableResult",
    "time_temperature": "Arrhenius ShiftLaw ThermalKernel WLF",
    "trajectory": "Trajectory",
    "transient": "simulate",
}
_MODULE = {name: module for module, names in _NAMES.items() for name in names.split()}

if TYPE_CHECKING:
    from viscovib._backbone import (
        Backbone as Backbone,
        BackbonePoint as BackbonePoint,
    )
    from viscovib._kramers_kronig import (
        KramersKronig as KramersKronig,
        kramers_kronig as kramers_kronig,
    )
    from viscovib._master_curve import (
        MasterCurve as MasterCurve,
        master_curve as master_curve,
    )
    from viscovib._plan import Plan as Plan
    from viscovib._prony_terms import (
        PronyTerms as PronyTerms,
        prony_terms as prony_terms,
    )
    from viscovib._propagate import (
        Band as Band,
        propagate as propagate,
    )
    from viscovib._spectrum import (
        Spectrum as Spectrum,
        name_frequencies as name_frequencies,
        spectrum as spectrum,
    )
    from viscovib._sweep import sweep as sweep
    from viscovib.amplitude_fit import (
        AmplitudeFit as AmplitudeFit,
        ProgressiveLaw as ProgressiveLaw,
        fit_amplitude as fit_amplitude,
        fit_progressive as fit_progressive,
        jenkins_stiffness as jenkins_stiffness,
    )
    from viscovib.animation import animate as animate
    from viscovib.body import Body as Body
    from viscovib.body_forces import MountForces as MountForces
    from viscovib.body_modes import BodyModes as BodyModes
    from viscovib.body_plots import (
        plot_body as plot_body,
        plot_energy as plot_energy,
        plot_transmissibility as plot_transmissibility,
    )
    from viscovib.body_report import report as report
    from viscovib.body_statics import Sag as Sag
    from viscovib.branch_result import Branch as Branch
    from viscovib.characteristic import CharacteristicRoots as CharacteristicRoots
    from viscovib.cubic_system import CubicSystem as CubicSystem
    from viscovib.curves import (
        BranchPoint as BranchPoint,
        Crossing as Crossing,
    )
    from viscovib.decay import (
        FreeDecay as FreeDecay,
        free_decay as free_decay,
    )
    from viscovib.driven import DrivenResponse as DrivenResponse
    from viscovib.driven_branch import DrivenBranch as DrivenBranch
    from viscovib.elements import (
        Coupling as Coupling,
        Spring as Spring,
    )
    from viscovib.ensemble import (
        Ensemble as Ensemble,
        simulate_ensemble as simulate_ensemble,
    )
    from viscovib.errors import (
        ConvergenceWarning as ConvergenceWarning,
        FileError as FileError,
        InputError as InputError,
        RangeWarning as RangeWarning,
        StabilityWarning as StabilityWarning,
        SweepError as SweepError,
        ViscovibError as ViscovibError,
    )
    from viscovib.fit_files import (
        read_fit as read_fit,
        read_kernel as read_kernel,
        write_kernel as write_kernel,
    )
    from viscovib.fit_result import (
        KernelFit as KernelFit,
        Optimum as Optimum,
        ParametricFit as ParametricFit,
        Profile as Profile,
        Sample as Sample,
    )
    from viscovib.kernel_fit import fit_kernel as fit_kernel
    from viscovib.kernels import (
        AbelKernel as AbelKernel,
        ExponentialSum as ExponentialSum,
        Kernel as Kernel,
        PronyKernel as PronyKernel,
        RabotnovKernel as RabotnovKernel,
        RzhanitsynKernel as RzhanitsynKernel,
        TabulatedKernel as TabulatedKernel,
    )
    from viscovib.lines import (
        Lines as Lines,
        amplitudes_at as amplitudes_at,
        dominant_frequencies as dominant_frequencies,
    )
    from viscovib.load import fourier_coefficients as fourier_coefficients
    from viscovib.load_table import LoadTable as LoadTable
    from viscovib.maps import plot_map as plot_map
    from viscovib.motion_plots import (
        plot_sections as plot_sections,
        plot_spectrum as plot_spectrum,
        plot_trajectory as plot_trajectory,
    )
    from viscovib.mount import Mount as Mount
    from viscovib.mount_point import (
        FluidTrack as FluidTrack,
        MountPoint as MountPoint,
    )
    from viscovib.multiple_scales import MultipleScales as MultipleScales
    from viscovib.notebook import (
        Explorer as Explorer,
        explore as explore,
    )
    from viscovib.past import Past as Past
    from viscovib.pendulum import Pendulum as Pendulum
    from viscovib.periodic import (
        backbone as backbone,
        forced_response as forced_response,
        plan_response as plan_response,
        trace_response as trace_response,
    )
    from viscovib.periodic_motions import PeriodicMotions as PeriodicMotions
    from viscovib.plots import (
        plot_backbone as plot_backbone,
        plot_branch as plot_branch,
        plot_response as plot_response,
    )
    from viscovib.polynomial_system import (
        Monomial as Monomial,
        PolynomialSystem as PolynomialSystem,
        Springs as Springs,
    )
    from viscovib.prony_fit import PronyFit as PronyFit
    from viscovib.response_result import (
        Peak as Peak,
        Response as Response,
    )
    from viscovib.results import Result as Result
    from viscovib.rubber_data import (
        CreepData as CreepData,
        ModulusData as ModulusData,
        RelaxationData as RelaxationData,
        read_creep as read_creep,
        read_dma as read_dma,
        read_dynamic_stiffness as read_dynamic_stiffness,
        read_relaxation as read_relaxation,
    )
    from viscovib.rubber_plots import (
        plot_cole_cole as plot_cole_cole,
        plot_modulus as plot_modulus,
        plot_nomogram as plot_nomogram,
        plot_van_gurp as plot_van_gurp,
    )
    from viscovib.scales_plots import (
        plot_modulation as plot_modulation,
        plot_scales_response as plot_scales_response,
    )
    from viscovib.scales_results import (
        Modulation as Modulation,
        Resonance as Resonance,
        ScalesMotion as ScalesMotion,
        ScalesResponse as ScalesResponse,
    )
    from viscovib.scene import Scene as Scene
    from viscovib.scene_job import (
        SceneResult as SceneResult,
        plan as plan,
    )
    from viscovib.scene_run import run as run
    from viscovib.shift_fit import (
        ShiftFit as ShiftFit,
        ShiftTable as ShiftTable,
        fit_shift_law as fit_shift_law,
    )
    from viscovib.structure import Structure as Structure
    from viscovib.sum_kernel import SumKernel as SumKernel
    from viscovib.table_result import TableResult as TableResult
    from viscovib.time_temperature import (
        WLF as WLF,
        Arrhenius as Arrhenius,
        ShiftLaw as ShiftLaw,
        ThermalKernel as ThermalKernel,
    )
    from viscovib.trajectory import Trajectory as Trajectory
    from viscovib.transient import simulate as simulate

    __version__: str

else:
    __all__ = sorted(_MODULE)

    def __getattr__(name: str) -> Any:
        """Load a public name, or a module that holds some."""
        if name == "__version__":
            from importlib.metadata import version

            value = version("viscovib")
        elif name in _MODULE:
            from viscovib.errors import named_near

            value = named_near(import_module(f"viscovib.{_MODULE[name]}"), name)
        elif name in _NAMES:
            value = import_module(f"viscovib.{name}")
        else:
            raise AttributeError(f"module 'viscovib' has no attribute {name!r}", name=name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        """List the public names for completion."""
        return sorted({*globals(), *__all__})
