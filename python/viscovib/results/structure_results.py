"""Responses and branches of structures. Coordinates are computed on request."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.branch import Branch
from viscovib.results.dissipation import dissipated, forces_of_elements
from viscovib.results.response import MAX_SEARCH, Response, find_peak
from viscovib.results.structure_view import View
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.polynomial_system import PolynomialSystem


class _OfStructure:
    """Common code of motions of a structure: condensed coordinates, shown in selected ones."""

    _condensed: ComplexArray
    _view: View | None
    #: Fields that are stored in condensed form, with the names of these.
    _held: ClassVar[dict[str, str]]

    def __post_init__(self) -> None:
        for name in self._held:
            self.__dict__.pop(name, None)

    @cached_property
    def deflections(self) -> ComplexArray:
        """Harmonics of the condensed coordinates, relative to the base, shape (n, q, m)."""
        return self._condensed.copy()

    @cached_property
    def reduction_error(self) -> FloatArray:
        """Estimated relative error of each motion by a reduction, shape (n,).

        It is computed from residuals of the full equations. Harmonics above the highest frequency
        of the reduction count as errors. 0 for a structure that is not reduced.
        """
        return _left_out(self)

    def check(self, points: int = 5) -> FloatArray:
        """Errors of some motions against the full equations, solved directly, shape (points,).

        Each harmonic of the forces on the linear subsystem (loads, elements, inertia of the base)
        is applied to the full matrices, with a separate factorization. The error is |u - found|/|u|
        in the largest coordinate for all harmonics together. The motions are evenly spaced.
        """
        return _checked(self, points)

    def support_reactions(self) -> ComplexArray:
        """Return the forces that hold or move the supports, shape (n, n_supports, m).

        R = M_s u'' + C_s u' + K_s u + forces of elements, in the order of `Structure.supports`, as
        coefficients of Im sum_k R_k exp(i k nu t). Modal damping, Rayleigh damping and the loss
        factor do not act on supports. Laws with kinks use 16384 samples.

        Raises
        ------
        InputError
            For a structure without supports; if a `Coupling` or a layer with memory acts on them.

        Examples
        --------
        >>> import viscovib as vv
        >>> pair = vv.Structure(
        ...     mass=[1.0, 0.0], stiffness=[[4.0, -4.0], [-4.0, 4.0]], damping=[[0.1, -0.1],
        ...     [-0.1, 0.1]], supports=["x2"], base_direction=[1.0],
        ... )
        >>> r = vv.forced_response(pair, [1.0], base=0.01)
        >>> inertia = -r.coefficients[0, 0, 0]
        >>> bool(abs(r.support_reactions()[0, 0, 0] - inertia) < 1e-15)
        True
        """
        view = _known(self._view)
        if view.held is None:
            raise InputError("support_reactions: this system has no supports")
        nu, orders, factors = self.nu, self.harmonics, self._factors  # type: ignore[attr-defined]
        weights, (mass, damping, stiffness) = view.held.rows("support_reactions")
        linear = getattr(self, "method", "") == "linear"
        forces = forces_of_elements(
            view, nu, orders, self._condensed, factors, view.held.touched, linear=linear
        )
        u = np.zeros((nu.size, stiffness.shape[1], orders.size), dtype=complex)
        u[:, view.held.free] = self._whole()
        if view.held.motion is not None:
            for order, moved in zip(view.loaded.orders, view.loaded.base, strict=True):
                at = np.multiply.outer(factors * moved, view.held.motion[view.held.held])
                u[:, view.held.held] += np.multiply.outer(at, orders == order)
        for order, each in view.loaded.apart.items():
            u[:, view.held.held] += np.multiply.outer(np.outer(factors, each), orders == order)
        s = 1j * np.multiply.outer(nu, orders)[:, np.newaxis]
        found = [one @ u for one in (mass, damping, stiffness)]
        return np.asarray(
            (s * found[0] + found[1]) * s + found[2] + np.einsum("es,nem->nsm", weights, forces)
        )

    @property
    def _solved(self) -> ComplexArray:
        return self._condensed

    def _energy_loss(self) -> FloatArray:
        """Energy loss of each motion per period (J), shape (n,)."""
        return self.dissipation().sum(axis=1)  # type: ignore[attr-defined,no-any-return]

    @property
    def _factors(self) -> FloatArray:
        """Factor of the load of each motion."""
        return np.ones(len(self._condensed))

    def _warn_of_reduction(self) -> None:
        _warn_of_reduction(self)

    def _relative(self, _: FloatArray) -> ComplexArray:
        """Motions relative to the base, of the coordinates that the core computes."""
        return self._condensed

    def _whole(self) -> ComplexArray:
        """X_k of all coordinates."""
        view = _known(self._view)
        all_of_them = view.at(view.all_names)
        nu, orders = self.nu, self.harmonics  # type: ignore[attr-defined]
        return all_of_them.expand(nu, orders, self._condensed, self._factors)

    def at(self, coordinates: Sequence[str]) -> Self:
        """Return the motions in selected coordinates of the structure."""
        view = _known(self._view).at(coordinates)
        given = {**self.__dict__, "_view": view}
        given |= {name: self.__dict__[of] for name, of in self._held.items()}
        given |= {"dof_names": view.names, "dof_units": view.units}
        found: Self = _again(self, given)
        return found


@dataclass(frozen=True, eq=False, repr=False)
class StructureResponse(_OfStructure, Response):
    """A `Response` of a structure; ``coefficients`` are computed at first use."""

    #: Harmonics of the condensed coordinates, relative to the base, shape (n, q, m).
    _condensed: ComplexArray = field(default_factory=lambda: np.empty(0, complex), repr=False)
    _view: View | None = field(default=None, repr=False)

    _held: ClassVar = {"coefficients": "_condensed"}

    @cached_property  # type: ignore[misc]
    def coefficients(self) -> ComplexArray:
        """X_k of the selected coordinates."""
        view = _known(self._view)
        return view.expand(self.nu, self.harmonics, self._condensed)

    def dissipation(self) -> FloatArray:
        """Return the energy loss in each element per period (J), shape (n, n_elements).

        The order is that of `Structure.elements`. The loss is that of dashpot, law, memory and
        sliders, pi sum_k k Im(F_k conj(D_k)) with the harmonics of force and relative deflection. A
        `Jenkins` element loses 4 F_s (a - F_s/k) at an amplitude a above F_s/k. The loss by the
        damping of the structure and by memory in its matrices is not included. For a
        `PolynomialSystem` see `Response`. The result is exact for the harmonics kept. Laws with
        kinks or jumps use 16384 samples and are accurate to about 1e-6. NaN where no motion was
        found.

        Examples
        --------
        >>> import viscovib as vv
        >>> slider = vv.Jenkins(on="x1", stiffness=20, limit=0.3)
        >>> joint = vv.Structure(
        ...     mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]], elements=[slider]
        ... )
        >>> r = vv.forced_response(joint, [1.0], load=[0.8], method="newton", harmonics=31,
        ...                        tolerance=0.01)
        >>> amplitude = r.peak_to_peak("x1")[0] / 2
        >>> bool(abs(r.dissipation()[0, 0] - 4 * 0.3 * (amplitude - 0.3 / 20)) < 1e-12)
        True
        """
        if self._parts is not None and isinstance(self._parts.system, PolynomialSystem):
            return super().dissipation()
        ones = np.ones(self.nu.size)
        linear = self.method == "linear"
        return dissipated(
            _known(self._view), self.nu, self.harmonics, self._condensed, ones, linear=linear
        )

    def _linear_component(self, d: int, j: int, nu: FloatArray) -> ComplexArray:
        view = _known(self._view)
        own = self._linear_motions(nu) - view.loaded.base_motion(self.harmonics)
        return view.at([view.names[d]]).expand(nu, self.harmonics, own)[:, 0, j]

    def _summit(self, places: Any, d: int, j: int) -> tuple[float, float] | None:
        kept = np.flatnonzero(self.harmonics <= int(self.highest[places].max()))
        if self.method == "linear":
            return super()._summit(places, d, j)
        if j >= kept.size:
            return None
        watched, motions, row = _watched(self, d, places, kept)
        return find_peak(
            watched.steady, self.harmonics[kept], self.nu[places], motions, (row, j),
            self._tolerance, at_nu=self.nu[places[0]], keep_idle=False,
        )  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class StructureBranch(_OfStructure, Branch):
    """A `Branch` of a structure; ``coefficients`` are computed at first use."""

    _condensed: ComplexArray = field(default_factory=lambda: np.empty(0, complex), repr=False)
    _condensed_folds: ComplexArray = field(default_factory=lambda: np.empty(0, complex), repr=False)
    _view: View | None = field(default=None, repr=False)

    _held: ClassVar = {"coefficients": "_condensed", "fold_coefficients": "_condensed_folds"}

    @property
    def _factors(self) -> FloatArray:
        return self.load_factor

    @cached_property  # type: ignore[misc]
    def coefficients(self) -> ComplexArray:  # type: ignore[override]
        """X_k of the selected coordinates."""
        view = _known(self._view)
        return view.expand(self.nu, self.harmonics, self._condensed, self.load_factor)

    @cached_property  # type: ignore[misc]
    def fold_coefficients(self) -> ComplexArray:  # type: ignore[override]
        """X_k at the folds."""
        by_nu = self.varies == "nu"
        same = np.ones(self.folds.size)
        nu = self.folds if by_nu else self.nu[0] * same
        factors = same if by_nu else self.folds
        return _known(self._view).expand(nu, self.harmonics, self._condensed_folds, factors)

    def dissipation(self) -> FloatArray:
        """Energy loss as in `StructureResponse`; for branches over the frequency or the load."""
        if self._parts is not None and isinstance(self._parts.system, PolynomialSystem):
            return super().dissipation()
        self._check_loses()
        return dissipated(
            _known(self._view), self.nu, self.harmonics, self._condensed, self.load_factor
        )

    def _summit(
        self, i: int, d: int, j: int, low: float, high: float
    ) -> tuple[float, float] | None:
        kept = np.flatnonzero(self.harmonics <= self.highest[i])
        if j >= kept.size:
            return None
        places = np.array([i])
        factor = float(self.load_factor[i])
        watched, motions, row = _watched(self, d, places, kept, factor)
        job = self._job
        if self.varies in ("nu", "load_factor"):
            job = watched.steady.along(varies=self.varies, at_nu=job.given["at_nu"])
        elif watched is not _known(self._view).loaded:
            # The varied parameter is defined for the deflections only.
            return None
        return find_peak(
            job, self.harmonics[kept], self.parameter[places], motions, (row, j), self._tolerance,
            keep_idle=True, low=float(low), high=float(high),
        )  # fmt: skip

    def _summit_between(self, places: Any, d: int, j: int) -> tuple[float, float] | None:
        kept = np.flatnonzero(self.harmonics <= self.highest[places].max())
        if j >= kept.size or self.varies != "nu":
            return None
        watched, motions, row = _watched(self, d, places, kept, float(self.load_factor[0]))
        if places.size * motions[0].size ** 3 * 8 > MAX_SEARCH:
            return None
        along = self.parameter[places]
        job = watched.steady.along(varies=self.varies, at_nu=self._job.given["at_nu"])
        return find_peak(
            job, self.harmonics[kept], along, motions, (row, j), self._tolerance, keep_idle=True,
            low=along[0], high=along[-1],
        )  # fmt: skip


def _checked(result: Any, points: int) -> FloatArray:
    from viscovib.systems.reduced import direct_motion

    view = _known(result._view)
    loaded = view.loaded
    if loaded.condensation.reduced is None:
        raise InputError(
            "check: this structure is not reduced, so its motions are those of the full structure"
        )
    solved = np.flatnonzero(np.isfinite(result._condensed).all(axis=(1, 2)))
    count = _native.integer("points", points, 1, max(solved.size, 1))
    taken = solved[np.unique(np.linspace(0, solved.size - 1, count).round().astype(int))]
    load = result._factors
    everywhere = np.arange(loaded.forces.shape[0])
    errors = np.zeros(taken.size)
    for place, i in enumerate(taken):
        at = slice(i, i + 1)
        given = result.nu[at], result.harmonics, result._condensed[at]
        found = loaded.expand(*given, everywhere, load[at])[0]
        exact = direct_motion(loaded, *given, load[at])
        errors[place] = np.abs(found - exact).max() / np.abs(exact).max()
    return errors


def _left_out(result: Any) -> FloatArray:
    reduced = _known(result._view).loaded.condensation.reduced
    if reduced is None:
        return np.zeros(result.nu.size)
    return np.asarray(reduced.left_out(result.nu, result.harmonics, result._condensed))


def _warn_of_reduction(result: Any) -> None:
    """Warn of motions with a reduction error above the tolerance."""
    reduced = _known(result._view).loaded.condensation.reduced
    if reduced is None:
        return
    errors = np.nan_to_num(result.reduction_error)
    beyond = errors > 10 * reduced.tolerance
    if beyond.any():
        worst = int(errors.argmax())
        warnings.warn(
            f"{beyond.sum()} of {errors.size} motions have harmonics above {reduced.top:.6g} "
            "rad/s, for which the structure was not reduced; worst at nu = "
            f"{result.nu[worst]:.6g}, with an estimated relative error of {errors[worst]:.1e}",
            ConvergenceWarning,
            stacklevel=caller(),
        )


def _known(view: View | None) -> View:
    if view is None:
        raise InputError("this result does not contain its structure")
    return view


def _again(result: Any, given: dict[str, Any]) -> Any:
    names = result.__dataclass_fields__
    return type(result)(**{name: given[name] for name in names if name in given})


def _watched(
    result: StructureResponse | StructureBranch, d: int, places: Any, kept: Any, factor: float = 1.0
) -> tuple[LoadedStructure, ComplexArray, int]:
    """A structure with coordinate d added to the condensed ones, and motions in these."""
    view = _known(result._view)
    watched, row = view.loaded.watching(int(view.places[d]))
    moved = factor * view.loaded.base_motion(result.harmonics[kept])
    own = result._condensed[places][:, :, kept] + moved
    # The coordinate is new or replaces one.
    after = slice(row + 1 if row < own.shape[1] else row, None)
    this = result.coefficients[places][:, d : d + 1, kept]
    own = np.concatenate([own[:, :row], this, own[:, after]], axis=1)
    return watched, own, row
