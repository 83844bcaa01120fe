"""The family that checks each public name: a name without a family fails the lint."""

import ast
import functools
import inspect
import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
FAMILIES = (
    "kernels", "rubber", "fits", "systems", "bodies", "piston_engines", "laws", "hysteresis", "linear", "roots", "rotors", "responses",
    "peaks", "branches", "crossings",
    "stability", "backbones", "steady", "repeating", "motions", "switched", "singular", "element_motions", "events", "ensembles", "spectra", "shocks", "scales",
    "scenes",
    "invariances", "structure_motions", "structure_stability", "structures", "sweeps", "tables",
)  # fmt: skip
#: Public names without a result to check, and the reason.
_ARRAYS = "its own arrays, which test_results compares"
_PICTURE = "a picture: numbers are those of the result it is given"
_WHOLE = "tests/python/test_structure.py compares it with the whole system"
_SHOCKS = "tests/python/test_shocks.py: Duhamel's integral of each mode"
_SHOCK = "tests/python/test_shock_spectra.py: exact solutions of 1000 random records"
_ALONG = "tests/python/test_motion_results.py: balances of momentum and energy, closed forms"
_SUPPORTS = "tests/python/test_supports.py: the full equations by SciPy"
_MODES = "tests/python/test_modal_model.py compares it with the whole structure"
NOTHING_TO_JUDGE = {
    "FluidDamper.force": "tests/python/test_fluid_dampers.py: the formula",
    "FluidDamper.energy": "tests/python/test_fluid_dampers.py: gamma functions and quadrature",
    "Maxwell": "tests/python/test_maxwell.py: random systems by SciPy, with all of its methods",
    "Maxwell.loop": "the same",
    "Maxwell.energy": "the same",
    "StribeckFriction.force": "tests/python/test_damper_laws.py: the formula",
    "StribeckFriction.energy": "tests/python/test_damper_laws.py: quadrature",
    "Kernel.plot": "a picture: tests/python/test_kernels.py reads its curves",
    "Profile.plot": _PICTURE,
    "plot_campbell": _PICTURE,
    "Campbell.to_dataset": _ARRAYS,
    "Mount.modes": "tests/python/test_mount.py: the paper's equations (7) and (8)",
    "NormalCoordinates": "tests/python/test_mount.py, with all of its methods",
    "NormalCoordinates.normal": "the same",
    "NormalCoordinates.physical": "the same",
    "NormalCoordinates.force": "the same",
    "NormalCoordinates.dynamic_stiffness": "the same",
    "MultipleScales.formula": "words: its test evaluates them",
    "Response.iterates": "tests/python/test_response.py: by the formula of the paper",
    "Coupling": _WHOLE,
    "DriveTorque": "tests/python/test_drive_torque.py: random rotors by SciPy, energy",
    "Structure.at_speed": "tests/python/test_structure_rotors.py: the full matrices",
    "Body.at_speed": "the same as of a PolynomialSystem",
    "MountForces.lost_in_turning": "tests/python/test_body.py: the balance of power of bodies",
    "Response.plan": "words: tests/python/test_frequency_tolerances.py and others read them",
    "Branch.plan": "words: tests/python/test_branch.py and others read them",
    "Response.error": "tests/python/test_light_damping.py: the same balance in 40 digits",
    "user_elements": "tests/python/test_user_elements.py: SciPy from yield to turn",
    "MotionBranch.dof_names": "names, as the system has them",
    "MotionBranch.label": "words of a picture",
    "MotionBranch.to_dataset": "its own arrays, which test_results compares",
    "SteadyMotion.dof_names": "names, as the system has them",
    "SteadyMotion.dof_units": "units, as the system names them",
    "SteadyMotion.coordinate": "a column of `state`, which repeating judges",
    "SteadyMotion.to_dataset": "its own arrays, which test_steady_motion compares",
    "Trajectory.dof_units": "units, as the system names them",
    "Trajectory.rate_units": "units, as the system names them",
    "Trajectory.mount_forces": _ALONG,
    "Trajectory.element_forces": _ALONG,
    "Trajectory.motion_of": _ALONG,
    "Trajectory.floor_force": _ALONG,
    "Trajectory.support_reactions": _SUPPORTS,
    "SupportReactions": _SUPPORTS,
    "SupportReactions.of": _SUPPORTS,
    "SupportReactions.to_dataset": _ARRAYS,
    "Trajectory.peak": _ALONG,
    "LocatedPeak": _ALONG,
    "LocatedPeaks": _ALONG,
    "MountForcesInTime": _ALONG,
    "MountForcesInTime.force": _ALONG,
    "MountForcesInTime.work": _ALONG,
    "MountForcesInTime.dissipated": _ALONG,
    "MountForcesInTime.of": _ALONG,
    "MountForcesInTime.to_dataset": _ARRAYS,
    "ElementForces": _ALONG,
    "ElementForces.force": _ALONG,
    "ElementForces.work": _ALONG,
    "ElementForces.dissipated": _ALONG,
    "ElementForces.of": _ALONG,
    "ElementForces.to_dataset": _ARRAYS,
    "PointMotion": _ALONG,
    "PointMotion.to_dataset": _ARRAYS,
    "FloorForce": _ALONG,
    "FloorForce.to_dataset": _ARRAYS,
    "Trajectory.acceleration_units": "units, as the system names them",
    "Trajectory.reason": "tests/python/test_domains_of_laws.py: the edge of each law, by SciPy",
    "Structure.write": "tests/python/test_structure_files.py writes and reads",
    "Structure.n_coordinates": _WHOLE,
    "Structure.rate_units": _WHOLE,
    "Structure.in_modes": _MODES,
    "ModalModel": _MODES,
    "ModalModel.load": _MODES,
    "ModalModel.displacements": _MODES,
    "ModalModel.velocities": _MODES,
    "ModalModel.start": _MODES,
    "Chirp": _SHOCKS,
    "HalfSine": _SHOCKS,
    "Haversine": _SHOCKS,
    "Sawtooth": _SHOCKS,
    "Step": _SHOCKS,
    "Trapezoid": _SHOCKS,
    "LoadTable.half_sine": _SHOCKS,
    "LoadTable.sawtooth": _SHOCKS,
    "ShockResponseSpectrum.primary": _SHOCK,
    "ShockResponseSpectrum.residual": _SHOCK,
    "ShockResponseSpectrum.positive": _SHOCK,
    "ShockResponseSpectrum.negative": _SHOCK,
    "ShockResponseSpectrum.to_dataset": "its own arrays, which test_shock_spectra compares",
    "Explorer": "a page: numbers are those of the scene it shows",
    "Explorer.stop": "ends a server",
    "explore": "a page: numbers are those of the scene it shows",
    "animate": _PICTURE,
    "Body.animate_mode": _PICTURE,
    "plot_backbone": _PICTURE,
    "plot_body": _PICTURE,
    "plot_branch": _PICTURE,
    "plot_motion_branch": _PICTURE,
    "plot_energy": _PICTURE,
    "plot_loop": _PICTURE,
    "plot_map": _PICTURE,
    "plot_modulation": _PICTURE,
    "plot_response": _PICTURE,
    "plot_scales_response": _PICTURE,
    "plot_sections": _PICTURE,
    "plot_spectrum": _PICTURE,
    "plot_trajectory": _PICTURE,
    "plot_transmissibility": _PICTURE,
    "report": "a page of numbers that bodies judges",
    "BeatingMotion.to_dataset": "its own arrays and properties, which scales judges",
    "BodyModes.to_dataset": "its own arrays, which test_body compares",
    "plot_modulus": _PICTURE,
    "plot_cole_cole": _PICTURE,
    "plot_van_gurp": _PICTURE,
    "plot_nomogram": _PICTURE,
    "ModulusData.plot": _PICTURE,
    "Band.plot": _PICTURE,
    "ConvergenceWarning": "what other families listen for",
    "InputError": "what other families count as refused",
    "ViscovibError": "the base of all errors",
    "BranchPoint.departure": "what trace_response(leave=) begins with, which branches judges",
    "Plan.and_also": "makes a text",
    "Plan.instead": "makes a text",
    "Plan.comments": "makes a text",
    "PolynomialSystem.rate_units": "a text",
    "Result.summary": "a text",
    "Result.panels": "what pictures draw",
    "Result.plot": _PICTURE,
    "Result.numbers": "what sweeps keep, which sweeps judges",
    "TableResult": "columns as the core wrote them, which test_driver_tables compares",
    "TableResult.stable": "a column as the core wrote it, which test_driver_tables compares",
    "TableResult.to_dataset": "columns as the core wrote them, which test_modes compares",
    "MasterCurve.to_dataset": _ARRAYS,
    "KramersKronig.to_dataset": _ARRAYS,
    "KernelFit.to_dataset": _ARRAYS,
    "MountForces.to_dataset": _ARRAYS,
    "Lines.to_dataset": _ARRAYS,
    "Modulation.to_dataset": _ARRAYS,
    "Result.to_netcdf": "to_dataset in a file, which test_results compares",
    "Scene.events": "what &event groups say; test_driver_events compares their passages",
    "SceneResult.decay": "a table as the core wrote it, which test_driver_tables compares",
    "SceneResult.forces": "a table as the core wrote it, which test_driver_tables compares",
    "SceneResult.reactions": "a table as the core wrote it, which test_driver_tables compares",
    "SceneResult.peaks": "a table as the core wrote it, which test_driver_tables compares",
    "SceneResult.decay_to_csv": "the table of decaying oscillations, which test_driver_tables compares",
    "SceneResult.events_to_csv": "the table of events, which test_driver_events compares",
    "SceneResult.forces_to_csv": "the table of forces, which test_driver_forces compares",
    "SceneResult.reactions_to_csv": "the table of reactions, which test_driver_forces compares",
    "SceneResult.peaks_to_csv": "the table of peaks, which test_driver_forces compares",
    "SceneResult.shock_spectrum_to_csv": "the table of a spectrum, which test_driver_tables compares",
    "SceneResult.spectrum_to_csv": "the table of a spectrum, which test_driver_tables compares",
}


@functools.cache
def _tree(family: str) -> ast.Module:
    return ast.parse((HERE / f"{family}.py").read_text(encoding="utf-8"))


@functools.cache
def _text(family: str) -> str:
    """Source of a family without its JUDGES."""
    kept = [
        node
        for node in _tree(family).body
        if not (isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "JUDGES")
    ]
    return "\n".join(map(ast.unparse, kept))


def _constants(family: str) -> dict[str, object]:
    """Docstring and JUDGES of a family, read without importing it."""
    tree = _tree(family)
    found: dict[str, object] = {"description": ast.get_docstring(tree) or ""}
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if name == "JUDGES":
                found[name] = ast.literal_eval(node.value)
    return found


def description(family: str) -> str:
    """Reference method of a family: the first line of its docstring."""
    return str(_constants(family)["description"]).splitlines()[0].rstrip(".")


def public_names() -> list[str]:
    """Names in ``viscovib.__all__``, and public members of the classes."""
    import viscovib as vv

    names = []
    # An overridden member counts as the member of its base class.
    same = {name.partition(".")[2] for name in NOTHING_TO_JUDGE if name.startswith("Result.")}
    same.add("complete")
    for name in vv.__all__:
        thing = getattr(vv, name)
        names.append(name)
        if not inspect.isclass(thing) or issubclass(thing, BaseException):
            continue
        names += [
            f"{owner}.{member}"
            for owner, member in _members(name, thing)
            if owner == "Result" or member not in same or not issubclass(thing, vv.Result)
        ]
    return list(dict.fromkeys(names))


def _members(name: str, thing: type) -> list[tuple[str, str]]:
    """Public methods and properties with the public class that defines them (else this class)."""
    import viscovib as vv

    found = []
    for base in thing.__mro__:
        if not base.__module__.startswith("viscovib"):
            continue
        owner = base.__name__ if base.__name__ in vv.__all__ else name
        for member, value in vars(base).items():
            if member.startswith("_") and member != "__call__":
                continue
            kinds = (property, classmethod, staticmethod, functools.cached_property)
            if inspect.isfunction(value) or isinstance(value, kinds):
                found.append((owner, member))
    return found


def _used(member: str, family: str) -> bool:
    """True if the source of a family contains the word; constructors count as used."""
    if member == "__call__" or member[0].isupper():
        return True
    return re.search(rf"\b{member}\b", _text(family)) is not None


def judged() -> dict[str, list[str]]:
    """Families of each name."""
    found: dict[str, list[str]] = {}
    for family in FAMILIES:
        for name in _constants(family).get("JUDGES", ()):
            found.setdefault(name, []).append(family)
    return found


def complaints() -> list[str]:
    """Public names without a family, and names listed by families that are not public."""
    public, known = public_names(), judged()
    lines = [
        f"{name}: no family of tests/referee judges it; name it in its JUDGES, or in "
        "NOTHING_TO_JUDGE of coverage.py with the reason"
        for name in public
        if name not in known and name not in NOTHING_TO_JUDGE
    ]
    lines += [
        f"{name}: judged by {', '.join(families)}, but not public"
        for name, families in known.items()
        if name not in public
    ]
    lines += [
        f"{name}: has nothing to judge, but is not public or is judged"
        for name in NOTHING_TO_JUDGE
        if name not in public or name in known
    ]
    lines += [
        f"{name}: is named by {family}, which does not use it"
        for name, families in known.items()
        for family in families
        if not _used(name.rpartition(".")[2], family)
    ]
    files = {path.stem for path in HERE.glob("*.py") if "JUDGES" in path.read_text("utf-8")}
    lines += [f"{name}: is no family of coverage.py" for name in files - {*FAMILIES, "coverage"}]
    return lines


def main() -> int:
    """Print what is not covered; return 1 if there is anything."""
    found = complaints()
    for text in found:
        print(f"referee: {text}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
