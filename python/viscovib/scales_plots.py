"""Pictures of the method of multiple scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from viscovib import _native
from viscovib.errors import InputError
from viscovib.panels import panels
from viscovib.parameters import Names
from viscovib.scales_results import ScalesMotion, ScalesResponse
from viscovib.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DARK, _WARM = "#0b1d51", "#c8452e"
_LABELS = {"z": "z", "x": "x", "phi": r"\varphi", "psi": r"\psi"}
#: Loads of systems with units; those of others are dimensionless.
_PARAMETERS = {"nu": r"$\nu$ (rad/s)", "load": "load"}


def moving(response: ScalesResponse) -> tuple[str, ...]:
    """Coordinates in which the load's frequency shows, all of them if none does."""
    sizes = np.abs(response.harmonics).max(axis=0, initial=0)
    kept = [n for n, s in zip(response.dof_names, sizes, strict=True) if s > 1e-12 * sizes.max()]
    return tuple(kept) if kept else response.dof_names


def plot_scales_response(
    response: ScalesResponse,
    ax: Axes | Sequence[Axes] | None = None,
    *,
    dofs: Sequence[str] | None = None,
) -> Sequence[Axes]:
    """Draw the steady motions, one panel a coordinate: amplitude of the load's frequency.

    Stable motions are full dots, unstable ones crosses; those outside the range of the expansion
    are left out. ``dofs`` are the coordinates, by default those that move.
    """
    _native.check_instance("response", response, ScalesResponse)
    names = moving(response)
    if dofs is not None:
        names = Names("dofs", response.dof_names).check(dofs)
        if not names:
            raise InputError("dofs: must not be empty")
    axes = panels(ax, len(names))
    for axis, name in zip(axes, names, strict=True):
        amplitude = response.amplitude(name)
        for stable, marker, colour in ((True, ".", _DARK), (False, "x", _WARM)):
            shown = (response.stable == stable) & response.in_range
            axis.plot(
                response.at[shown],
                amplitude[shown],
                ls="none",
                marker=marker,
                markersize=3,
                markeredgewidth=0.6,
                color=colour,
                label="stable" if stable else "unstable",
            )
        axis.set_ylabel(rf"amplitude $|{_LABELS.get(name, name)}_1|$")
        axis.spines[["top", "right"]].set_visible(False)
    name = response.parameter
    axes[-1].set_xlabel(_PARAMETERS.get(name, f"${name[0]}_{{{name[1:]}}}$"))
    axes[0].legend(frameon=False, markerscale=2.5)
    return axes


def plot_modulation(
    motion: ScalesMotion,
    exact: Trajectory | None = None,
    ax: Axes | Sequence[Axes] | None = None,
) -> Sequence[Axes]:
    """Draw a motion and the envelope of its modes, one panel a coordinate.

    ``exact`` is the same motion by direct integration, drawn below it. The envelope adds up what
    the modes' amplitudes make of the coordinate at most.
    """
    _native.check_instance("motion", motion, ScalesMotion)
    if exact is not None:
        _native.check_instance("exact", exact, Trajectory)
        if exact.dof_names != motion.dof_names:
            raise InputError(
                f"exact: has coordinates {', '.join(exact.dof_names)}, must have "
                f"{', '.join(motion.dof_names)}"
            )
    names = motion.dof_names
    axes = panels(ax, len(names))
    for d, (axis, name) in enumerate(zip(axes, names, strict=True)):
        if exact is not None:
            axis.plot(exact.t, exact.state[:, 2 * d], color="0.7", lw=2.2, label="integrated")
        axis.plot(motion.t, motion.state[:, 2 * d], color=_DARK, lw=0.8, label="multiple scales")
        envelope = motion.modulation.amplitude @ np.abs(motion.mode_shapes[d])
        for sign in (1, -1):
            label = "envelope" if sign == 1 else None
            axis.plot(motion.t, sign * envelope, color=_WARM, ls=(0, (4, 1.5)), label=label)
        axis.set_ylabel(rf"${_LABELS.get(name, name)}$")
        axis.spines[["top", "right"]].set_visible(False)
    axes[-1].set_xlabel("t")
    # Above the first panel: the motion fills it.
    axes[0].legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1, 1))
    return axes
