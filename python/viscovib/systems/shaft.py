"""Rotors whose speed changes in time: the angle of the shaft as an additional coordinate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.expression import spell
from viscovib.common.values import own_fields, short_repr
from viscovib.errors import InputError
from viscovib.systems.elements import Coupling, direction_of
from viscovib.systems.laws import compile_law
from viscovib.systems.load import name_places
from viscovib.systems.load_table import LoadTable, PiecewiseTable, RunUp, added
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.speed_matrices import OF_SPEED
from viscovib.systems.spring_groups import SpringGroup, Springs
from viscovib.systems.structure import Structure
from viscovib.systems.structure_matrices import block_diagonal, dense_of, longer
from viscovib.systems.system import System

#: The coordinate of the shaft (rad).
ANGLE = "angle"
#: Default accuracy, relative to the largest value of each coordinate: angles may be large.
USUAL_RTOL = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DriveTorque:
    r"""A motor that turns an unbalanced rotor: the speed is an unknown.

    As ``force`` of `simulate`, for a `PolynomialSystem` without kernels. The angle phi of the shaft
    becomes the additional coordinate "angle" of the result:

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
    Not included: the weight of the unbalance, and torques on the shaft by matrices that depend on
    the speed (of second order in the displacements).

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


def turns_shaft(system: System, force: object) -> bool:
    """True if the speed of the matrices, or of the load, changes in the motion."""
    if isinstance(force, DriveTorque):
        return True
    return isinstance(force, RunUp) and system._depends_on_speed


def with_shaft(
    system: Any, force: DriveTorque | RunUp, initial: npt.ArrayLike | None, end: float
) -> tuple[PolynomialSystem | Structure, FloatArray, LoadTable | None]:
    """Return the system with the angle as its last coordinate, its initial state and its load.

    ``end``: end of the motion.
    """
    what = "a motor" if isinstance(force, DriveTorque) else "a speed that changes"
    known = (PolynomialSystem, Structure) if isinstance(force, RunUp) else (PolynomialSystem,)
    if type(system) not in known:
        raise InputError(
            f"force: {what} is for a PolynomialSystem, this is a {type(system).__name__}: use a "
            "PolynomialSystem in its coordinates or modes"
        )
    if ANGLE in system.dof_names:
        raise InputError(f"names: must not contain {ANGLE!r}, the name of the angle of the shaft")
    n = len(system.dof_names)
    start = np.zeros(2 * n) if initial is None else _native.real_array("initial", initial)
    if start.shape != (2 * n,):
        raise InputError(f"initial: must have shape ({2 * n},), got {start.shape}")
    by_elements = isinstance(system, Structure)
    if not by_elements and any(law.calls for law in system._all_laws):
        raise InputError(f"forces: must not be Python functions with {what}")
    if isinstance(force, DriveTorque):
        if system._active_kernels:
            raise InputError("kernel: must not be given with a DriveTorque")
        own, inertia = _driven(system, force), force.inertia
        turning, table = np.array([force.phase, force.speed]), None
    else:
        turning, table = _given_speed(system, force, end, spring=float(by_elements))
        if by_elements:
            return _structure_with_shaft(system), np.concatenate([start, turning]), table
        own, inertia = _of_speed(system._speed_matrices, system.dof_names), 1.0
    return _extended(system, own, inertia), np.concatenate([start, turning]), table


def _given_speed(
    system: Any, load: RunUp, end: float, spring: float
) -> tuple[FloatArray, LoadTable]:
    """Initial angle and speed of a run-up, and its load with that of the angle.

    ``spring``: stiffness on the angle (N m/rad). That of a structure is 1, since its modes must not
    be defective. The load of the spring follows from the angle, which is known.
    """
    n = len(system.dof_names)
    if load.on is not None and spring:
        direction = direction_of("on", load.on, n, name_places(system.dof_names))
        own = np.multiply.outer(direction, load._polynomials(np.zeros((1, 1)))[0])
    else:
        own = load._pieces(n)
    first, last = load._ends("speed", "speeds")
    begin, length = load._number("start"), load._number("duration")
    slope = (last - first) / length
    times = np.array([begin, begin + length])
    if begin > 0:
        times = np.append(0.0, times)
    if spring:
        times = np.append(times, max(end, times[-1]) + length)
    passed = np.clip(times - begin, 0.0, length)
    speed = first + slope * passed
    angle = load._number("phase") + first * np.minimum(times - begin, 0.0)
    angle += first * passed + 0.5 * slope * passed**2 + last * np.maximum(times - begin - length, 0)
    rise = np.where((times >= begin) & (times < begin + length), slope, 0.0)
    pieces = np.zeros((n + 1, 3, times.size), order="F")
    pieces[n] = [0.5 * spring * rise, spring * speed, rise + spring * angle]
    pieces[:, :, -1] = 0.0
    wider = np.asfortranarray(np.pad(own, ((0, 1), (0, 0), (0, 0))))
    found, both = added((np.asarray(load.times), wider), (times, pieces))
    # At t = 0, which may be within the run-up.
    at = np.clip(-begin, 0.0, length)
    turned = load._number("phase") - first * max(begin, 0.0) + first * at + 0.5 * slope * at**2
    turned += last * max(-begin - length, 0.0)
    return np.array([turned, first + slope * at]), PiecewiseTable.of(found, both)


def _extended(system: Any, more: dict[int, str], inertia: float) -> PolynomialSystem:
    """The system with the angle; ``more``: further forces by equation."""
    n = len(system.dof_names)
    names = (*system.dof_names, ANGLE)
    groups = [(group, _texts(group, system)) for group in system.groups]
    kept = [
        Springs(stiffness=np.pad(_stiffness(group), (0, 1)), forces=_by_name(texts, names),
                kernel=group.kernel)
        for group, texts in groups
    ]  # fmt: skip
    mass = np.pad(system._mass_matrix, (0, 1))
    mass[n, n] = inertia
    direction = system._base_direction
    return PolynomialSystem(
        mass=mass, damping=np.pad(np.asarray(system.damping, dtype=float), (0, 1)),
        forces=_by_name(more, names), springs=kept, parameters=system.parameters, names=names,
        units=(*system.dof_units, "rad"),
        base_direction=None if direction is None else np.append(direction, 0.0),
    )  # fmt: skip


def _by_name(texts: dict[int, str], names: tuple[str, ...]) -> dict[str, str]:
    return {names[on]: text for on, text in texts.items()}


def _stiffness(group: SpringGroup) -> FloatArray:
    """K without the linear parts of laws, which are in their texts."""
    return group.stiffness if group.law_slopes is None else group.stiffness - group.law_slopes


def _texts(group: SpringGroup, system: Any) -> dict[int, str]:
    """Nonlinear forces of a group by equation."""
    found: dict[int, list[str]] = {}
    for (on, powers), c in group.forces.items():
        found.setdefault(on, []).append(f"{c!r}*{spell(powers, system.dof_names)}")
    for on, law in group.whole:
        found.setdefault(on, []).append(f"({law.text})")
    return {on: " + ".join(terms) for on, terms in found.items()}


def _structure_with_shaft(system: Structure) -> Structure:
    """The structure with the angle; matrices that depend on the speed are a coupling."""
    if system._reduced is not None or system._held is not None or system._plain:  # type: ignore[attr-defined]
        raise InputError(
            "force: a speed that changes needs a structure without reduction, supports and Maxwell "
            "elements; for a reduced one use structure.reduce(...).in_modes().structure"
        )
    n, names = system.n_coordinates, (*system.dof_names, ANGLE)
    damping = system._damping_at_rest
    matrices = [getattr(system, name) for name in OF_SPEED]
    parts = [np.zeros((n, n)) if one is None else dense_of(one) for one in matrices]
    short = [f"q{i}" for i in range(n)]
    law = {short[on]: text for on, text in _of_speed(parts, short).items()}
    touched = np.flatnonzero(np.abs([*parts, *(one.T for one in parts)]).any(axis=(0, 1)))
    on = {short[i]: names[i] for i in touched.tolist()} | {ANGLE: ANGLE}
    mass, stiffness = (block_diagonal(one, 1, 1.0) for one in (system.mass, system.stiffness))
    direction = system._base_direction
    return Structure(
        mass=mass, stiffness=stiffness,
        damping=block_diagonal(damping, 1), names=names, units=(*system.dof_units, "rad"),
        elements=[
            *(replace(one, on=longer(one.on, n, 1)) for one in system.elements),
            Coupling(on=on, law=law),
        ],
        layers=[(block_diagonal(one, 1), kernel) for one, kernel in system.layers],
        base_direction=None if direction is None else np.append(direction, 0.0),
    )  # fmt: skip


def _of_speed(matrices: Sequence[FloatArray], names: Sequence[str]) -> dict[int, str]:
    """Forces of the matrices that depend on the speed, by equation."""
    found: dict[int, list[str]] = {}
    factors = (f"{ANGLE}_dot", f"{ANGLE}_dot", f"{ANGLE}_dot^2")
    for matrix, factor, rate in zip(matrices, factors, ("_dot", "", ""), strict=True):
        for i, j in np.argwhere(matrix).tolist():
            term = f"{float(matrix[i, j])!r}*{factor}*{names[j]}{rate}"
            found.setdefault(i, []).append(term)
    return {on: " + ".join(terms) for on, terms in found.items()}


def _driven(system: Any, drive: DriveTorque) -> dict[int, str]:
    """Forces of the unbalance and the motor, with the angular acceleration eliminated.

    With p = -Re[u e^(i phi)], q = Im[u e^(i phi)] and the forces f of the system,
    (J - p M^-1 p) phi'' = T + p M^-1 (q phi'^2 - f).
    """
    n, names = len(system.dof_names), system.dof_names
    unbalance = drive._columns(n)
    inverse = np.linalg.inv(system._mass_matrix)
    moved = inverse @ unbalance
    squares = np.array(
        [[part @ other for other in (moved.real, moved.imag)]
         for part in (unbalance.real, unbalance.imag)]
    )  # fmt: skip
    most = float(np.linalg.eigvalsh(0.5 * (squares + squares.T)).max())
    if not most < drive.inertia:
        raise InputError(
            f"inertia = {drive.inertia:g}: must be greater than {most:g}, (m e)^2 of the unbalance "
            "divided by the mass"
        )
    s, c, rate = f"sin({ANGLE})", f"cos({ANGLE})", f"{ANGLE}_dot"

    def p(u: complex) -> str:
        return f"({-u.real!r}*{c} + {u.imag!r}*{s})"

    def q(u: complex) -> str:
        return f"({u.real!r}*{s} + {u.imag!r}*{c})"

    turning = _of_speed(system._speed_matrices, names)
    torque = re.sub(r"\bnu\b", rate, drive.torque)
    torque = re.sub(r"\bphi\b", ANGLE, torque)
    power = [f"({torque})*exp(0*{ANGLE})"]
    for i in np.flatnonzero(moved).tolist():
        force = _force_on(system, i, turning)
        power.append(f"{p(complex(moved[i]))}*({q(complex(unbalance[i]))}*{rate}^2 - ({force}))")
    (aa, ab), (_, bb) = squares.tolist()
    left = f"({drive.inertia!r} - ({aa!r}*{c}^2 - {2 * ab!r}*{s}*{c} + {bb!r}*{s}^2))"
    acceleration = f"(({' + '.join(power)})/{left})"
    found = dict(turning)
    for i in np.flatnonzero(unbalance).tolist():
        u = complex(unbalance[i])
        own = f"-({q(u)}*{rate}^2 + {p(u)}*{acceleration})"
        found[i] = f"{found[i]} + {own}" if i in found else own
    found[len(names)] = f"-{drive.inertia!r}*{acceleration}"
    return found


def _force_on(system: Any, i: int, turning: dict[int, str]) -> str:
    """All forces of the system in one equation."""
    names, terms = system.dof_names, ["0"]
    stiffness = np.asarray(sum(_stiffness(group) for group in system.groups))
    for matrix, rate in ((stiffness, ""), (np.asarray(system.damping, dtype=float), "_dot")):
        terms += [f"{float(matrix[i, j])!r}*{names[j]}{rate}" for j in np.flatnonzero(matrix[i])]
    for group in system.groups:
        texts = _texts(group, system)
        terms += [texts[i]] if i in texts else []
    return " + ".join([*terms, turning.get(i, "0")])
