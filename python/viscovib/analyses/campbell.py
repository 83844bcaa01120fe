"""Campbell diagrams of rotors: complex modes over the speed, critical speeds, loss of stability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Result, as_dataset, span
from viscovib.errors import InputError
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.whole import in_all_coordinates

#: Numbers of shapes, and coordinates, up to which the modes take a few milliseconds.
_FEW = 200
#: Largest number of speeds.
_MOST = 100_000


@dataclass(frozen=True, eq=False, repr=False)
class Campbell(Result):
    """Complex modes of a rotor over its speed.

    A mode continues along the speeds by its shape, also where frequencies cross. NaN: the mode does
    not oscillate at this speed.

    Attributes
    ----------
    speeds : ndarray, shape (n,)
        rad/s.
    roots : complex ndarray, shape (n, m)
        Eigenvalues with positive imaginary part (1/s) of free motion exp(s t) about rest.
    shapes : complex ndarray, shape (n, m, n_dof)
        Shapes of the coordinates, x^H M x = 1; NaN where modes with equal eigenvalues leave them
        open.
    growth : ndarray, shape (n,)
        Largest real part (1/s) of all eigenvalues, real ones included.
    whirl : ndarray, shape (n, m), or None
        Motion in ``plane``: 1 forward on a circle, -1 backward on a circle, 0 on a line, in
        between on ellipses. Forward is from the first coordinate to the second. None: no plane was
        given. NaN: without a shape, or without motion in the plane.
    critical_speeds, critical_orders, critical_modes : ndarray, shape (k,)
        Speeds (rad/s) at which the frequency of a mode is an order times the speed, the order, and
        the index of the mode.
    threshold : float
        Speed (rad/s) at which free motion begins to grow: the first one at which a real part is
        positive; the first of ``speeds`` if it is so there. NaN: stable at all speeds.
    dof_names, dof_units : tuple of str
    plane : (str, str) or None

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> disc = vv.PolynomialSystem(
    ...     mass=[1, 1], stiffness=[4, 4], gyroscopic=[[0, 0.5], [-0.5, 0]], names=["a", "b"]
    ... )
    >>> print(vv.campbell(disc, np.linspace(0, 5, 11)).critical_speeds.round(4))
    [1.633  2.8284]
    """

    kind: ClassVar[str] = "campbell"

    speeds: FloatArray
    roots: ComplexArray
    shapes: ComplexArray
    growth: FloatArray
    whirl: FloatArray | None
    critical_speeds: FloatArray
    critical_orders: FloatArray
    critical_modes: npt.NDArray[np.int64]
    threshold: float
    orders: FloatArray
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    plane: tuple[str, str] | None

    @property
    def frequencies(self) -> FloatArray:
        """Natural circular frequencies Im s (rad/s), shape (n, m)."""
        return self.roots.imag.copy()

    @property
    def damping_ratios(self) -> FloatArray:
        """-Re s/|s|, shape (n, m); negative where the motion grows."""
        found: FloatArray = -self.roots.real / np.abs(self.roots)
        return found

    def _headline(self) -> str:
        return (
            f"{things(self.roots.shape[1], 'mode')} at {things(self.speeds.size, 'speed')}, "
            f"{things(self.critical_speeds.size, 'critical speed')}"
        )

    def _scope(self) -> list[str]:
        lines = [f"speeds: {span(self.speeds, 'rad/s')}; frequencies: "
                 f"{span(self.frequencies, 'rad/s')}"]  # fmt: skip
        if self.critical_speeds.size:
            shown = ", ".join(f"{speed:.6g}" for speed in self.critical_speeds[:6])
            more = ", ..." if self.critical_speeds.size > 6 else ""
            lines.append(f"critical speeds: {shown}{more} rad/s")
        if np.isnan(self.threshold):
            lines.append("no eigenvalue has a positive real part")
        else:
            lines.append(f"unstable from {self.threshold:.6g} rad/s on")
        return lines

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over speed and mode."""
        over = ("speed", "mode")
        data: dict[str, Any] = {
            "frequency": (over, self.frequencies, {"units": "rad/s"}),
            "damping_ratio": (over, self.damping_ratios),
            "growth": ("speed", self.growth, {"units": "1/s"}),
            "root": (over, self.roots, {"units": "1/s"}),
            "shape": ((*over, "dof"), self.shapes),
        }
        if self.whirl is not None:
            data["whirl"] = (over, self.whirl)
        for name, units in (("speeds", "rad/s"), ("orders", "1"), ("modes", "1")):
            data[f"critical_{name}"] = (
                "critical", getattr(self, f"critical_{name}"), {"units": units},
            )  # fmt: skip
        return as_dataset(
            data,
            coords={
                "speed": ("speed", self.speeds, {"units": "rad/s"}),
                "mode": np.arange(self.roots.shape[1]),
                "dof": list(self.dof_names),
                "unit": ("dof", list(self.dof_units)),
            },
            attrs={"threshold": self.threshold},
        )


def campbell(
    system: PolynomialSystem | Structure,
    speeds: npt.ArrayLike,
    *,
    orders: npt.ArrayLike = 1.0,
    plane: Sequence[str] | None = None,
) -> Campbell:
    """Compute the modes of a rotor over its speed: a Campbell diagram.

    The modes are those of free motion about rest, with damping, and with memory if the kernels are
    sums of exponentials. Loads and nonlinear terms are omitted.

    Parameters
    ----------
    system : PolynomialSystem or Structure
        With `gyroscopic`, `circulatory` or `centrifugal` matrices and without ``speed``. The modes
        of a system without them do not depend on the speed.
    speeds : array_like, shape (n,)
        Speeds (rad/s), increasing, from 0 on.
    orders : array_like, shape (k,)
        Orders of excitation, each > 0: critical speeds are those with a frequency of an order times
        the speed; 1 for an unbalance.
    plane : (str, str), optional
        Two coordinates of a plane, such as the displacements of the disc, for the direction of
        `Campbell.whirl`.

    Returns
    -------
    Campbell

    Raises
    ------
    InputError
        With the argument, its value and the allowed values.

    Notes
    -----
    Eigenvalues of the state matrix at each speed. A mode continues the one at the previous speed
    with the most similar shape; further speeds are added between two of them where shapes change
    much. Critical speeds and the loss of stability are located between the speeds given, to
    rounding error: a frequency that meets an order twice between two of them is missed. A real part
    counts as positive if it exceeds the rounding error of its eigenvalue.

    Examples
    --------
    A shaft with internal damping 0.2 and external damping 0.1 is unstable from omega (1 + 0.1/0.2):

    >>> import numpy as np
    >>> import viscovib as vv
    >>> shaft = vv.PolynomialSystem(
    ...     mass=[1, 1],
    ...     stiffness=[1, 1],
    ...     damping=[0.3, 0.3],
    ...     circulatory=[[0, 0.2], [-0.2, 0]],
    ...     names=["x", "y"],
    ... )
    >>> diagram = vv.campbell(shaft, np.linspace(0, 3, 13), plane=("x", "y"))
    >>> print(round(diagram.threshold, 6))
    1.5
    """
    _native.check_instance("system", system, PolynomialSystem, Structure)
    whole: PolynomialSystem = in_all_coordinates(system, always=True)
    if whole._turns:
        raise InputError(
            "geometry = 'exact': campbell is not available for finite rotations: use geometry = "
            "'small'"
        )
    if whole.speed is not None:
        raise InputError("speed: must not be given for campbell, which varies it")
    over = _native.real_array("speeds", speeds, ndim=1)
    if not 1 <= over.size <= _MOST:
        raise InputError(f"speeds: {over.size} values, must be 1 to {_MOST}")
    if over[0] < 0:
        raise InputError(f"speeds[0] = {over[0]:g}: must not be negative")
    falls = np.flatnonzero(np.diff(over) <= 0)
    if falls.size:
        i = int(falls[0]) + 1
        raise InputError(
            f"speeds[{i}] = {over[i]:g} after {over[i - 1]:g}: must be strictly increasing"
        )
    wanted = np.atleast_1d(_native.real_array("orders", orders))
    if wanted.ndim != 1 or (wanted <= 0).any():
        raise InputError(f"orders = {_native.shown(orders)}: must be numbers greater than 0")
    places = _plane(whole, plane)
    n = len(whole.dof_names)
    given = {"speeds": over, "orders": wanted.astype(float)}
    given |= {} if places is None else {"plane": np.array(places) + 1}
    found = _native.run_either(n * over.size > _FEW, "system campbell", whole._handle, **given)
    roots, shapes = found["roots"].T, np.moveaxis(found["shapes"], 0, -1).swapaxes(0, 1)
    return Campbell(
        over.copy(), np.ascontiguousarray(roots), np.ascontiguousarray(shapes), found["growth"],
        None if places is None else found["whirl"].T.copy(), found["critical"], found["order"],
        found["mode"].astype(np.int64) - 1, float(found["threshold"]), wanted.copy(),
        whole.dof_names, whole.dof_units,
        None if places is None else (whole.dof_names[places[0]], whole.dof_names[places[1]]),
    )  # fmt: skip


def _plane(system: PolynomialSystem, plane: Any) -> tuple[int, int] | None:
    """Return the places of the two coordinates of a plane."""
    if plane is None:
        return None
    names = system.dof_names
    known = isinstance(plane, (list, tuple)) and all(one in names for one in plane)
    if not known or len(set(plane)) != 2 or len(plane) != 2:
        raise InputError(
            f"plane = {_native.shown(plane)}: must be two of the coordinates {', '.join(names)}"
        )
    return names.index(plane[0]), names.index(plane[1])
