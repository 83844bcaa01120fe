"""Vibration of a rigid body on viscoelastic mounts with memory, and of a spring pendulum.

A public name is loaded when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: The public names of each module. Type checkers and editors read the imports below; a test
#: compares them with this table.
_NAMES = {
    "analyses.backbones": "Backbone BackbonePoint",
    "analyses.basins": "Basins basins",
    "analyses.campbell": "Campbell campbell",
    "analyses.decay": "FreeDecay free_decay",
    "analyses.driven": "DrivenResponse",
    "analyses.driven_branch": "DrivenBranch",
    "analyses.ensemble": "simulate_ensemble",
    "analyses.events": "Event",
    "analyses.forced": "forced_response plan_response",
    "analyses.lines": "Lines amplitudes_at dominant_frequencies",
    "analyses.motion_branches": "trace_motion",
    "analyses.multiple_scales": "MultipleScales",
    "analyses.periodic": "backbone trace_response",
    "analyses.shooting": "steady_motion",
    "analyses.shock_spectra": "ShockResponseSpectrum shock_response_spectrum",
    "analyses.spectral": "Spectrum name_frequencies spectrum",
    "analyses.transient": "simulate",
    "bodies.body": "Body",
    "bodies.forces": "MountForces",
    "bodies.modes": "BodyModes",
    "bodies.mount_point": "FluidTrack MountPoint",
    "bodies.piston_engine": "PistonEngine",
    "bodies.statics": "Sag",
    "common.past": "Past",
    "common.periodic_motions": "PeriodicMotions",
    "common.plan": "Plan",
    "common.results": "Result",
    "errors": "ConvergenceWarning FileError InputError RangeWarning StabilityWarning SweepError "
    "ViscovibError",
    "explorer.notebook": "Explorer explore",
    "kernels.relaxation": "AbelKernel ExponentialSum Kernel PronyKernel RabotnovKernel "
    "RzhanitsynKernel",
    "kernels.sum_kernel": "SumKernel",
    "kernels.tabulated": "TabulatedKernel",
    "kernels.time_temperature": "Arrhenius ShiftLaw ThermalKernel WLF",
    "plots.animation": "animate",
    "plots.campbell": "plot_campbell",
    "plots.bodies": "plot_body plot_energy plot_transmissibility",
    "plots.loops": "plot_loop",
    "plots.maps": "plot_map",
    "plots.motions": "plot_sections plot_spectrum plot_trajectory",
    "plots.report_pages": "report",
    "plots.rubber": "plot_cole_cole plot_modulus plot_nomogram plot_van_gurp",
    "plots.scales": "plot_modulation plot_scales_response",
    "plots.steady": "plot_backbone plot_branch plot_motion_branch plot_response",
    "results.beats": "BeatingMotion",
    "results.branch": "Branch",
    "results.curves": "BranchPoint Crossing",
    "results.ensemble": "Ensemble",
    "results.response": "Peak Response",
    "results.modulation": "Modulation Resonance",
    "results.located_peaks": "LocatedPeak LocatedPeaks",
    "results.motion_branch": "MotionBranch",
    "results.motion_forces": (
        "ElementForces FloorForce MountForcesInTime PointMotion SupportReactions"
    ),
    "results.scales": "ScalesMotion ScalesResponse",
    "results.steady_motion": "SteadyMotion",
    "results.trajectory": "Trajectory",
    "rubber.amplitude_fit": "AmplitudeFit ProgressiveLaw fit_amplitude fit_progressive "
    "jenkins_stiffness",
    "rubber.bands": "Band propagate",
    "rubber.data": "CreepData ModulusData RelaxationData",
    "rubber.files": "read_fit read_kernel write_kernel",
    "rubber.fit": "KernelFit Optimum Profile Sample",
    "rubber.kernel_fit": "fit_kernel",
    "rubber.kramers_kronig_pair": "KramersKronig kramers_kronig",
    "rubber.master": "MasterCurve master_curve",
    "rubber.parametric_fit": "ParametricFit",
    "rubber.prony_fit": "PronyFit",
    "rubber.reading": "read_creep read_dma read_dynamic_stiffness read_relaxation",
    "rubber.shift_fit": "ShiftFit ShiftTable fit_shift_law",
    "rubber.terms": "PronyTerms prony_terms",
    "scene.job": "SceneResult plan",
    "scene.scene": "Scene",
    "scene.table": "TableResult",
    "sweeps.run_scene": "run",
    "sweeps.sweeping": "sweep",
    "systems.characteristic": "CharacteristicRoots",
    "systems.contacts": "Gap Stop",
    "systems.cubic_system": "CubicSystem",
    "systems.dampers": "FluidDamper StribeckFriction",
    "systems.elements": "Coupling Spring",
    "systems.friction": "BoucWen Dahl Iwan Jenkins",
    "systems.load": "fourier_coefficients",
    "systems.load_table": "Chirp HalfSine Haversine LoadTable RunUp Sawtooth Step Trapezoid",
    "systems.modal_model": "ModalModel",
    "systems.mount": "Mount",
    "systems.normal_coordinates": "NormalCoordinates",
    "systems.pendulum": "Pendulum",
    "systems.polynomial_system": "PolynomialSystem",
    "systems.python_law": "PythonLaw",
    "systems.series_dampers": "Maxwell",
    "systems.spring_groups": "Monomial Springs",
    "systems.shaft": "DriveTorque",
    "systems.structure": "Structure",
    "systems.user_elements": "user_elements",
}
_MODULE = {name: module for module, names in _NAMES.items() for name in names.split()}

if TYPE_CHECKING:
    from viscovib.analyses.backbones import (
        Backbone as Backbone,
        BackbonePoint as BackbonePoint,
    )
    from viscovib.analyses.basins import Basins as Basins, basins as basins
    from viscovib.analyses.campbell import (
        Campbell as Campbell,
        campbell as campbell,
    )
    from viscovib.analyses.decay import (
        FreeDecay as FreeDecay,
        free_decay as free_decay,
    )
    from viscovib.analyses.driven import DrivenResponse as DrivenResponse
    from viscovib.analyses.driven_branch import DrivenBranch as DrivenBranch
    from viscovib.analyses.ensemble import simulate_ensemble as simulate_ensemble
    from viscovib.analyses.events import Event as Event
    from viscovib.analyses.forced import (
        forced_response as forced_response,
        plan_response as plan_response,
    )
    from viscovib.analyses.lines import (
        Lines as Lines,
        amplitudes_at as amplitudes_at,
        dominant_frequencies as dominant_frequencies,
    )
    from viscovib.analyses.motion_branches import trace_motion as trace_motion
    from viscovib.analyses.multiple_scales import MultipleScales as MultipleScales
    from viscovib.analyses.periodic import (
        backbone as backbone,
        trace_response as trace_response,
    )
    from viscovib.analyses.shock_spectra import (
        ShockResponseSpectrum as ShockResponseSpectrum,
        shock_response_spectrum as shock_response_spectrum,
    )
    from viscovib.analyses.shooting import steady_motion as steady_motion
    from viscovib.analyses.spectral import (
        Spectrum as Spectrum,
        name_frequencies as name_frequencies,
        spectrum as spectrum,
    )
    from viscovib.analyses.transient import simulate as simulate
    from viscovib.bodies.body import Body as Body
    from viscovib.bodies.forces import MountForces as MountForces
    from viscovib.bodies.modes import BodyModes as BodyModes
    from viscovib.bodies.mount_point import (
        FluidTrack as FluidTrack,
        MountPoint as MountPoint,
    )
    from viscovib.bodies.piston_engine import PistonEngine as PistonEngine
    from viscovib.bodies.statics import Sag as Sag
    from viscovib.common.past import Past as Past
    from viscovib.common.periodic_motions import PeriodicMotions as PeriodicMotions
    from viscovib.common.plan import Plan as Plan
    from viscovib.common.results import Result as Result
    from viscovib.errors import (
        ConvergenceWarning as ConvergenceWarning,
        FileError as FileError,
        InputError as InputError,
        RangeWarning as RangeWarning,
        StabilityWarning as StabilityWarning,
        SweepError as SweepError,
        ViscovibError as ViscovibError,
    )
    from viscovib.explorer.notebook import (
        Explorer as Explorer,
        explore as explore,
    )
    from viscovib.kernels.relaxation import (
        AbelKernel as AbelKernel,
        ExponentialSum as ExponentialSum,
        Kernel as Kernel,
        PronyKernel as PronyKernel,
        RabotnovKernel as RabotnovKernel,
        RzhanitsynKernel as RzhanitsynKernel,
    )
    from viscovib.kernels.sum_kernel import SumKernel as SumKernel
    from viscovib.kernels.tabulated import TabulatedKernel as TabulatedKernel
    from viscovib.kernels.time_temperature import (
        WLF as WLF,
        Arrhenius as Arrhenius,
        ShiftLaw as ShiftLaw,
        ThermalKernel as ThermalKernel,
    )
    from viscovib.plots.animation import animate as animate
    from viscovib.plots.bodies import (
        plot_body as plot_body,
        plot_energy as plot_energy,
        plot_transmissibility as plot_transmissibility,
    )
    from viscovib.plots.campbell import plot_campbell as plot_campbell
    from viscovib.plots.loops import plot_loop as plot_loop
    from viscovib.plots.maps import plot_map as plot_map
    from viscovib.plots.motions import (
        plot_sections as plot_sections,
        plot_spectrum as plot_spectrum,
        plot_trajectory as plot_trajectory,
    )
    from viscovib.plots.report_pages import report as report
    from viscovib.plots.rubber import (
        plot_cole_cole as plot_cole_cole,
        plot_modulus as plot_modulus,
        plot_nomogram as plot_nomogram,
        plot_van_gurp as plot_van_gurp,
    )
    from viscovib.plots.scales import (
        plot_modulation as plot_modulation,
        plot_scales_response as plot_scales_response,
    )
    from viscovib.plots.steady import (
        plot_backbone as plot_backbone,
        plot_branch as plot_branch,
        plot_motion_branch as plot_motion_branch,
        plot_response as plot_response,
    )
    from viscovib.results.beats import BeatingMotion as BeatingMotion
    from viscovib.results.branch import Branch as Branch
    from viscovib.results.curves import (
        BranchPoint as BranchPoint,
        Crossing as Crossing,
    )
    from viscovib.results.ensemble import Ensemble as Ensemble
    from viscovib.results.located_peaks import (
        LocatedPeak as LocatedPeak,
        LocatedPeaks as LocatedPeaks,
    )
    from viscovib.results.modulation import (
        Modulation as Modulation,
        Resonance as Resonance,
    )
    from viscovib.results.motion_branch import MotionBranch as MotionBranch
    from viscovib.results.motion_forces import (
        ElementForces as ElementForces,
        FloorForce as FloorForce,
        MountForcesInTime as MountForcesInTime,
        PointMotion as PointMotion,
        SupportReactions as SupportReactions,
    )
    from viscovib.results.response import (
        Peak as Peak,
        Response as Response,
    )
    from viscovib.results.scales import (
        ScalesMotion as ScalesMotion,
        ScalesResponse as ScalesResponse,
    )
    from viscovib.results.steady_motion import SteadyMotion as SteadyMotion
    from viscovib.results.trajectory import Trajectory as Trajectory
    from viscovib.rubber.amplitude_fit import (
        AmplitudeFit as AmplitudeFit,
        ProgressiveLaw as ProgressiveLaw,
        fit_amplitude as fit_amplitude,
        fit_progressive as fit_progressive,
        jenkins_stiffness as jenkins_stiffness,
    )
    from viscovib.rubber.bands import (
        Band as Band,
        propagate as propagate,
    )
    from viscovib.rubber.data import (
        CreepData as CreepData,
        ModulusData as ModulusData,
        RelaxationData as RelaxationData,
    )
    from viscovib.rubber.files import (
        read_fit as read_fit,
        read_kernel as read_kernel,
        write_kernel as write_kernel,
    )
    from viscovib.rubber.fit import (
        KernelFit as KernelFit,
        Optimum as Optimum,
        Profile as Profile,
        Sample as Sample,
    )
    from viscovib.rubber.kernel_fit import fit_kernel as fit_kernel
    from viscovib.rubber.kramers_kronig_pair import (
        KramersKronig as KramersKronig,
        kramers_kronig as kramers_kronig,
    )
    from viscovib.rubber.master import (
        MasterCurve as MasterCurve,
        master_curve as master_curve,
    )
    from viscovib.rubber.parametric_fit import ParametricFit as ParametricFit
    from viscovib.rubber.prony_fit import PronyFit as PronyFit
    from viscovib.rubber.reading import (
        read_creep as read_creep,
        read_dma as read_dma,
        read_dynamic_stiffness as read_dynamic_stiffness,
        read_relaxation as read_relaxation,
    )
    from viscovib.rubber.shift_fit import (
        ShiftFit as ShiftFit,
        ShiftTable as ShiftTable,
        fit_shift_law as fit_shift_law,
    )
    from viscovib.rubber.terms import (
        PronyTerms as PronyTerms,
        prony_terms as prony_terms,
    )
    from viscovib.scene.job import (
        SceneResult as SceneResult,
        plan as plan,
    )
    from viscovib.scene.scene import Scene as Scene
    from viscovib.scene.table import TableResult as TableResult
    from viscovib.sweeps.run_scene import run as run
    from viscovib.sweeps.sweeping import sweep as sweep
    from viscovib.systems.characteristic import CharacteristicRoots as CharacteristicRoots
    from viscovib.systems.contacts import (
        Gap as Gap,
        Stop as Stop,
    )
    from viscovib.systems.cubic_system import CubicSystem as CubicSystem
    from viscovib.systems.dampers import (
        FluidDamper as FluidDamper,
        StribeckFriction as StribeckFriction,
    )
    from viscovib.systems.elements import (
        Coupling as Coupling,
        Spring as Spring,
    )
    from viscovib.systems.friction import (
        BoucWen as BoucWen,
        Dahl as Dahl,
        Iwan as Iwan,
        Jenkins as Jenkins,
    )
    from viscovib.systems.load import fourier_coefficients as fourier_coefficients
    from viscovib.systems.load_table import (
        Chirp as Chirp,
        HalfSine as HalfSine,
        Haversine as Haversine,
        LoadTable as LoadTable,
        RunUp as RunUp,
        Sawtooth as Sawtooth,
        Step as Step,
        Trapezoid as Trapezoid,
    )
    from viscovib.systems.modal_model import ModalModel as ModalModel
    from viscovib.systems.mount import Mount as Mount
    from viscovib.systems.normal_coordinates import NormalCoordinates as NormalCoordinates
    from viscovib.systems.pendulum import Pendulum as Pendulum
    from viscovib.systems.polynomial_system import PolynomialSystem as PolynomialSystem
    from viscovib.systems.python_law import PythonLaw as PythonLaw
    from viscovib.systems.series_dampers import Maxwell as Maxwell
    from viscovib.systems.shaft import DriveTorque as DriveTorque
    from viscovib.systems.spring_groups import (
        Monomial as Monomial,
        Springs as Springs,
    )
    from viscovib.systems.structure import Structure as Structure
    from viscovib.systems.user_elements import user_elements as user_elements

    __version__: str

else:
    __all__ = sorted(_MODULE)

    def __getattr__(name: str) -> Any:
        """Load a public name or a subpackage."""
        if name == "__version__":
            from importlib.metadata import version

            value = version("viscovib")
        elif name in _MODULE:
            from viscovib.errors import named_near

            value = named_near(import_module(f"viscovib.{_MODULE[name]}"), name)
        elif name in {module.partition(".")[0] for module in _NAMES}:
            value = import_module(f"viscovib.{name}")
        else:
            from viscovib.errors import no_attribute

            raise no_attribute(name, __all__)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        """List the public names for completion."""
        return sorted({*globals(), *__all__})
