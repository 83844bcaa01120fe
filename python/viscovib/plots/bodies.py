"""Plots of a body on its mounts: geometry, modes, energies and transmissibility."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.bodies.body import Body
from viscovib.bodies.forces import MountForces
from viscovib.bodies.modes import BodyModes
from viscovib.common.results import Axes
from viscovib.errors import InputError
from viscovib.plots.axes import Shown, plain_hertz
from viscovib.plots.panels import panel, panels
from viscovib.plots.style import COLOURS, STYLES, bare, plain
from viscovib.results.motion_forces import MountForcesInTime

#: Edges of a box: pairs of corners, whose numbers contain x, y and z as bits.
EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)]
#: Largest displacement of a mode, relative to the size of the picture.
SWING = 0.25
#: A force below this part of the largest is not drawn.
_STILL = 1e-9


def plot_body(
    body: Body,
    ax: Axes | None = None,
    *,
    mode: int | None = None,
    torque_about: str | npt.ArrayLike | None = None,
) -> Axes:
    """Draw a body and its mounts in space, at rest and in a mode.

    The body is drawn as the box of equal mass and inertia, each mount by three axes with lengths
    proportional to the stiffness.

    Parameters
    ----------
    body : Body
    ax : Axes, optional
        Three-dimensional axes; None creates a figure.
    mode : int, optional
        A mode to draw, from 1; its largest displacement is a quarter of the picture.
    torque_about : "x", "y", "z" or array_like, shape (3,), optional
        Draw the torque-roll axis of a torque about this axis.

    Returns
    -------
    Axes

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(name="foot", position=(0.1, 0, -0.1), stiffness=(1e5, 1e5, 2e5))
    >>> vv.plot_body(vv.Body(mass=10, inertia=(0.1, 0.1, 0.1), mounts=[foot])).get_title()
    ''
    """
    _native.check_instance("body", body, Body)
    if ax is None:
        from matplotlib import pyplot as plt

        ax = plt.figure(figsize=(6, 5), layout="constrained").add_subplot(projection="3d")
    ax = panel(ax)
    if not hasattr(ax, "get_zlim"):
        raise InputError("ax: must be three-dimensional, add_subplot(projection='3d')")
    axis: Any = ax
    points = np.array([np.asarray(mount.position) for mount in body.mounts])
    corners = box_of(body) + body.center
    size = float(np.ptp(np.vstack([points, corners]), axis=0).max())
    _draw_box(axis, corners, COLOURS[0], "-")
    axis.plot(*body.center[:, None], marker="o", color=COLOURS[0], linestyle="none")
    draw_mounts(axis, body, size)
    if mode is not None:
        modes = body.modes()
        number = _native.integer("mode", mode, 1, modes.omega.size)
        shape = modes.shapes[:6, number - 1].real
        moved = moved_by(corners, body.center, shape)
        swing = SWING * size / max(np.abs(moved - corners).max(), 1e-300)
        _draw_box(axis, moved_by(corners, body.center, swing * shape), COLOURS[2], (0, (4, 1.5)))
        title = f"mode {number}: {modes.hz[number - 1]:.4g} Hz"
        axis.set_title(
            f"{title}, {modes.decoupling[number - 1]:.0f} % {main_coordinate(modes, number)}"
        )
    if torque_about is not None:
        along = 0.6 * size * body.torque_roll_axis(torque_about)
        ends = np.array([body.center - along, body.center + along])
        line = {"color": COLOURS[1], "linestyle": (0, (1, 1)), "linewidth": 2}
        axis.plot(*ends.T, label="torque-roll axis", **line)
        # Next to the box: a text at the end of the line would cover numbers of the axes.
        axis.legend(loc="upper left", frameon=False)
    axis.set_xlabel("x (m)")
    axis.set_ylabel("y (m)")
    axis.set_zlabel("z (m)")
    axis.set_aspect("equal")
    axis.locator_params(nbins=5)
    return ax


def plot_energy(modes: BodyModes, ax: Axes | None = None) -> Axes:
    """Draw kinetic energies of modes as a shaded table with numbers.

    Parameters
    ----------
    modes : BodyModes
    ax : Axes, optional
        Axes of the plot; None creates a figure.

    Returns
    -------
    Axes

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
    >>> vv.plot_energy(body.modes()).get_title()
    'kinetic energy (%)'
    """
    _native.check_instance("modes", modes, BodyModes)
    ax = panel(ax, (6, 3.6))
    # One colour from white to dark, so that a greyscale print has the same order.
    ax.imshow(modes.energy, cmap="Blues", vmin=0, vmax=115, aspect="auto")
    for i, row in enumerate(modes.energy):
        for r, share in enumerate(row):
            ax.text(
                r, i, f"{share:.0f}" if abs(share) >= 0.5 else "", ha="center", va="center",
                color="white" if share > 70 else "black",
            )  # fmt: skip
    ax.set_xticks(range(modes.omega.size), [f"{hz:.4g}" for hz in modes.hz])
    ax.set_yticks(range(len(modes.names)), list(modes.names))
    damped = np.iscomplexobj(modes.shapes)
    ax.set_xlabel(f"{'damped' if damped else 'natural'} frequency (Hz)")
    ax.set_title("kinetic energy (%)", fontsize="medium")
    ax.tick_params(length=0)
    return ax


def plot_transmissibility(
    body: Body,
    ax: Axes | None = None,
    *,
    hz: npt.ArrayLike | None = None,
    axis: str = "z",
    point: npt.ArrayLike | None = None,
) -> Axes:
    """Draw the transmissibility from the floor to the body, in dB over Hz.

    Parameters
    ----------
    body : Body
    ax : Axes, optional
        Axes of the plot; None creates a figure.
    hz : array_like, optional
        Frequencies (Hz); by default from a third of the lowest mode to four times the highest.
    axis : "x", "y" or "z"
        Direction of the floor's motion.
    point : array_like, shape (3,), optional
        Point of the body (m); None: the mass centre.

    Returns
    -------
    Axes

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
    >>> vv.plot_transmissibility(body).get_xlabel()
    'frequency (Hz)'
    """
    _native.check_instance("body", body, Body)
    ax = panel(ax, (6, 3.6))
    frequencies = frequency_range(body, hz)
    answer = body.base_transmissibility(2 * math.pi * frequencies, axis, point)
    with np.errstate(divide="ignore"):
        decibels = 20 * np.log10(np.abs(answer))
    for i, name in enumerate("xyz"):
        # Smaller values are rounding errors of the largest.
        if np.abs(answer[:, i]).max() > 1e-9 * np.abs(answer).max():
            ax.plot(
                frequencies, decibels[:, i], color=COLOURS[i], linestyle=STYLES[i],
                label=f"{name} of the body",
            )  # fmt: skip
    ax.axhline(0, color="0.6", linewidth=0.8)
    ax.set_xscale("log")
    ax.set_xlim(frequencies[0], frequencies[-1])
    ax.set_xlabel("frequency (Hz)")
    ax.set_ylabel(f"transmissibility from {axis} of the floor (dB)")
    ax.legend(frameon=False)
    plain_hertz(ax)
    return ax


def plot_mount_forces(
    forces: MountForces,
    ax: Axes | Sequence[Axes] | None = None,
    *,
    harmonic: int = 1,
    x: str = "hz",
    y: str = "linear",
) -> Sequence[Axes]:
    """Draw force amplitudes along the local axes, a panel for each mount.

    Parameters
    ----------
    forces : MountForces
    ax : Axes or sequence of Axes, optional
        One per mount. None creates a figure.
    harmonic : int
    x : {"hz", "rad/s"}
        Unit of the frequencies.
    y : {"linear", "log", "db"}
        Decibels refer to 1 N.
    """
    shown = Shown.checked(x, y)
    if y == "phase":
        raise InputError("y = 'phase': must be one of 'linear', 'log', 'db'")
    axes = panels(ax, len(forces.names), "one per mount")
    nu = shown.places(forces.nu, True)
    for axis, name in zip(axes, forces.names, strict=True):
        sizes = forces.amplitude(name, harmonic)
        for i, local in enumerate("xyz"):
            if np.nanmax(sizes[:, i], initial=0.0) > _STILL * np.nanmax(sizes, initial=0.0):
                style = {"color": COLOURS[i], "linestyle": STYLES[i]}
                axis.plot(nu, shown.sizes(sizes[:, i]), label=local, **style)
        axis.set_ylabel(f"force of {plain(name)} ({'dB re 1 N' if y == 'db' else 'N'})")
        axis.legend(frameon=False)
        shown.finish(axis)
        bare(axis)
    axes[-1].set_xlabel(shown.x_label("circular frequency (rad/s)", True))
    return axes


def plot_mount_forces_in_time(
    forces: MountForcesInTime, ax: Axes | Sequence[Axes] | None = None
) -> Sequence[Axes]:
    """Draw forces along the local axes over time, a panel for each mount.

    Parameters
    ----------
    forces : MountForcesInTime
    ax : Axes or sequence of Axes, optional
        One per mount. None creates a figure.
    """
    axes = panels(ax, len(forces.names), "one per mount")
    for axis, name in zip(axes, forces.names, strict=True):
        for i, local in enumerate("xyz"):
            style = {"color": COLOURS[i], "linestyle": STYLES[i]}
            axis.plot(forces.t, forces.of(name)[:, i], label=local, **style)
        axis.set_ylabel(f"force of {plain(name)} (N)")
        axis.legend(frameon=False)
        bare(axis)
    axes[-1].set_xlabel("$t$ (s)")
    return axes


def frequency_range(body: Body, hz: npt.ArrayLike | None = None) -> FloatArray:
    """Return the frequencies (Hz) of a picture.

    The given ones, which must be positive and ascend, or 800 from a third of the lowest mode to
    four times the highest.
    """
    if hz is not None:
        given = _native.real_array("hz", hz, ndim=1)
        if given.size < 2 or not given[0] >= np.finfo(float).tiny or not (np.diff(given) > 0).all():
            raise InputError("hz: must be two or more positive frequencies, ascending")
        return given
    omega = body.modes().omega
    held = omega[omega > 0] / (2 * math.pi)
    if not held.size:
        raise InputError("hz: must be given for a free body")
    return np.geomspace(held[0] / 3, 4 * held[-1], 800)


def box_of(body: Body) -> FloatArray:
    """Corners of the box of equal mass and inertia, relative to its centre, shape (8, 3)."""
    moments, axes = np.linalg.eigh(body.inertia)
    squares = 6 / body.body_mass * (moments.sum() - 2 * moments)
    half = np.sqrt(np.maximum(squares, 0)) / 2
    signs = np.array([[(c >> i & 1) * 2 - 1 for i in range(3)] for c in range(8)])
    return np.asarray((signs * half) @ axes.T)


def moved_by(points: FloatArray, center: FloatArray, shape: FloatArray) -> FloatArray:
    """Points of a body after a small displacement and rotation, shape (n, 3)."""
    return np.asarray(points + shape[:3] + np.cross(shape[3:6], points - center))


def _draw_box(axis: Any, corners: FloatArray, colour: str, style: Any) -> None:
    for a, b in EDGES:
        axis.plot(*corners[[a, b]].T, color=colour, linestyle=style, linewidth=1)


def draw_mounts(axis: Any, body: Body, size: float) -> None:
    """Draw the three axes of each mount; lengths are proportional to the stiffness."""
    largest = max(float(np.max(mount._elastic)) for mount in body.mounts) or 1.0
    for mount in body.mounts:
        at = np.asarray(mount.position)
        for j in range(3):
            reach = 0.15 * size * float(mount._elastic[j]) / largest
            ends = at + np.outer([-reach, reach], mount.rotation[:, j])
            axis.plot(*ends.T, color=COLOURS[3], linewidth=3, solid_capstyle="butt")
        axis.text(*np.add(at, (0, 0, 0.06 * size)), mount.name)


def main_coordinate(modes: BodyModes, number: int) -> str:
    """Return the coordinate with the largest energy in a mode."""
    return modes.names[int(modes.energy[:, number - 1].argmax())]
