"""Axes of plots: given ones, or those of a new figure."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from viscovib import _native
from viscovib.common.parameters import Parameter
from viscovib.common.results import Axes
from viscovib.errors import InputError


def panels(ax: Any, n: int, each: str = "one per coordinate") -> list[Any]:
    """Return the n given axes, or those of a new figure with n panels above each other.

    ``each``: the purpose of an axis, for the error message.
    """
    if ax is None:
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(7, 3 * n), layout="constrained")
        ax = figure.subplots(n, 1, sharex=True)
    axes = _given(ax)
    if len(axes) != n:
        raise InputError(f"ax: {len(axes)} axes given, must be {n}, {each}")
    return axes


def chosen_panels(
    ax: Any, names: tuple[str, ...], moving: tuple[str, ...]
) -> tuple[tuple[str, ...], list[Any]]:
    """Return coordinates and their axes: the moving ones, or all if there are axes for all."""
    if ax is None or len(_given(ax)) == len(moving) != len(names):
        return moving, panels(ax, len(moving))
    return names, panels(ax, len(names))


def panel(ax: Any, figsize: tuple[float, float] = (7, 5)) -> Axes:
    """Return the given axes, or those of a new figure."""
    if ax is None:
        import matplotlib.pyplot as plt

        return plt.figure(figsize=figsize, layout="constrained").subplots()
    axes = _given(ax)
    if len(axes) != 1:
        raise InputError(f"ax: {len(axes)} axes given, must be 1")
    return axes[0]  # type: ignore[no-any-return]


def _given(ax: Any) -> list[Any]:
    from matplotlib.axes import Axes

    axes = [ax] if isinstance(ax, Axes) else ax
    if isinstance(axes, np.ndarray):
        axes = axes.ravel().tolist()
    if not isinstance(axes, (list, tuple)) or not all(isinstance(one, Axes) for one in axes):
        raise InputError(f"ax = {_native.shown(ax)}: must be Axes, or a sequence of them")
    return list(axes)


class Labels(Parameter[Sequence[str] | None]):
    """A label for each curve, or None."""

    def check(self, value: Any) -> Sequence[str] | None:
        """Return the labels unchanged."""
        if value is None or (isinstance(value, (list, tuple)) and not value):
            return None
        if not isinstance(value, (list, tuple)) or not all(isinstance(one, str) for one in value):
            raise InputError(
                f"{self.name} = {_native.shown(value)}: must be a list or tuple of texts"
            )
        return value

    def of(self, value: Any, n: int) -> Sequence[str] | None:
        """Return the labels if there is one for each of n curves."""
        labels = self.check(value)
        if labels is not None and len(labels) < n:
            raise InputError(f"{self.name}: {len(labels)} given, must be {n}, one per curve")
        return labels


def order_of(harmonic: Any, name: str) -> Any:
    """Return the order to draw for a coordinate: a common one, or that in a mapping."""
    if not isinstance(harmonic, Mapping):
        return harmonic
    if name not in harmonic:
        raise InputError(f"harmonic: has no order for {name!r}, must have one for each coordinate")
    return harmonic[name]
