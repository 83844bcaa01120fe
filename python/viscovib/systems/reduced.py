"""Reduced structures: the linear subsystem of a sparse model in few modes, and its error."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.errors import InputError
from viscovib.systems.layers import exponentials_of
from viscovib.systems.linear_model import LinearModel, damping_and_layers
from viscovib.systems.reduction import Reduction, reduce_model
from viscovib.systems.relaxing_rest import relaxing_rest
from viscovib.systems.sparse_pencil import Modes, is_symmetric
from viscovib.systems.stiffness_ratio import warn_of_lost_modes
from viscovib.systems.structure_rest import ModalDamping, Remembered, Rest, dense_rest

#: Frequency of modes for damped coordinates without mass, in units of the highest frequency of
#: interest. Their relative error is the inverse square of this.
_AT_ONCE = 1e6
#: Relative rounding error of the square of a frequency without a warning. It is larger for a mesh
#: of hundreds of elements than for few springs.
_LOST = 1e-5
#: Largest relative part of a load outside the directions of the reduction.
_FOREIGN = 1e-9


@dataclass(frozen=True)
class ReducedRest:
    """A linear subsystem with the reduction that it comes from.

    Attributes
    ----------
    rest : Rest
    reduction : Reduction
    model : LinearModel
        The full equations.
    loads : ndarray, shape (n, r)
        Directions of the reduction, orthonormal.
    top : float
        Highest frequency of the reduction (rad/s).
    tolerance : float
        Tolerance of the reduction.
    """

    rest: Rest
    reduction: Reduction
    model: LinearModel
    loads: FloatArray
    top: float
    tolerance: float

    @property
    def note(self) -> str:
        """Text for a plan."""
        found = self.reduction
        more = found.squares.size - found.n_modes
        return (
            f" ({found.n_modes} of the structure, {things(more, 'static correction')}), error up "
            f"to {self.top:.6g} rad/s {found.largest_error:.1e}"
        )

    def left_out(self, nu: FloatArray, orders: Any, y: ComplexArray) -> FloatArray:
        """Relative errors of motions, shape (n,), from harmonics (n, q, m) of the deflections."""
        sizes = np.square(np.abs(y)).max(axis=1)
        errors = self.error(np.outer(nu, orders))
        total = sizes.sum(axis=1)
        lost = (sizes * errors**2).sum(axis=1)
        return np.asarray(np.sqrt(lost / np.where(total > 0, total, 1.0)))

    def error(self, frequency: FloatArray) -> FloatArray:
        """Relative error of displacements at frequencies (rad/s); 1 above the band."""
        reduction = self.reduction
        omega = np.abs(frequency)
        inside = np.interp(omega, reduction.at, reduction.error)
        return np.where(omega <= self.top * (1 + 1e-9), inside, 1.0)

    def check_loads(self, loads: ComplexArray, names: Sequence[str]) -> None:
        """Refuse loads without a static correction in the reduction."""
        parts = np.concatenate([loads.real, loads.imag], axis=1)
        left = parts - self.loads @ (self.loads.T @ parts)
        foreign = np.abs(left) > _FOREIGN * np.abs(parts).max(initial=0.0)
        if foreign.any():
            i = int(np.flatnonzero(foreign.any(axis=1))[0])
            raise InputError(
                f"load: acts on {names[i]!r} in a direction that the reduction was not made "
                "for, must be among the loads of reduce(..., loads=[...])"
            )


def reduced_rest(
    model: LinearModel,
    loads: FloatArray,
    *,
    frequency: float,
    tolerance: float,
    lowest: float,
    most: int,
    boundary: Sequence[int] | None,
) -> ReducedRest:
    """Reduce the linear subsystem for these loads."""
    if not is_symmetric(model.stiffness):
        raise InputError(
            "stiffness: must be symmetric to be reduced (follower forces need dense matrices)"
        )
    used = loads[:, loads.any(axis=0)]
    found = reduce_model(
        model, used, frequency=frequency, tolerance=tolerance, lowest=lowest, most=most,
        boundary=boundary,
    )  # fmt: skip
    true = slice(found.n_modes)
    warn_of_lost_modes(
        found.squares[true], found.shapes[:, true], model.mass, model.at_rest,
        max(_LOST, tolerance),
    )  # fmt: skip
    return ReducedRest(
        _rest(model, found, frequency), found, model, _orthonormal(used), frequency, tolerance
    )


def _orthonormal(vectors: FloatArray) -> FloatArray:
    left, sizes, _ = np.linalg.svd(vectors / np.abs(vectors).max(axis=0), full_matrices=False)
    return np.asarray(left[:, sizes > 1e-12 * sizes[0]])


def _rest(model: LinearModel, found: Reduction, top: float) -> Rest:
    squares, rates, shapes = found.squares, found.rates, found.shapes
    none = np.zeros((shapes.shape[0], 0), dtype=complex)
    left, right, poles = none, none, np.zeros(0, dtype=complex)
    remembered: tuple[Remembered, ...] = ()
    small: Rest | None = None
    inertia = model.mass @ shapes
    if model.layers:
        small = _relaxing(model, found)
        squares, rates, poles = small.squares, small.rates, small.poles
        left, right = shapes @ small.left, shapes @ small.right
        remembered = tuple(one._replace(seen=inertia) for one in small.remembered)
        shapes = shapes @ small.shapes
    elif model.damping is not None:
        modal = ModalDamping(loss=model.loss) if model.loss else None
        damping, _ = damping_and_layers(model, found)
        small = dense_rest(np.eye(squares.size), damping, np.diag(squares), modal)
        squares, rates, poles = small.squares, small.rates, small.poles
        left, right = shapes @ small.left, shapes @ small.right
        shapes = shapes @ small.shapes
    static, slow = found.static, model.rayleigh[1]
    flexibility = None
    if static.shape[1] and (slow or model.loss):
        square = (_AT_ONCE * top) ** 2
        squares = np.append(squares, np.full(static.shape[1], square))
        rates = np.append(rates, np.full(static.shape[1], slow * square))
        shapes = np.concatenate([shapes, static * np.sqrt(square)], axis=1)
    elif static.shape[1]:
        flexibility = partial(_static, static)
    losses = np.full(squares.size, model.loss)
    return Rest(
        squares, rates, losses, shapes, poles, left, right, flexibility, remembered,
        resisting=partial(_resisting, inertia, None if small is None else small.resisting),
    )  # fmt: skip


def _static(static: FloatArray, forces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Deflections by static corrections, and their part times s."""
    return static @ (static.T @ forces), np.zeros_like(forces)


def _resisting(inertia: FloatArray, inner: Any, u: FloatArray) -> FloatArray:
    """C u, from the damping in modes."""
    return np.zeros_like(u) if inner is None else inertia @ inner(inertia.T @ u)


def _relaxing(model: LinearModel, found: Reduction) -> Rest:
    """The reduced model with layers with memory, in its modes without relaxation."""
    if found.static.shape[1]:
        raise InputError(
            "layers: elements or loads act on coordinates without mass, must have mass there in a "
            "structure that is reduced"
        )
    modal = ModalDamping(loss=model.loss) if model.loss else None
    damping, parts = damping_and_layers(model, found)
    layers = [
        (0.5 * (part + part.T), *exponentials_of(kernel))
        for part, (_, kernel) in zip(parts, model.layers, strict=True)
    ]
    return relaxing_rest(np.eye(found.squares.size), damping, np.diag(found.squares), modal, layers)


def direct_motion(
    loaded: Any, nu: FloatArray, orders: Any, y: ComplexArray, factor: FloatArray
) -> ComplexArray:
    """Harmonics of one motion in all coordinates, shape (n, m), by the full equations.

    ``loaded``: a `LoadedStructure`.

    ``y``: harmonics (1, q, m) of the computed deflections, which give the forces of the elements.
    """
    from viscovib.systems.sparse_roots import direct_solution

    c = loaded.condensation
    if c.reduced is None:
        raise InputError("check: this structure is not reduced")
    model, reduction = c.reduced.model, c.reduced.reduction
    true = slice(reduction.n_modes)
    modes = Modes(reduction.squares[true], reduction.shapes[:, true])
    n = loaded.forces.shape[0]
    found = np.zeros((n, orders.size), dtype=complex)
    forces = c.laws.directions @ loaded.reaction(nu, orders, y, factor)[0]
    for k, order in enumerate(orders):
        j = np.flatnonzero(loaded.orders == order)
        pushed = forces[:, k]
        s = 1j * order * nu[0]
        if j.size:
            pushed = pushed + factor[0] * loaded.forces[:, j[0]]
            pushed = pushed - s**2 * factor[0] * loaded.inertial_force(j[0])
            for values, i in loaded.varying_at(order, nu):
                pushed = pushed + factor[0] * values[0] * loaded.varying[i].force
        if not pushed.any():
            continue
        found[:, k] = direct_solution(model, s, pushed, modes)
        if j.size and loaded.direction is not None:
            found[:, k] += loaded.direction * loaded.base[j[0]] * factor[0]
    return found
