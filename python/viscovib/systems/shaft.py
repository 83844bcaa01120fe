"""Rotors whose speed changes in time: the angle of the shaft as an additional coordinate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields, short_repr
from viscovib.errors import InputError
from viscovib.systems.elements import direction_of
from viscovib.systems.laws import compile_law
from viscovib.systems.load import name_places
from viscovib.systems.load_table import LoadTable, PiecewiseTable, RunUp, added
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.speed_matrices import WithSpeed
from viscovib.systems.system import System
from viscovib.systems.whole import lacks_wholeness, whole_system

#: The coordinate of the shaft (rad).
ANGLE = "angle"
#: Default accuracy, relative to the largest value of each coordinate: angles may be large.
USUAL_RTOL = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DriveTorque:
    r"""A motor that turns an unbalanced rotor: the speed is an unknown.

    As ``force`` of `simulate`. The angle phi of the shaft becomes the additional coordinate "angle"
    of the result:

    .. math::
        J \ddot\varphi = T(\dot\varphi, \varphi)
            - \mathrm{Re}[u\,e^{i\varphi}] \cdot \ddot x, \qquad
        M \ddot x + \ldots = \mathrm{Im}[u\,(\dot\varphi^2 - i\ddot\varphi)\,e^{i\varphi}]

    Matrices that depend on the speed are those at phi'. Near a resonance the vibration takes the
    power of the motor, so the speed may stay there (Sommerfeld effect).

    Parameters
    ----------
    torque : str
        T (N m), a formula in the speed ``nu`` (rad/s) and the angle ``phi`` (rad), such as
        "5 - 0.1*nu".
    inertia : float
        J (kg m^2) about the axis, including m e^2 of the unbalance.
    unbalance : complex or array_like, shape (n_dof,)
        u = m e (kg m), as for `RunUp`.
    speed, phase : float
        Initial speed (rad/s) and angle (rad).

    Notes
    -----
    Not included: the weight of the unbalance, torques on the shaft by matrices that depend on the
    speed (of second order in the displacements), a moving base, and rigid stops.

    Source: V. O. Kononenko, Vibrating Systems with a Limited Power Supply, Iliffe 1969.

    Examples
    --------
    >>> import viscovib as vv
    >>> rotor = vv.PolynomialSystem(
    ...     mass=[1, 1], stiffness=[100, 100], damping=[1, 1], names=["x", "y"]
    ... )
    >>> drive = vv.DriveTorque(torque="0.2 - 0.01*nu", inertia=0.05, unbalance=[0.01, -0.01j])
    >>> run = vv.simulate(rotor, 5.0, force=drive)
    >>> run.system.dof_names
    ('x', 'y', 'angle')
    """

    torque: str
    inertia: float
    unbalance: npt.ArrayLike = 0.0
    speed: float = 0.0
    phase: float = 0.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        own_fields(self, "unbalance")
        if not isinstance(self.torque, str):
            raise InputError(f"torque = {_native.shown(self.torque)}: must be a formula in nu")
        compile_law("torque", self.torque, ("nu", "phi"), {})
        for name in ("inertia", "speed", "phase"):
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        if not self.inertia > 0:
            raise InputError(f"inertia = {self.inertia:g}: must be greater than 0")
        size = _native.complex_array("unbalance", self.unbalance)
        if size.ndim > 1:
            raise InputError(
                f"unbalance: must be a number or have shape (n_dof,), got {size.shape}"
            )

    def _columns(self, n: int) -> npt.NDArray[np.complex128]:
        """The unbalance of each coordinate."""
        size = _native.complex_array("unbalance", self.unbalance)
        if size.ndim == 0:
            return np.append(size, np.zeros(n - 1))
        if size.shape != (n,):
            raise InputError(f"unbalance: must have shape ({n},), got {size.shape}")
        return size


class OnShaft(PolynomialSystem):
    """A system with the angle of its shaft as its last coordinate, for motions in time only."""

    _has_hidden_forces = True
    #: The system without the angle.
    given: Any = None

    @classmethod
    def of(
        cls, system: Any, torque: str, inertia: float, unbalance: npt.NDArray[np.complex128]
    ) -> OnShaft:
        """Put a system on a shaft; no torque: the speed is given by a load on the angle."""
        whole = whole_system(system) if system._is_condensed else system
        direction = whole._base_direction
        found = cls(
            mass=_padded(whole._mass_matrix, inertia), damping=_padded(whole._damping),
            stiffness=_padded(whole._stiffness_at_rest), names=(*system.dof_names, ANGLE),
            units=(*system.dof_units, "rad"),
            base_direction=None if direction is None else np.append(direction, 0.0),
        )  # fmt: skip
        handle = _native.Handle(
            "system on shaft", whole._handle, torque=torque, inertia=inertia, unbalance=unbalance
        )
        found.__dict__.update(given=system, _vector=whole._flat, _handle=handle)
        return found

    def _check_large(self) -> None:
        """The core checks the system."""

    def _turned(self, nu: float | None = None) -> Any:
        raise InputError("system: the speed of its shaft changes, use simulate")

    @property
    def _places(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.dof_names)}

    @property
    def _space(self) -> tuple[FloatArray, FloatArray] | None:
        space = getattr(self.given, "_space", None)
        return None if space is None else (_padded(space[0]), _padded(space[1]))

    @property
    def _element_directions(self) -> FloatArray:
        return np.pad(self.given._element_directions, ((0, 1), (0, 0)))

    @property
    def _all_elements(self) -> Any:
        return self.given._all_elements


def _padded(matrix: FloatArray, last: float = 0.0) -> FloatArray:
    """The matrix with a row and a column of the angle."""
    wide = np.pad(matrix, (0, 1))
    wide[-1, -1] = last
    return wide


def turns_shaft(system: System, force: object) -> bool:
    """True if the speed of the matrices, or of the load, changes in the motion."""
    if isinstance(force, DriveTorque):
        return True
    return isinstance(force, RunUp) and system._depends_on_speed


def with_shaft(
    system: Any, force: DriveTorque | RunUp, initial: npt.ArrayLike | None
) -> tuple[OnShaft, FloatArray, LoadTable | None]:
    """Return the system with the angle as its last coordinate, its initial state and its load."""
    _check(system, "a motor" if isinstance(force, DriveTorque) else "a speed that changes")
    n = len(system.dof_names)
    start = np.zeros(2 * n) if initial is None else _native.real_array("initial", initial)
    if start.shape != (2 * n,):
        raise InputError(f"initial: must have shape ({2 * n},), got {start.shape}")
    if isinstance(force, DriveTorque):
        found = OnShaft.of(system, force.torque, force.inertia, force._columns(n))
        return found, np.append(start, [force.phase, force.speed]), None
    turn, table = _given_speed(system, force)
    return OnShaft.of(system, "", 1.0, np.zeros(n, complex)), np.append(start, turn), table


def _check(system: Any, what: str) -> None:
    """Refuse systems without the equations of a shaft."""
    if isinstance(system, OnShaft) or ANGLE in system.dof_names:
        raise InputError(f"names: must not contain {ANGLE!r}, the name of the angle of the shaft")
    if not isinstance(system, WithSpeed) or system._turns:
        raise InputError(
            f"force: {what} is for a PolynomialSystem, a Structure, or a Body of small rotations"
        )
    own: Any = system
    if own._is_condensed and (note := lacks_wholeness(own)) is not None:
        raise InputError(f"force: {what} {note}")
    if any(law.calls for law in system._all_laws):
        raise InputError(f"forces: must not be Python functions with {what}")


def _given_speed(system: Any, load: RunUp) -> tuple[FloatArray, LoadTable]:
    """Initial angle and speed of a run-up, and its load with the acceleration of the angle."""
    n = len(system.dof_names)
    if load.on is not None and system._is_condensed:
        direction = direction_of("on", load.on, n, name_places(system.dof_names))
        own = np.multiply.outer(direction, load._polynomials(np.zeros((1, 1)))[0])
    else:
        own = load._pieces(n)
    found = load._turn()
    rise = np.zeros((n + 1, *found["turn_pieces"].shape), order="F")
    rise[n] = found["turn_pieces"]
    wider = np.asfortranarray(np.pad(own, ((0, 1), (0, 0), (0, 0))))
    times, both = added((np.asarray(load.times), wider), (found["turn_times"], rise))
    return np.asarray(found["turn_start"]), PiecewiseTable.of(times, both)
