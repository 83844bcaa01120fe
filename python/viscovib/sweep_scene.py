"""Scenes over a grid: their keys as parameters, and a few numbers of each result."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.backbone import Backbone
from viscovib.branch import Branch
from viscovib.driven_branch import DrivenBranch
from viscovib.errors import InputError
from viscovib.fingerprint import describe
from viscovib.response import Response
from viscovib.scene import Scene, SceneResult, run
from viscovib.scene_keys import with_key
from viscovib.sweep_points import Grid, Numbers
from viscovib.trajectory import Trajectory

#: Units of keys; those of a pendulum have none.
_UNITS = {
    "mount.mass": "kg",
    "mount.inertia": "kg m^2",
    "mount.offset": "m",
    "mount.stiffness_x": "N/m",
    "mount.stiffness_phi": "N m",
    "kernel.beta": "1/s",
    "kernel.rates": "1/s",
    "kernel.times": "s",
    "load.phase": "rad",
    "response.nu": "rad/s",
    "response.nu_min": "rad/s",
    "response.nu_max": "rad/s",
    "branch.nu_from": "rad/s",
    "branch.nu_to": "rad/s",
    "transient.t_end": "1/omega_1",
    "transient.dt": "1/omega_1",
}


@dataclass(frozen=True)
class _AtPoint:
    """The scene with keys overridden, run; picklable, for the processes of a cluster."""

    scene: Scene
    extract: Callable[[SceneResult], Any] | str

    def __call__(self, **point: Any) -> Any:
        result = run(self.scene.override(point))
        if callable(self.extract):
            return self.extract(result)
        if self.extract == "summary":
            return _with_units(summary(result), result.value)
        return result.value


def scene_job(
    what: Any, grid: Mapping[str, npt.ArrayLike] | None, extract: Callable[..., Any] | str
) -> tuple[_AtPoint, Grid, dict[str, Any], str]:
    """What `sweep` computes for a scene, where, and by what it is known again."""
    scene = what if isinstance(what, Scene) else Scene.read(os.fspath(what))
    if not callable(extract) and extract not in ("all", "summary"):
        raise InputError(
            f"extract = {_native.shown(extract)}: must be 'all', 'summary' or a function"
        )
    checked = Grid.checked(scene.sweep_grid() if grid is None else grid)
    points = Grid(checked.values, {n: u for n in checked.names if (u := _unit(scene, n))})
    plain = scene.override({})
    # A wrong name is told at once, before any point is computed.
    for name, values in points.values.items():
        with_key(plain.groups, name, values[0].item())
    kept: Any = describe(extract) if callable(extract) else extract
    identity = {"scene": _flat(plain), "extract": kept}
    return _AtPoint(plain, extract), points, identity, str(scene.path)


def summary(result: SceneResult) -> dict[str, Any]:
    """A few numbers of a result, of one shape whatever the parameters.

    Of a response: ``peak_x`` (m) and ``peak_phi`` (rad), the largest amplitudes of the lowest
    harmonic that moves; ``nu_peak_x`` and ``nu_peak_phi``, where they are (rad/s); ``unsolved``,
    the part of the frequencies without a solution. Of a branch: the same, ``folds`` and
    ``outcome`` instead of ``unsolved``. Of a backbone: ``nu_first`` and ``nu_last``, frequencies at
    its ends, ``folds`` and ``outcome``. Of a motion: ``max_z``, ``max_phi``, ``max_psi`` and
    ``rms_z``, ... over its second half, and ``outcome``.
    """
    value = result.value
    if isinstance(value, Trajectory):
        half = value.state[value.t >= 0.5 * value.t_reached, ::2]
        found: dict[str, Any] = {}
        for name, column in zip(value.dof_names, half.T, strict=True):
            found[f"max_{name}"] = np.abs(column).max()
            found[f"rms_{name}"] = np.sqrt(np.mean(column**2))
        return found | {"outcome": value.outcome}
    if isinstance(value, Backbone):
        ends = {"nu_first": value.nu[0], "nu_last": value.nu[-1]}
        return ends | {"folds": value.folds.size, "outcome": value.outcome}
    if not isinstance(value, (Response, Branch, DrivenBranch)):
        raise InputError("summary: must be that of a response, a branch, a backbone or a motion")
    return _peaks(value)


def _peaks(value: Response | Branch | DrivenBranch) -> dict[str, Any]:
    found: dict[str, Any] = {}
    orders = value.harmonics[value.harmonics > 0] if value.harmonics.ndim == 1 else np.empty(0)
    for name in value.dof_names:
        at, size = np.nan, np.nan
        if orders.size and np.isfinite(value.amplitude(name, int(orders[0]))).any():
            at, size = value.peak(name, int(orders[0]))[:2]
        found |= {f"peak_{name}": size, f"nu_peak_{name}": at}
    if isinstance(value, (Branch, DrivenBranch)):
        return found | {"folds": value.folds.size, "outcome": value.outcome}
    return found | {"unsolved": 1 - value.converged.mean()}


def _with_units(found: dict[str, Any], value: Any) -> Numbers:
    if isinstance(value, Backbone) and value.energy is None:
        return Numbers(found, {"nu_first": "rad/s", "nu_last": "rad/s"})
    if not isinstance(value, (Response, Branch)):
        return Numbers(found, {})
    units = {f"nu_peak_{name}": "rad/s" for name in value.dof_names}
    units |= {f"peak_{n}": u for n, u in zip(value.dof_names, value.dof_units, strict=True)}
    return Numbers(found, units)


def _unit(scene: Scene, name: str) -> str:
    group, _, key = name.lower().partition(".")
    group, key = group.partition("(")[0], key.partition("(")[0]
    if group == "load" and key == "amplitude":
        which = int(name.partition("(")[2].partition(")")[0] or 1) if "(" in name else 1
        loads = scene.groups["load"]
        load = loads[which - 1] if 0 < which <= len(loads) else {}
        if load.get("kind") == "base":
            return "m"
        return "N" if load.get("on") == "x" else "N m"
    return _UNITS.get(f"{group}.{key}", "")


def _flat(scene: Scene) -> dict[str, str]:
    """Every key and value, by which a scene is known again; its title does not matter."""
    flat: dict[str, str] = {}
    for name, group in scene.groups.items():
        several = group if isinstance(group, list) else [group]
        for i, one in enumerate(several):
            place = f"{name}({i + 1})" if len(several) > 1 else name
            flat |= {f"{place}.{key}": repr(value) for key, value in one.items()}
    return {key: text for key, text in flat.items() if key != "scene.title"}
