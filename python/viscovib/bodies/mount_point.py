"""A mount of a body in space: position, orientation, and properties of its three directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.mount_data import (
    Units,
    each_number,
    gap_text,
    is_table,
    law_text,
    loss_kernel,
)
from viscovib.common.parameters import Interval
from viscovib.common.values import own, own_fields
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel, kernel_call
from viscovib.systems.laws import Law, named_in, parameter_values, read_law, with_numbers

_BAND = Interval("loss_band", 0)
#: Largest deviation of axes from a rotation.
_ROTATION = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class FluidTrack:
    """The inertia track of a fluid mount: a column of fluid behind a rubber chamber.

    The chamber has the bulge stiffness K, and the fluid in the track has the mass M and the viscous
    damping C, all relative to the mount. They are in series with each other and parallel to the
    rubber:

        k*(nu) = k + i nu c + K Z/(K + Z),   Z = -nu^2 M + i nu C.

    The track is an additional coordinate y, M y'' + C y' + K (y - d) = 0, where d is the deflection
    of the mount along its axis. Its force on the mount is K (d - y).

    Parameters
    ----------
    mass : float
        M (kg), greater than 0.
    damping : float
        C (N s/m).
    stiffness : float
        K (N/m), greater than 0.
    axis : int
        Local axis of the mount: 0, 1 or 2.

    Examples
    --------
    >>> import viscovib as vv
    >>> track = vv.FluidTrack(mass=62.8, damping=2666, stiffness=436950)
    """

    mass: float
    damping: float
    stiffness: float
    axis: int = 2

    def __post_init__(self) -> None:
        for name in ("mass", "damping", "stiffness"):
            value = _native.number(name, getattr(self, name))
            if value < 0 or (value == 0 and name != "damping"):
                least = "not be negative" if name == "damping" else "be greater than 0"
                raise InputError(f"{name} = {value:g}: must {least}")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "axis", _native.integer("axis", self.axis, 0, 2))

    def dynamic_stiffness(self, nu: npt.ArrayLike) -> ComplexArray:
        """K Z/(K + Z) at circular frequencies nu (rad/s), any shape (N/m)."""
        # Far above the resonance of the track the fluid is at rest: the limit is its stiffness.
        frequencies = np.clip(_native.real_array("nu", nu), -1e100, 1e100)
        z = -(frequencies**2) * self.mass + 1j * frequencies * self.damping
        return np.asarray(self.stiffness * z / (self.stiffness + z))


@dataclass(frozen=True, kw_only=True, eq=False)
class MountPoint:
    """A mount between a body and the floor: three springs along its local axes.

    Along each local axis j the force is f_j = (1 - R_j*) [k_j d_j + g_j(d_j)] + c_j d_j', where d
    is the displacement of its point of the body relative to the floor.

    Parameters
    ----------
    name : str
        Letters, digits and _.
    position : array_like, shape (3,)
        Point of the body (m), in the axes of the body.
    stiffness : array_like, shape (3,)
        k_j along the local axes (N/m), not negative.
    angles : array_like, shape (3,), optional
        Orientation of the local axes relative to those of the body (rad): about x, then y, then z,
        R = Rz Ry Rx from local to body axes.
    axes : array_like, shape (3, 3), optional
        The orientation as a matrix, one column for each local axis, instead of ``angles``.
    damping : float or array_like, shape (3,), optional
        c_j (N s/m).
    kernel : Kernel or sequence of 3 Kernel or None, optional
        Memory of all three directions, or of each.
    law : str, function, table, or sequence of 3 of them or None, optional
        Nonlinear forces g_j(d): polynomials such as ``"1e10*d^3"``, whose linear term is added to
        k_j, or texts with functions and the rate v as for `Spring`, such as a snubber ``"1e6*max(d
        - 0.004, 0)"``. A Python function of d and v that consists of arithmetic and NumPy functions
        is used as its text. A measured table of deflections and forces, shape (n, 2), n <= 60, is
        interpolated linearly and continued beyond its ends; give it with ``stiffness`` 0 in this
        direction. A value at d = 0 is a preload: the static equilibrium balances all preloads and
        the weight.
    parameters : mapping of str to float, optional
        Numbers in the laws; along branches ``vary="mounts[left].k3"``.
    rotational_stiffness : array_like, shape (3,), optional
        About the local axes (N m/rad), for the rotation of the body, with the same memory.
    track : FluidTrack, optional
        The inertia track of a fluid mount.
    gap, gap_stiffness : float or sequence of 3 float or None, optional
        Stops on both sides: beyond the deflections gap and -gap (m) the additional force has the
        stiffness gap_stiffness (N/m). The stop is part of the law, so the kernel acts on it. With
        gravity the gap refers to the unloaded mount.
    loss_factor : float or sequence of 3 float or None, optional
        Structural damping k (1 + i eta) in the band ``loss_band``, instead of ``kernel``. A loss
        factor that is constant at all frequencies has no causal equivalent. Therefore a sum of
        exponentials is fitted: in the band its loss factor is within 1 % of eta, and at the centre
        sqrt(low high) the stiffness is k_j. Below and above, the stiffness changes with the
        frequency as causality requires (Kramers and Kronig), 2 eta/pi per e-fold. The same kernel
        acts in the frequency domain and in time.
    loss_band : (float, float), optional
        Ends of the band (rad/s).
    units : str, optional
        Units of the numbers above: "N, mm" or "kN, mm", for example, instead of "N, m": stiffnesses
        in N/mm, lengths and the variable d of the laws in mm. Angles are in rad. The attributes
        have SI units.

    Examples
    --------
    >>> import viscovib as vv
    >>> from viscovib.units import degree, mm, newton_per_mm
    >>> left = vv.MountPoint(
    ...     name="left",
    ...     position=[p * mm for p in (-66.4, 463.1, 156.1)],
    ...     stiffness=[k * newton_per_mm for k in (350, 370, 453)],
    ...     angles=(0, 0, 90 * degree),
    ...     law=(None, None, "1e10*d^3"),
    ... )
    """

    name: str
    position: npt.ArrayLike
    stiffness: npt.ArrayLike
    angles: npt.ArrayLike = (0.0, 0.0, 0.0)
    axes: npt.ArrayLike | None = None
    damping: npt.ArrayLike = 0.0
    kernel: Kernel | Sequence[Kernel | None] | None = None
    law: Any = None
    parameters: Mapping[str, float] | None = None
    rotational_stiffness: npt.ArrayLike = (0.0, 0.0, 0.0)
    track: FluidTrack | None = None
    gap: float | Sequence[float | None] | None = None
    gap_stiffness: float | Sequence[float | None] | None = None
    loss_factor: float | Sequence[float | None] | None = None
    loss_band: tuple[float, float] | None = None
    units: str | None = None

    #: Local axes in body axes, one column each, shape (3, 3).
    rotation: FloatArray = field(init=False, repr=False)
    #: Kernel of each local direction.
    kernels: tuple[Kernel | None, ...] = field(init=False, repr=False)
    #: k_j and the linear terms of laws, shape (3,).
    _elastic: FloatArray = field(init=False, repr=False)
    #: For each local direction: coefficients of d^2, d^3, ... by power, or a compiled law.
    laws: tuple[dict[int, float] | Law, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        own_fields(self)
        fits = isinstance(self.name, str) and self.name.isascii() and self.name.isidentifier()
        if not fits or len(self.name) > 14:
            raise InputError(
                f"name = {_native.shown(self.name)}: must be letters, digits and _, not begin with "
                "a digit, and have at most 14 characters"
            )
        values = parameter_values(self.parameters, ("d", "v"))
        self._convert(values)
        self._set("position", self._vector("position", self.position))
        self._set("rotation", own(self._rotation()))
        stiffness = self._vector("stiffness", self.stiffness, positive=True)
        self._set("stiffness", stiffness)
        damping = _native.real_array("damping", self.damping)
        if damping.ndim == 0:
            damping = np.full(3, float(damping))
        self._set("damping", self._vector("damping", damping, positive=True))
        turning = self._vector("rotational_stiffness", self.rotational_stiffness, positive=True)
        self._set("rotational_stiffness", turning)
        kernels, shares = self._losses()
        self._set("kernels", kernels)
        laws: list[dict[int, float] | Law] = []
        elastic = stiffness / shares
        for j, text in enumerate(self._with_stops(self._each("law", self.law, str))):
            if text is not None and shares[j] != 1:
                text = f"{float(1 / shares[j])!r}*({text})"
            law, linear = self._law(j, text, values)
            elastic[j] += linear
            laws.append(law)
        self._set("laws", tuple(laws))
        self._set("_elastic", own(elastic))
        if self.track is not None:
            _native.check_instance(f"{self.name}: track", self.track, FluidTrack)
        if not (elastic.any() or any(laws) or turning.any() or self.track):
            raise InputError(f"{self.name}: stiffness = 0 0 0: must not be 0 in every direction")

    def _convert(self, values: dict[str, float]) -> None:
        """Convert all numbers to SI units, and laws to texts."""
        given = None if self.units is None else Units.read(self.name, self.units)
        laws = self.law
        if isinstance(laws, (list, tuple)) and len(laws) == 3 and not is_table(laws):
            laws = tuple(
                law_text(f"{self.name}: law[{j}]", law, values, given) for j, law in enumerate(laws)
            )
        else:
            laws = law_text(f"{self.name}: law", laws, values, given)
        self._set("law", laws)
        if given is None:
            return
        stiffness = given.force / given.length
        for name, factor in (
            ("position", given.length), ("stiffness", stiffness), ("damping", stiffness),
            ("rotational_stiffness", given.force * given.length),
        ):  # fmt: skip
            array = _native.real_array(f"{self.name}: {name}", getattr(self, name))
            self._set(name, array * factor)
        for name, factor in (("gap", given.length), ("gap_stiffness", stiffness)):
            each = each_number(f"{self.name}: {name}", getattr(self, name))
            self._set(name, tuple(None if one is None else one * factor for one in each))
        self._set("units", None)

    def _losses(self) -> tuple[tuple[Kernel | None, ...], FloatArray]:
        """Kernels, and the remaining fractions of the stiffness at the centre of the band."""
        kernels = self._each("kernel", self.kernel, Kernel)
        factors = each_number(f"{self.name}: loss_factor", self.loss_factor)
        shares = np.ones(3)
        if not any(factors):
            return kernels, shares
        if self.loss_band is None:
            raise InputError(
                f"{self.name}: loss_factor: needs loss_band=(low, high) (rad/s), since a loss "
                "factor constant at all frequencies has no causal equivalent; or give kernel= or "
                "damping="
            )
        band = _BAND.check(self.loss_band)
        found = list(kernels)
        for j, factor in enumerate(factors):
            if not factor:
                continue
            if factor < 0 or kernels[j] is not None:
                raise InputError(
                    f"{self.name}: loss_factor = {factor:g}: must not be negative, and not be "
                    "given with a kernel"
                )
            found[j], shares[j] = loss_kernel(self.name, factor, band)
        return tuple(found), shares

    def _with_stops(self, laws: tuple[Any, ...]) -> list[str | None]:
        """Laws with the forces of the stops."""
        gaps = each_number(f"{self.name}: gap", self.gap)
        stiff = each_number(f"{self.name}: gap_stiffness", self.gap_stiffness)
        found: list[str | None] = []
        for law, gap, k in zip(laws, gaps, stiff, strict=True):
            if gap is not None and k is None:
                raise InputError(f"{self.name}: gap = {gap:g}: needs gap_stiffness (N/m)")
            if gap is None or k is None:
                found.append(law)
                continue
            stop = gap_text(self.name, gap, k)
            found.append(stop if law is None else f"{law} + {stop}")
        return found

    def _law(
        self, j: int, text: str | None, values: dict[str, float]
    ) -> tuple[dict[int, float] | Law, float]:
        """A law without its linear term (if it is a polynomial), and this term."""
        if text is None:
            return {}, 0.0
        where = f"{self.name}: law[{j}]"
        terms = read_law(where, text, ("d",), values, ("v",), preloaded=True)
        if isinstance(terms, Law):
            # The text is read again about other positions and in other coordinates.
            return replace(terms, text=with_numbers(text, values)), 0.0
        return {p: c for (p,), c in terms.items() if p > 1}, terms.get((1,), 0.0)

    @property
    def _named_parameters(self) -> tuple[str, ...]:
        """The parameters that occur in the laws."""
        return named_in(self.parameters or (), self.law)

    def dynamic_stiffness(self, nu: npt.ArrayLike) -> ComplexArray:
        """Linear stiffness along the local axes, shape nu.shape + (3,) (N/m).

        (1 - R_j(nu)) k_j + i nu c_j, including the track of a fluid mount; ``nu`` in rad/s.
        """
        frequencies = _native.real_array("nu", nu)
        total = np.empty((*frequencies.shape, 3), dtype=complex)
        for j, kernel in enumerate(self.kernels):
            kept = 1.0 if kernel is None else 1 - np.asarray(kernel.transform(frequencies))
            total[..., j] = kept * self._tangents[j]
            total[..., j] += 1j * frequencies * np.asarray(self.damping)[j]
        if self.track is not None:
            total[..., self.track.axis] += self.track.dynamic_stiffness(frequencies)
        return total

    @property
    def static_stiffness(self) -> FloatArray:
        """Linear stiffness along the local axes after complete relaxation, shape (3,) (N/m)."""
        relaxed_parts = [0.0 if kernel is None else kernel.integral for kernel in self.kernels]
        kept = 1 - np.array(relaxed_parts)
        return np.asarray(kept * self._tangents)

    @property
    def _tangents(self) -> FloatArray:
        """Stiffness at rest along the local axes, including laws with functions."""
        slopes = [
            float(law.slopes_at_rest[0]) if isinstance(law, Law) else 0.0 for law in self.laws
        ]
        return np.asarray(self._elastic + np.array(slopes))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _vector(self, name: str, value: Any, *, positive: bool = False) -> FloatArray:
        vector = _native.real_array(f"{self.name}: {name}", value)
        if vector.shape != (3,):
            raise InputError(f"{self.name}: {name}: must have shape (3,), got {vector.shape}")
        if positive and (vector < 0).any():
            raise InputError(f"{self.name}: {name} = {vector.min():g}: must not be negative")
        return np.asarray(own(vector))

    def _rotation(self) -> FloatArray:
        angles = self._vector("angles", self.angles)
        if self.axes is None:
            return rotation_of(angles)
        if angles.any():
            raise InputError(
                f"{self.name}: angles, axes: define the orientation twice, give only one of them"
            )
        axes = _native.real_array(f"{self.name}: axes", self.axes).copy()
        if axes.shape != (3, 3):
            raise InputError(f"{self.name}: axes: must have shape (3, 3), got {axes.shape}")
        off = np.abs(axes.T @ axes - np.eye(3)).max()
        if off > _ROTATION or np.linalg.det(axes) < 0:
            what = f"axes^T axes is off the unit matrix by {off:.3g}"
            if off <= _ROTATION:
                what = "they are left-handed, reverse one of them"
            raise InputError(
                f"{self.name}: axes: must be a rotation (columns of unit length, at right angles, "
                f"right-handed); {what}"
            )
        return np.asarray(axes)

    def _each(self, name: str, value: Any, kind: type) -> tuple[Any, ...]:
        """Return one value per direction; a single value applies to all directions."""
        if value is None or isinstance(value, kind):
            return (value,) * 3
        allowed = f"a {kind.__name__}, None or three of them"
        if not isinstance(value, (list, tuple)) or len(value) != 3:
            allowed += kernel_call(value)
            raise InputError(f"{self.name}: {name} = {_native.shown(value)}: must be {allowed}")
        for one in value:
            if not (one is None or isinstance(one, kind)):
                raise InputError(f"{self.name}: {name} = {_native.shown(one)}: must be {allowed}")
        return tuple(value)


def rotation_of(angles: FloatArray) -> FloatArray:
    """Return Rz Ry Rx of angles about x, y and z (rad), shape (3, 3)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def crossing(p: npt.ArrayLike) -> FloatArray:
    """Return the matrix [p] of the vector product, [p] v = p x v."""
    x, y, z = np.asarray(p, dtype=float)
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
