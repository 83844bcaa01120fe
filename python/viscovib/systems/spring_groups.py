"""Groups of springs: stiffness, forces as text or monomials, a kernel."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own, own_fields
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel, check_kernel
from viscovib.systems.laws import MAX_DEGREE, Law, Polynomial, read_law
from viscovib.systems.python_law import PythonLaw, callable_law, python_laws

#: Types of forces: a law (one coordinate), laws by equation, one law per coordinate, monomials.
Forces: TypeAlias = (
    "str | PythonLaw | Callable[..., Any] | Mapping[str, Any] | Sequence[Any] | None"
)


@dataclass(frozen=True, kw_only=True)
class Monomial:
    """A force term: coefficient * product of powers of coordinates.

    Parameters
    ----------
    coefficient : float
        Positive if the force opposes the motion, like a stiffness.
    powers : mapping of coordinate to power, or one power per coordinate
        {"x1": 2, "x2": 1} or (2, 1): u_1^2 u_2.
    on : str or int
        The equation of the force, by coordinate.

    Examples
    --------
    >>> import viscovib as vv
    >>> cubic = vv.Monomial(coefficient=0.5, powers=[3], on="x")
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=[cubic])
    """

    coefficient: float
    powers: Mapping[str, int] | Sequence[int]
    on: str | int = 0

    def __post_init__(self) -> None:
        own_fields(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class Springs:
    """Springs that share a kernel: linear stiffness and polynomial forces.

    Arguments are those of `PolynomialSystem`.

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> block = vv.PolynomialSystem(
    ...     mass=1, springs=[vv.Springs(stiffness=4, kernel=rubber)]
    ... )
    """

    stiffness: npt.ArrayLike | None = None
    forces: Forces = None
    kernel: Kernel | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        object.__setattr__(self, "forces", python_laws(self.forces))


class SpringGroup(NamedTuple):
    """Checked springs: K, f by equation and powers, and the kernel."""

    stiffness: FloatArray
    forces: dict[tuple[int, tuple[int, ...]], float]
    kernel: Kernel | None
    #: Laws that are not polynomials, without their linear parts, with the index of their equation.
    laws: tuple[tuple[int, Law], ...] = ()
    #: Linear stiffness of these laws; None: none.
    law_slopes: FloatArray | None = None
    #: Linear damping of these laws; None: none.
    law_damping: FloatArray | None = None
    #: The laws with their linear parts.
    whole: tuple[tuple[int, Law], ...] = ()
    #: Derivatives with respect to rates at rest, with a kernel; None: none.
    law_dampers: FloatArray | None = None
    #: K without the linear parts of forces; None: unknown.
    given: FloatArray | None = None

    def with_slopes_of(self, other: SpringGroup) -> SpringGroup:
        """Return the springs with the linear parts of the laws of ``other`` kept separate."""
        if self.law_slopes is None or other.law_slopes is None:
            return self
        remembers = self.kernel is not None
        laws = []
        for (on, law), (_, theirs) in zip(self.whole, other.whole, strict=True):
            apart = theirs.stiffness_at_rest, theirs.damping_at_rest(remembers=remembers)
            laws.append((on, law.without([*apart[0], *apart[1]])))
        stiffness = self.stiffness - self.law_slopes + other.law_slopes
        return self._replace(
            stiffness=stiffness, laws=tuple(laws), law_slopes=other.law_slopes,
            law_damping=other.law_damping,
        )  # fmt: skip


def is_definite(matrix: FloatArray) -> bool:
    """True if a symmetric matrix is positive definite, by the same test as in the core."""
    if not np.all(np.diag(matrix) > 0):
        return False
    try:
        pivots = np.diag(np.linalg.cholesky(matrix)) ** 2
    except np.linalg.LinAlgError:
        return False
    return bool(np.all(pivots > 1e-10 * np.diag(matrix)))


def square_matrix(name: str, value: npt.ArrayLike | None, n: int | None) -> FloatArray:
    """Return a number, a diagonal or a matrix as a read-only matrix."""
    if value is None:
        return np.asarray(own(np.zeros((n or 0, n or 0))))
    given = _native.real_array(name, value)
    matrix = np.diag(np.atleast_1d(given)) if given.ndim < 2 else given.copy()
    size = matrix.shape[0] if n is None else n
    if matrix.shape != (size, size):
        wanted = "a number, n numbers or (n, n)" if n is None else f"({n},) or ({n}, {n})"
        raise InputError(f"{name}: must have shape {wanted}, got {given.shape}")
    matrix.setflags(write=False)
    return np.asarray(matrix)


#: Characters that would end a line of a table, or that cannot be written to a file.
_NO_LETTER = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def texts_of(name: str, value: Any, n: int) -> tuple[str, ...]:
    """Check a sequence of texts, one for each coordinate."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"{name} = {_native.shown(value)}: must be a sequence of {n} texts")
    words = tuple(value) if len(value) == n else ()
    if len(words) != n or not all(isinstance(word, str) for word in words):
        raise InputError(f"{name} = {_native.shown(value)}: must be {n} texts, one per coordinate")
    for word in words:
        _native.letters(name, word)
        if _NO_LETTER.search(word):
            raise InputError(
                f"{name} = {_native.shown(word)}: must not contain control characters, ends of "
                "lines or halves of surrogate pairs"
            )
    return words


def spring_group(
    prefix: str, springs: Springs, names: tuple[str, ...], parameters: Mapping[str, float]
) -> SpringGroup:
    """Read springs: separate polynomials from other laws, move linear terms to the stiffness."""
    check_kernel(f"{prefix}kernel", springs.kernel)
    given = square_matrix(f"{prefix}stiffness", springs.stiffness, len(names))
    stiffness = given.copy()
    forces: dict[tuple[int, tuple[int, ...]], float] = {}
    laws, whole = [], []
    slopes, damping, dampers = (np.zeros_like(stiffness) for _ in range(3))

    def read(place: str, text: Any, rates: list[str]) -> Polynomial | Law:
        return read_law(place, text, names, parameters, rates, preloaded=True)

    for where, on, polynomial in by_equation(f"{prefix}forces", springs.forces, names, read):
        if isinstance(polynomial, Law):
            remembers = springs.kernel is not None
            slopes[on] += polynomial.stiffness_at_rest
            damping[on] += polynomial.damping_at_rest(remembers=remembers)
            if remembers:
                dampers[on] += polynomial.damping_at_rest()
            laws.append((on, polynomial.remainder(remembers=remembers)))
            whole.append((on, polynomial))
            continue
        for powers, c in polynomial.items():
            degree = sum(powers)
            if degree == 0:
                raise InputError(f"{where}: has the constant {c:g}, which belongs to the load")
            if degree == 1:
                stiffness[on, powers.index(1)] += c
            elif c != 0:
                forces[on, powers] = forces.get((on, powers), 0.0) + c
    stiffness += slopes
    stiffness.setflags(write=False)
    # A kernel without stiffness and forces is dropped.
    kernel = springs.kernel if forces or laws or stiffness.any() else None
    group = SpringGroup(stiffness, forces, kernel, given=given)
    if not laws:
        return group
    by_rates, behind = (one if one.any() else None for one in (damping, dampers))
    return group._replace(
        laws=tuple(laws), law_slopes=slopes, law_damping=by_rates, law_dampers=behind,
        whole=tuple(whole),
    )  # fmt: skip


def by_equation(
    where: str, forces: Any, names: tuple[str, ...], read: Callable[[str, Any, list[str]], Any]
) -> list[tuple[str, int, Any]]:
    """Polynomials or other laws, each with its name in errors and its equation.

    ``read`` converts a text, from its name in errors, the text and the names of rates.
    """
    if forces is None:
        return []
    if isinstance(forces, str) or callable_law(forces):
        if len(names) > 1:
            raise InputError(
                f"{where} = {_native.shown(forces)}: must name its equation, such as "
                f"{{{names[0]!r}: {forces!r}}}"
            )
        forces = {names[0]: forces}
    if (
        isinstance(forces, (list, tuple))
        and forces
        and (isinstance(forces[0], str) or callable_law(forces[0]))
    ):
        if len(forces) != len(names):
            raise InputError(
                f"{where}: {len(forces)} texts, must be {len(names)}, one per coordinate, or a "
                f"mapping such as {{{names[0]!r}: {forces[0]!r}}}"
            )
        forces = dict(zip(names, forces, strict=True))
    if isinstance(forces, Mapping):
        result: list[tuple[str, int, Any]] = []
        for key, text in forces.items():
            place = f"{where}[{key!r}]"
            if not isinstance(text, str) and not callable_law(text):
                raise InputError(
                    f"{place} = {_native.shown(text)}: must be a text such as '2*{names[0]}^3', or "
                    "a function"
                )
            rates = [f"{name}_dot" for name in names]
            result.append((place, _equation(place, key, names), read(place, text, rates)))
        return result
    if not isinstance(forces, Sequence):
        raise InputError(
            f"{where} = {_native.shown(forces)}: must be a text, a mapping or Monomials"
        )
    result = []
    for i, monomial in enumerate(forces):
        place = f"{where}[{i}]"
        if not isinstance(monomial, Monomial):
            raise InputError(
                f"{place} = {_native.shown(monomial)}: must be a Monomial; forces as text are one "
                f"text per coordinate, or a mapping"
            )
        c = _native.number(f"{place}.coefficient", monomial.coefficient)
        powers = _powers(f"{place}.powers", monomial.powers, names)
        result.append((place, _equation(f"{place}.on", monomial.on, names), {powers: c}))
    return result


def _equation(where: str, on: Any, names: tuple[str, ...]) -> int:
    if isinstance(on, str) and on in names:
        return names.index(on)
    if isinstance(on, (int, np.integer)) and not isinstance(on, bool) and 0 <= on < len(names):
        return int(on)
    listed = ", ".join(f"{name!r} ({i})" for i, name in enumerate(names))
    raise InputError(f"{where}: equation {on!r} must be one of {listed}")


def _powers(where: str, powers: Any, names: tuple[str, ...]) -> tuple[int, ...]:
    if isinstance(powers, Mapping):
        unknown = [name for name in powers if name not in names]
        if unknown:
            raise InputError(f"{where}: unknown coordinate {unknown[0]!r}, must be one of {names}")
        powers = [powers.get(name, 0) for name in names]
    if isinstance(powers, str) or not isinstance(powers, (Sequence, np.ndarray)):
        raise InputError(
            f"{where} = {_native.shown(powers)}: must be one power per coordinate, or a mapping"
        )
    if len(powers) != len(names):
        raise InputError(f"{where}: has {len(powers)} powers, must be {len(names)}")
    result = tuple(_native.integer(where, p, 0, MAX_DEGREE) for p in powers)
    if sum(result) > MAX_DEGREE:
        raise InputError(f"{where}: degree {sum(result)}, must be at most {MAX_DEGREE}")
    return result
