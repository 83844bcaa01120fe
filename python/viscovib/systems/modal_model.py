"""A reduced structure as a small structure in modal coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.elements import Coupling, Spring, direction_of
from viscovib.systems.layers import Layers
from viscovib.systems.linear_model import damping_and_layers
from viscovib.systems.speed_matrices import OF_SPEED

if TYPE_CHECKING:
    from viscovib.systems.structure import Structure


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Result of `Structure.in_modes`: u = shapes q, and the equations of q as a `Structure`.

    Attributes
    ----------
    structure : Structure
        q'' + C q' + diag(squares) q + elements = shapes' p, with coordinates "q1", "q2", ...
    shapes : ndarray, shape (n, m)
        Displacements of all coordinates in each mode, shapes' M shapes = 1.
    names : tuple of str
        Names of the coordinates u.
    error : float
        Largest relative error of displacements by the reduction, up to its highest frequency
        (`Reduction.largest_error`). The errors of results of ``structure`` do not include it.

    Examples
    --------
    >>> import numpy as np, scipy.sparse as sp, viscovib as vv
    >>> k = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(900, 900)) * 1e4
    >>> bar = vv.Structure(mass=sp.eye_array(900), stiffness=k, modal_damping=0.02,
    ...                    elements=[vv.Jenkins(on="x900", stiffness=5.0, limit=0.01)])
    >>> modal = bar.reduce(frequency=2.0, loads=["x300"]).in_modes()
    >>> run = vv.simulate(modal.structure, 10, load=modal.load({"x300": 0.1}), nu=1.0)
    >>> u = modal.displacements(run.state, ["x900"])
    >>> u.shape == (run.t.size, 1) and run.complete
    True
    """

    structure: Structure
    shapes: FloatArray
    names: tuple[str, ...]
    error: float
    #: M shapes, from displacements to amplitudes.
    _seen: FloatArray = field(repr=False)

    def _place(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def load(self, load: Any) -> npt.NDArray[Any]:
        """Return the modal forces of a load, shape (m,).

        Parameters
        ----------
        load : str, tuple, mapping or array_like
            A unit load as ``on`` of a `Spring`: a coordinate, two coordinates for a pair of
            opposite forces, a mapping {name: force}, or shape (n,); forces may be complex.

        Raises
        ------
        InputError
            If the coordinate does not exist or the shape is wrong.
        """
        n, places = len(self.names), self._place()
        if isinstance(load, Mapping):
            total = np.zeros(self.shapes.shape[1], dtype=complex)
            for name, force in load.items():
                if not isinstance(name, str):
                    raise InputError(f"load: {_native.shown(name)} must be a coordinate")
                one = _native.complex_array(f"load[{name!r}]", force)
                if one.ndim:
                    raise InputError(f"load[{name!r}] = {_native.shown(force)}: must be a number")
                total += one * (direction_of("load", name, n, places) @ self.shapes)
        elif isinstance(load, str) or (
            isinstance(load, (tuple, list)) and load and all(isinstance(x, str) for x in load)
        ):
            total = direction_of("load", load, n, places) @ self.shapes + 0j
        else:
            given = _native.complex_array("load", load)
            if given.shape != (n,):
                raise InputError(
                    f"load = {_native.shown(load)}: must be a coordinate, a mapping of them, or "
                    f"{n} numbers"
                )
            total = given @ self.shapes
        return total if total.imag.any() else np.ascontiguousarray(total.real)

    def displacements(
        self, state: npt.ArrayLike, coordinates: Sequence[str] | None = None
    ) -> FloatArray:
        """Return displacements of states of ``structure``, shape (..., n).

        Parameters
        ----------
        state : array_like, shape (..., 2 m)
            As `Trajectory.state`: modal coordinates and their rates alternately.
        coordinates : sequence of str, optional
            Selected coordinates; default: all.
        """
        return self._moved(state, 0, coordinates)

    def velocities(
        self, state: npt.ArrayLike, coordinates: Sequence[str] | None = None
    ) -> FloatArray:
        """Return velocities, as `displacements` does."""
        return self._moved(state, 1, coordinates)

    def _moved(
        self, state: npt.ArrayLike, first: int, coordinates: Sequence[str] | None
    ) -> FloatArray:
        given = _native.real_array("state", state)
        m = self.shapes.shape[1]
        if given.ndim < 1 or given.shape[-1] != 2 * m:
            raise InputError(f"state: must have {2 * m} columns, got shape {given.shape}")
        shapes = self.shapes
        if coordinates is not None:
            if isinstance(coordinates, str) or not isinstance(coordinates, Sequence):
                raise InputError(
                    f"coordinates = {_native.shown(coordinates)}: must be a list of names"
                )
            known = self._place()
            for name in coordinates:
                if not isinstance(name, str) or name not in known:
                    raise InputError(f"coordinates: {_native.shown(name)} is not a coordinate")
            shapes = shapes[[known[name] for name in coordinates]]
        return np.asarray(given[..., first::2] @ shapes.T)

    def start(
        self, displacements: npt.ArrayLike | None = None, velocities: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Return the state of ``structure`` nearest to displacements and velocities, shape (2 m,).

        Parameters
        ----------
        displacements, velocities : array_like, shape (n,), optional
            Default 0. Components outside the modes are lost.
        """
        state = np.zeros(2 * self.shapes.shape[1])
        for first, (name, given) in enumerate(
            (("displacements", displacements), ("velocities", velocities))
        ):
            if given is None:
                continue
            u = _native.real_array(name, given)
            if u.shape != (len(self.names),):
                raise InputError(f"{name}: must have shape ({len(self.names)},), got {u.shape}")
            state[first::2] = u @ self._seen
        return state


def modal_model(structure: Structure) -> ModalModel:
    """Create the equations of the modes; see `Structure.in_modes`."""
    reduced = structure._reduced
    if reduced is None:
        raise InputError("in_modes: the structure is not reduced: structure.reduce(...).in_modes()")
    found, model = reduced.reduction, reduced.model
    if found.static.shape[1]:
        raise InputError(
            "in_modes: elements or loads act on coordinates without mass, must have mass there"
        )
    if model.loss:
        raise InputError("in_modes: loss_factor has no meaning in time: use modal_damping")
    m, shapes = found.squares.size, found.shapes
    stiffness = np.diag(found.squares)
    damping, parts = damping_and_layers(model, found)
    for element in structure._all_elements:
        # The elements add their linear parts to the structure again.
        e = element.direction @ shapes
        stiffness = stiffness - element.powers.get(1, 0.0) * np.outer(e, e)
        damping = damping - element.damping * np.outer(e, e)
    n, places = structure.n_coordinates, {name: i for i, name in enumerate(structure.dof_names)}

    def seen(on: Any) -> FloatArray:
        return np.asarray(direction_of("on", on, n, places) @ shapes)

    elements = [
        replace(one, on={name: seen(on) for name, on in one.on.items()})
        if isinstance(one, Coupling)
        else replace(one, on=seen(one.on))
        for one in structure.elements
    ]
    own: Layers = structure._layers  # type: ignore[attr-defined]
    elements += [
        Spring(on=one.direction @ shapes, stiffness=one.powers[1], kernel=one.kernel)
        for one in own.elements
    ]
    layers = [
        (0.5 * (part + part.T), kernel)
        for part, (_, kernel) in zip(parts, model.layers, strict=True)
    ]
    for part, _ in layers:  # The structure adds the unrelaxed stiffness of its layers again.
        stiffness = stiffness - part
    turning: dict[str, Any] = {
        name: np.asarray(shapes.T @ (matrix @ shapes))
        for name in OF_SPEED
        if (matrix := getattr(structure, name)) is not None
    }
    if "gyroscopic" in turning:
        turning["gyroscopic"] = 0.5 * (turning["gyroscopic"] - turning["gyroscopic"].T)
    # Use the type: importing the module of `Structure` would be circular.
    small = type(structure)(
        mass=np.ones(m), stiffness=stiffness, damping=damping, elements=elements, layers=layers,
        names=[f"q{i + 1}" for i in range(m)], units=["sqrt(kg) m"] * m, **turning,
    )  # fmt: skip
    small.__dict__["_all_given"] = True
    return ModalModel(
        small, shapes, structure.dof_names, found.largest_error, np.asarray(model.mass @ shapes)
    )
