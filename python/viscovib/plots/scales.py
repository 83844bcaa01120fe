"""Plots of the method of multiple scales."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.common.parameters import Names
from viscovib.common.results import Axes
from viscovib.errors import InputError
from viscovib.plots.axes import Shown
from viscovib.plots.panels import panels
from viscovib.plots.style import BY_STABILITY
from viscovib.results.scales import ScalesMotion, ScalesResponse
from viscovib.results.trajectory import Trajectory

#: Neighbours differ by less than this part of their size.
_NEAR = 1 / 3
_DARK, _WARM = "#0b1d51", "#c8452e"
_LABELS = {"z": "z", "x": "x", "phi": r"\varphi", "psi": r"\psi"}
#: Labels for systems with units; other parameters are dimensionless.
_PARAMETERS = {"nu": r"$\nu$ (rad/s)", "load": "load"}


def moving(response: ScalesResponse) -> tuple[str, ...]:
    """Coordinates that move at the frequency of the load; all of them if none does."""
    sizes = np.abs(response.harmonics).max(axis=0, initial=0)
    kept = [n for n, s in zip(response.dof_names, sizes, strict=True) if s > 1e-12 * sizes.max()]
    return tuple(kept) if kept else response.dof_names


def plot_scales_response(
    response: ScalesResponse,
    ax: Axes | Sequence[Axes] | None = None,
    *,
    dofs: Sequence[str] | None = None,
    x: str = "rad/s",
    y: str = "linear",
    reference: float = 1.0,
) -> Sequence[Axes]:
    """Draw the steady motions, one panel per coordinate: amplitude of the load's frequency.

    Stable motions are solid, unstable ones dashed. Motions outside the range of the expansion, and
    single motions between them, are omitted. ``dofs`` are the coordinates, by default those that
    move; ``x``, ``y`` and ``reference`` are those of `plot_response`.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, c3=0.005,
    ...                    f0=0.002, p1=1.02)
    >>> steady = vv.MultipleScales(body).response("p1", np.linspace(1.0, 1.05, 40))
    >>> axes = vv.plot_scales_response(steady, y="log")

    See Also
    --------
    MultipleScales, plot_modulation
    """
    _native.check_instance("response", response, ScalesResponse)
    names = moving(response)
    if dofs is not None:
        names = Names("dofs", response.dof_names).check(dofs)
        if not names:
            raise InputError("dofs: must not be empty")
    shown = Shown.checked(x, y, reference)
    circular = response.parameter == "nu"
    axes = panels(ax, len(names))
    chains = _chains(response)
    at = shown.places(response.at, circular)
    for axis, name in zip(axes, names, strict=True):
        amplitude = shown.sizes(response.harmonics[:, response.dof_names.index(name)])
        named: set[str] = set()
        for chain in chains:
            stable = response.stable[chain]
            for known, label, style in BY_STABILITY:
                part = np.array([one is None for one in stable]) if known is None else (
                    np.asarray(stable == known)
                )  # fmt: skip
                if not part.any():
                    continue
                # A stretch ends at the first point of the next one.
                part[1:] |= part[:-1].copy()
                axis.plot(
                    at[chain], np.where(part, amplitude[chain], np.nan),
                    # A motion without neighbours is drawn as a point.
                    marker=("." if known else "x") if chain.size == 1 else None, markersize=4,
                    label=None if label in named else label, **style,
                )  # fmt: skip
                named.add(label)
        axis.set_ylabel(shown.y_label(f"{_LABELS.get(name, name)}_1", "1"))
        shown.finish(axis)
        axis.spines[["top", "right"]].set_visible(False)
    name = response.parameter
    label = _PARAMETERS.get(name, f"${name[0]}_{{{name[1:]}}}$")
    axes[-1].set_xlabel(shown.x_label(label, circular))
    if chains:
        axes[0].legend(frameon=False)
    return axes


def _chains(response: ScalesResponse) -> list[npt.NDArray[np.intp]]:
    """Return sequences of motions over successive parameter values, only those in range.

    Two motions at successive values are neighbours if each is the nearest to the other and both
    change by less than a third of their size.
    """
    here = np.flatnonzero(response.in_range)
    after: dict[int, int] = {}
    by_value = {v: here[response.index[here] == v] for v in np.unique(response.index[here])}
    for value, mine in by_value.items():
        following = by_value.get(value + 1)
        if following is None:
            continue
        far = np.abs(response.harmonics[mine, None] - response.harmonics[None, following]).max(
            axis=2
        )
        sizes = np.abs(response.harmonics[mine]).max(axis=1)
        nearest, back = far.argmin(axis=1), far.argmin(axis=0)
        for i, j in enumerate(nearest):
            if back[j] == i and far[i, j] <= _NEAR * sizes[i]:
                after[int(mine[i])] = int(following[j])
    chains = []
    begun = set(here.tolist()) - set(after.values())
    for first in sorted(begun):
        chain = [first]
        while chain[-1] in after:
            chain.append(after[chain[-1]])
        chains.append(np.array(chain))
    # A single motion between values without motions in range is not informative.
    longer = [chain for chain in chains if chain.size > 1]
    return longer or chains


def plot_modulation(
    motion: ScalesMotion,
    exact: Trajectory | None = None,
    ax: Axes | Sequence[Axes] | None = None,
) -> Sequence[Axes]:
    """Draw a motion and the envelope of its modes, one panel per coordinate.

    ``exact`` is the same motion by direct integration, drawn behind it. The envelope is the largest
    sum of the modes' amplitudes in the coordinate.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> motion = vv.MultipleScales(body).motion(
    ...     np.linspace(0, 50, 100), [0.05, 0, 0.1, 0, 0, 0]
    ... )
    >>> axes = vv.plot_modulation(motion)
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
    # Above the first panel, because the motion fills the panel.
    axes[0].legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1, 1))
    return axes
