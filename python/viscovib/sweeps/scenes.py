"""Scenes over a grid: the parameters are keys of the scene; a few numbers of each result."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.common.fingerprint import describe
from viscovib.common.results import Number
from viscovib.errors import InputError
from viscovib.results.response import Response
from viscovib.scene.job import SceneResult, run_one
from viscovib.scene.keys import with_key
from viscovib.scene.scene import Scene
from viscovib.scene.units import unit_of
from viscovib.sweeps.points import Grid, Numbers

#: A sweep keeps automatically chosen orders of a response up to this one, so that all results
#: have the same shape; the load may have higher orders.
_SHOWN = 9


@dataclass(frozen=True)
class _AtPoint:
    """Run the scene with changed keys; can be pickled for the processes of a cluster."""

    scene: Scene
    extract: Callable[[SceneResult], Any] | str

    def __call__(self, **point: Any) -> Any:
        result = run_one(self.scene.override(point))
        if callable(self.extract):
            return self.extract(result)
        if self.extract == "summary":
            found = _numbers(result)
            units = {name: number.unit for name, number in found.items() if number.unit}
            return Numbers({name: number.value for name, number in found.items()}, units)
        chosen = result.scene.groups.get("response", {}).get("harmonics") == "auto"
        value: Any = result.value
        if chosen and value._form == "response" and value.method != "linear":
            return _of_one_shape(value)
        return value


def _of_one_shape(value: Response) -> Response:
    """Return the response with orders up to 9, or up to the highest of the load if larger."""
    highest = max(_SHOWN, int(value._job.orders.max()))
    first = int(value.harmonics[0])
    orders = np.arange(first, highest + 1, 1 if first == 0 else 2, dtype=np.int32)
    both = np.intersect1d(orders, value.harmonics)
    missing = np.isnan(value.coefficients[:, :, :1])
    kept = np.where(missing, value.coefficients[:, :, :1], np.zeros(orders.size, dtype=complex))
    kept[:, :, np.searchsorted(orders, both)] = value.coefficients[
        :, :, np.searchsorted(value.harmonics, both)
    ]
    return replace(value, harmonics=orders, coefficients=kept)


def scene_job(
    what: Any, grid: Mapping[str, npt.ArrayLike] | None, extract: Callable[..., Any] | str
) -> tuple[_AtPoint, Grid, dict[str, Any], str]:
    """Return the function of a scene for `sweep`, its grid, its identity and its path."""
    scene = what if isinstance(what, Scene) else Scene.read(os.fspath(what))
    if not callable(extract) and not (isinstance(extract, str) and extract in ("all", "summary")):
        raise InputError(
            f"extract = {_native.shown(extract)}: must be 'all', 'summary' or a function"
        )
    checked = Grid.checked(scene.sweep_grid() if grid is None else grid)
    points = Grid(checked.values, {n: u for n in checked.names if (u := unit_of(scene.groups, n))})
    plain = scene.override({})
    # A wrong name is reported before any point is computed.
    for name, values in points.values.items():
        with_key(plain.groups, name, values[0].item())
    kept: Any = describe(extract) if callable(extract) else extract
    identity = {"scene": _flat(plain), "extract": kept}
    return _AtPoint(plain, extract), points, identity, str(scene.path)


def summary(result: SceneResult) -> dict[str, Any]:
    """Return a few numbers of a result; their shape does not depend on the parameters.

    Of a response: ``peak_x`` (m) and ``peak_phi`` (rad), the largest amplitudes of the lowest
    harmonic that moves; ``nu_peak_x`` and ``nu_peak_phi``, where they are (rad/s); ``unsolved``,
    the part of the frequencies without a solution. Of a branch: the same, ``folds`` and
    ``outcome`` instead of ``unsolved``. Of a backbone: ``nu_first`` and ``nu_last``, frequencies at
    its ends, ``folds`` and ``outcome``. Of a motion: ``max_z``, ``max_phi``, ``max_psi`` and
    ``rms_z``, ... over its second half, and ``outcome``.
    """
    return {name: number.value for name, number in _numbers(result).items()}


def _numbers(result: SceneResult) -> dict[str, Number]:
    return result._single("summary: must be that of a single result, not of a sweep").numbers()


def _flat(scene: Scene) -> dict[str, str]:
    """Every key and value, to recognize a scene later; the title is omitted."""
    flat: dict[str, str] = {}
    for name, group in scene.groups.items():
        several = group if isinstance(group, list) else [group]
        for i, one in enumerate(several):
            place = f"{name}({i + 1})" if len(several) > 1 else name
            flat |= {f"{place}.{key}": repr(value) for key, value in one.items()}
    return {key: text for key, text in flat.items() if key != "scene.title"}
