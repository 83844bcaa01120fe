"""Curves of a result with stability and marks, and frames of motions, for the explorer."""

import math
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib._native import FloatArray
from viscovib.common.results import Panel
from viscovib.errors import InputError
from viscovib.plots.axes import jumps_of
from viscovib.plots.outlines import Drawing, drawing_of
from viscovib.results.scales import ScalesResponse
from viscovib.scene.scene import Scene
from viscovib.scene.table import TableResult
from viscovib.sweeps.points import quiet

#: Number of frames of one period, and largest number of a motion in time.
_FRAMES, _MOST_FRAMES = 60, 400
_GREEK = {r"\nu": "ν", r"\tau": "τ", r"\omega": "ω", r"\varphi": "φ", r"\psi": "ψ"}
_BELOW = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")

#: Name of a table column with the real part of a harmonic of a coordinate.
_HARMONIC = re.compile(r"(.+)_(\d+)_re")

#: Numbers for the stability of a point: unstable, stable, unknown.
UNSTABLE, STABLE, UNKNOWN = 0, 1, 2


@dataclass(frozen=True)
class Curve:
    """One coordinate over frequency, parameter or time."""

    name: str
    unit: str
    order: int | None
    x_label: str
    log: bool
    x: FloatArray
    y: FloatArray
    stability: npt.NDArray[np.int8]
    #: Points without an order are drawn as separate points.
    points: bool = False
    #: x and y of folds, branch points and other changes of stability.
    marks: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    #: Steps between points at which a response jumps to another branch; None: no jumps.
    jumps: npt.NDArray[np.bool_] | None = None

    @property
    def label(self) -> str:
        """Name with the order of its harmonic and its unit."""
        name = {"phi": "φ", "psi": "ψ"}.get(self.name, self.name)
        text = name if self.order is None else f"|{name}{f'{self.order}'.translate(_BELOW)}|"
        return f"{text} ({self.unit})" if self.unit not in ("", "1", "L") else text

    @property
    def in_radians_per_second(self) -> bool:
        """Whether x is a circular frequency, which can be shown in Hz."""
        return "(rad/s)" in self.x_label

    def part(self, stability: int) -> FloatArray:
        """Return y of points with this stability and their neighbours, so that stretches meet."""
        shown = self.stability == stability
        if not self.points and stability != STABLE:
            shown = shown.copy()
            shown[:-1] |= shown[1:].copy()
            shown[1:] |= (self.stability == stability)[:-1]
        return np.where(shown, self.y, np.nan)


def curves_of(value: Any, switched: Sequence[Any] = ()) -> list[Curve]:
    """Return one curve per coordinate; other branches follow the first after a gap."""
    own = _OWN.get(str(value._form))
    if own is not None and (found := own(value)):
        return found
    try:
        panels = value.panels()
        more = [other.panels() for other in switched]
    except InputError as error:
        raise InputError(f"explore: {error}") from None
    results = [value, *switched]
    found = []
    for d, panel in enumerate(panels):
        x: list[Any] = []
        y: list[Any] = []
        stability: list[Any] = []
        for result, one in zip(results, [panel, *(each[d] for each in more)], strict=True):
            gap = [math.nan]
            same = one if one.order == panel.order else _again(result, panel)
            x += [same.x, gap]
            y += [same.y, gap]
            stability += [_stability(result, same.x.size), [STABLE]]
        marks: dict[str, tuple[FloatArray, FloatArray]] = {}
        for result in results:
            _add_marks(marks, result, panel)
        found.append(
            Curve(
                panel.name,
                panel.unit,
                panel.order,
                _plain(panel.x_label),
                panel.log,
                np.concatenate(x)[:-1].astype(float),
                np.concatenate(y)[:-1].astype(float),
                np.concatenate(stability)[:-1].astype(np.int8),
                panel.x.dtype.kind == "i",
                marks,
                jumps_of(value.coefficients) if value.kind == "response" else None,
            )
        )
    return found


def _again(result: Any, panel: Panel) -> Panel:
    """Return the same order of another branch: its own largest order may differ."""
    y = result.amplitude(panel.name, panel.order)
    x = result.nu if result.kind == "backbone" else result.parameter
    return Panel(x, y, panel.x_label, panel.name, panel.unit, panel.order, panel.log)


def _of_scales(value: ScalesResponse) -> list[Curve]:
    known = np.where(value.stable, STABLE, UNSTABLE).astype(np.int8)
    label = "ν (rad/s)" if value.parameter == "nu" else value.parameter
    return [
        Curve(
            name, "", 1, label, False, value.at,
            np.where(value.in_range, value.amplitude(name), np.nan), known, points=True,
        )
        for name in value.dof_names
    ]  # fmt: skip


def _of_table(value: TableResult) -> list[Curve]:
    """Return the lowest harmonic of each coordinate of a table, if it has such columns."""
    first, x = next(iter(value.columns.items()))
    stable = value.columns.get("stable", np.ones(x.size))
    known = np.select([stable == 1, stable == 0], [STABLE, UNSTABLE], UNKNOWN).astype(np.int8)
    label = "ν (rad/s)" if first == "nu" else first
    lowest: dict[str, int] = {}
    for column in value.columns:
        parts = _HARMONIC.fullmatch(column)
        if parts is not None and f"{parts[1]}_{parts[2]}_im" in value.columns:
            order = int(parts[2])
            if order > 0:
                lowest[parts[1]] = min(order, lowest.get(parts[1], order))
    return [
        Curve(
            name, "", order, label, False, x.astype(float),
            np.hypot(value.columns[f"{name}_{order}_re"], value.columns[f"{name}_{order}_im"]),
            known,
        )
        for name, order in lowest.items()
    ]  # fmt: skip


#: Results whose curves are not made from panels.
_OWN: dict[str, Callable[[Any], list[Curve]]] = {"steady": _of_scales, "table": _of_table}


def _stability(result: Any, n: int) -> npt.NDArray[np.int8]:
    stable = getattr(result, "stable", None)
    if stable is None:
        return np.full(n, STABLE, dtype=np.int8)
    found = np.full(n, UNKNOWN, dtype=np.int8)
    found[stable == True] = STABLE  # noqa: E712
    found[stable == False] = UNSTABLE  # noqa: E712
    return found


def _add_marks(marks: dict[str, tuple[FloatArray, FloatArray]], result: Any, panel: Panel) -> None:
    if result.kind != "branch":
        return
    d, j = result._place(panel.name, panel.order)
    here = [("fold", x, X) for x, X in zip(result.folds, result.fold_coefficients, strict=True)]
    here += [("branch point", p.parameter, p.coefficients) for p in result.branch_points]
    here += [
        (crossing.kind, crossing.parameter, crossing.coefficients)
        for crossing in result.crossings
        if crossing.kind not in ("fold", "branch point") and crossing.coefficients is not None
    ]
    for kind, x, coefficients in here:
        old = marks.get(kind, (np.empty(0), np.empty(0)))
        size = abs(coefficients[d, j])
        marks[kind] = (np.append(old[0], x), np.append(old[1], size))


def _plain(label: str) -> str:
    """Return a label for axes without TeX."""
    for tex, letter in _GREEK.items():
        label = label.replace(tex, letter)
    return label.replace("$", "")


@dataclass(frozen=True)
class Motion:
    """Frames of one motion and a description."""

    drawing: Drawing
    about: str


def motion_of(
    scene: Scene, value: Any, switched: Sequence[Any], curve: Curve, point: int
) -> Motion | None:
    """Return the motion at a point of a curve; None if there is no motion."""
    if value._form == "trajectory":
        if value.t.size < 2:
            return None
        # Use every state: if some were omitted, fast motions would look slow.
        late = slice(max(0, value.t.size - _MOST_FRAMES), None)
        drawing = drawing_of(
            value.state[late, ::2], value.dof_names, value.system.dof_units, _system(scene)
        )
        return Motion(drawing, f"motion from t = {value.t[late][0]:g} to {value.t[-1]:g}")
    if not hasattr(value, "waveform") or curve.x.size == 0:
        return None
    at = min(point, curve.x.size - 1)
    i = at
    for result in (value, *switched):
        value, n = result, len(result.coefficients)
        if i <= n:
            break
        # There is a gap between branches.
        i -= n + 1
    try:
        _, motion = value.waveform(min(i, n - 1), _FRAMES)
    except InputError:
        return None
    if not np.isfinite(motion).all():
        return None
    drawing = drawing_of(motion, value.dof_names, value.dof_units, _system(scene))
    known = {UNSTABLE: ", unstable", STABLE: "", UNKNOWN: ", stability unknown"}
    name, _, unit = curve.x_label.partition(" (")
    place = f"{name.split()[-1]} = {curve.x[at]:.5g} {unit.rstrip(')')}".rstrip()
    return Motion(drawing, f"one period at {place}{known[int(curve.stability[at])]}")


def _system(scene: Scene) -> Any:
    """Return the system, which contains the lengths of the drawing."""
    with warnings.catch_warnings():
        quiet()
        return scene.pendulum() if scene.is_pendulum else scene.oscillator()
