"""Shape of a moving system: outlines of bodies and springs, one row per frame.

A mount is a block on a sideways spring, a pendulum hangs on its spring. For other systems every
coordinate has its own row: a block that moves sideways, or for an angle a bar that
turns. Motions too small to be seen are magnified by `Drawing.factor`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from viscovib._native import FloatArray

#: Largest drawn motion of a body, relative to its size: larger motions are reduced.
_REACH = 0.6
#: Largest number of rows; the coordinates with the largest motions are drawn.
_MOST_ROWS = 8
_SQUARE = np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]])


@dataclass(frozen=True)
class Outline:
    """One body or spring: x and y of its corners, shape (n_frames, n_corners)."""

    x: FloatArray
    y: FloatArray
    #: A "body" is filled, a "spring" is a line, the "ground" does not move.
    kind: str


@dataclass(frozen=True)
class Drawing:
    """Outlines of a moving system, their magnification, and names of the rows."""

    outlines: tuple[Outline, ...]
    factor: float
    #: Texts at the left of rows: name and height.
    names: tuple[tuple[str, float], ...] = ()

    def limits(self) -> tuple[float, float, float, float]:
        """Smallest and largest x, smallest and largest y of all frames, with a margin."""
        x = np.concatenate([one.x.ravel() for one in self.outlines])
        y = np.concatenate([one.y.ravel() for one in self.outlines])
        ends = []
        for low, high in ((x.min(), x.max()), (y.min(), y.max())):
            margin = 0.06 * max(high - low, 1e-9)
            ends += [float(low - margin), float(high + margin)]
        return ends[0], ends[1], ends[2], ends[3]


def drawing_of(
    motion: FloatArray, names: Sequence[str], units: Sequence[str], system: Any = None
) -> Drawing:
    """Return the drawing of a motion: coordinates at each frame, shape (n_frames, n_dof).

    ``system`` provides the offset of a mount or the eccentricity of a pendulum, if known.
    """
    if tuple(names) == ("z", "phi", "psi"):
        return _pendulum(motion, float(getattr(system, "e", 0.15)))
    if tuple(names) == ("x", "phi") and tuple(units) == ("m", "rad"):
        return _mount(motion, abs(float(getattr(system, "offset", 0.5))))
    return _rows(motion, names, units)


def _factor(largest: float) -> float:
    """Return the magnification of a motion: 1, 2 or 5 times a power of ten, also below 1."""
    if not largest > 0:
        return 1.0
    wanted = _REACH / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9)))


def _zigzag(start: FloatArray, end: FloatArray, width: float) -> Outline:
    """Return a spring between two points, each of shape (n_frames, 2)."""
    n = 18
    along = np.linspace(0, 1, n)
    aside = np.where(np.arange(n) % 2, 1.0, -1.0) * width
    aside[:3] = aside[-3:] = 0
    run = end - start
    length = np.maximum(np.hypot(run[:, 0], run[:, 1]), 1e-12)
    normal = np.column_stack([-run[:, 1], run[:, 0]]) / length[:, np.newaxis]
    points = (
        start[:, np.newaxis]
        + along[np.newaxis, :, np.newaxis] * run[:, np.newaxis]
        + aside[np.newaxis, :, np.newaxis] * normal[:, np.newaxis]
    )
    return Outline(points[..., 0], points[..., 1], "spring")


def _still(x: Sequence[float], y: Sequence[float], n: int) -> Outline:
    return Outline(np.tile(np.asarray(x), (n, 1)), np.tile(np.asarray(y), (n, 1)), "ground")


def _block(
    x: FloatArray, y: FloatArray, half: tuple[float, float], angle: FloatArray | float = 0.0
) -> Outline:
    """Return a rectangle about (x, y), turned clockwise."""
    across, up = half[0] * _SQUARE[0], half[1] * _SQUARE[1]
    c = np.cos(angle) * np.ones_like(x)
    s = np.sin(angle) * np.ones_like(x)
    corner_x = x[:, np.newaxis] + np.outer(c, across) + np.outer(s, up)
    corner_y = y[:, np.newaxis] - np.outer(s, across) + np.outer(c, up)
    return Outline(corner_x, corner_y, "body")


def _mount(motion: FloatArray, offset: float) -> Drawing:
    n = len(motion)
    size = offset or 0.5
    factor = _factor(float(np.abs(motion / [size, 1.0]).max(initial=0.0)))
    x, phi = factor * motion[:, 0] / size, factor * motion[:, 1]
    arm = float(offset > 0)
    # Clockwise is positive, the support is below: its spring deflects by x - l sin(phi).
    foot = np.column_stack([x - arm * np.sin(phi), -arm * np.cos(phi)])
    wall = np.tile([-2.6, -arm], (n, 1))
    return Drawing(
        (
            _still([-2.6, -2.6], [-arm - 0.5, -arm + 0.5], n),
            _zigzag(wall, foot, 0.12),
            _block(x, np.zeros(n), (1.3, 0.8), phi),
            Outline(
                np.column_stack([x, foot[:, 0]]), np.column_stack([0 * x, foot[:, 1]]), "spring"
            ),
        ),
        factor,
    )


def _pendulum(motion: FloatArray, eccentricity: float) -> Drawing:
    n = len(motion)
    factor = _factor(float(np.abs(motion).max(initial=0.0)))
    # A large motion is not reduced.
    factor = max(1.0, factor)
    z, phi, psi = factor * motion.T
    end = np.column_stack([(1 + z) * np.sin(phi), -(1 + z) * np.cos(phi)])
    arm = max(eccentricity, 0.12)
    centre = end + arm * np.column_stack([np.sin(psi), -np.cos(psi)])
    return Drawing(
        (
            _still([-0.3, 0.3], [0.0, 0.0], n),
            _zigzag(np.zeros((n, 2)), end, 0.05),
            _block(centre[:, 0], centre[:, 1], (0.5 * arm, arm), -psi),
        ),
        factor,
    )


def _rows(motion: FloatArray, names: Sequence[str], units: Sequence[str]) -> Drawing:
    n = len(motion)
    sizes = np.abs(motion).max(axis=0, initial=0.0)
    rows = np.sort(np.argsort(-sizes, kind="stable")[:_MOST_ROWS])
    factor = _factor(float(sizes.max(initial=0.0)))
    drawn, labels = [], []
    for place, d in enumerate(rows):
        height = -1.4 * place
        moved, level = factor * motion[:, d], np.full(n, height)
        labels.append((names[d], height))
        if units[d] == "rad":
            drawn.append(_block(np.zeros(n), level, (0.6, 0.12), moved))
            continue
        drawn.append(_still([-1.6, -1.6], [height - 0.4, height + 0.4], n))
        drawn.append(
            _zigzag(np.tile([-1.6, height], (n, 1)), np.column_stack([moved - 0.4, level]), 0.12)
        )
        drawn.append(_block(moved, level, (0.4, 0.4)))
    return Drawing(tuple(drawn), factor, tuple(labels))
