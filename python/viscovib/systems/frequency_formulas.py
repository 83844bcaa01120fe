"""Complex amplitudes of loads as formulas in the frequency nu, in real formulas of the core."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.laws import Law, compile_law

#: The formula of constants; powers of complex numbers are multiplied out up to this one.
ONE, _MOST_TIMES = "1", 20
#: Greatest length of a formula; most formulas in a load.
_MAX_LENGTH, MOST_FORMULAS = 10_000, 2000
_NU = re.compile(r"(?<![\w.])nu(?!\w)")
#: Coefficients of real formulas, whose sum a text is.
Terms = dict[str, complex]


class KnownTerms(str):
    """A text whose terms are known, with the same numbers as in the core."""

    terms: Terms

    def __new__(cls, terms: Terms) -> KnownTerms:
        """Make the text."""
        made = super().__new__(cls, " + ".join(f"{z}*({one})" for one, z in terms.items()))
        made.terms = terms
        return made


def terms_of(where: str, text: str) -> Terms:
    """Return the coefficients of real formulas whose sum is the value of a text.

    ``where``: its name in errors.
    """
    if isinstance(text, KnownTerms):
        return text.terms
    if not _NU.search(text):
        raise InputError(
            f"{where} = {_native.shown(text)}: must be numbers, got text (a text must depend "
            "on nu, as '0.002*nu^2')"
        )
    if len(text) > _MAX_LENGTH:
        raise InputError(f"{where}: {len(text)} characters, must be at most {_MAX_LENGTH}")
    try:
        return dict(_terms_of_text(text))
    except InputError as error:
        raise InputError(f"{where}{error}") from None


@lru_cache(maxsize=256)
def _terms_of_text(text: str) -> Terms:
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval").body
        if not _is_complex(tree):
            # The core describes errors of the text as it was given.
            law_of(text)
        found = {formula: z for formula, z in _terms(tree).items() if z}
    except InputError:
        raise
    except (ArithmeticError, MemoryError, RecursionError, SyntaxError, ValueError) as error:
        if isinstance(error, SyntaxError):
            law_of(text)
        raise InputError(
            f" = {_native.shown(text)}: must be a formula in nu; complex numbers may be in "
            "+, -, *, /, whole powers and exp"
        ) from None
    for one in found:
        law_of(one)
    return found


@lru_cache(maxsize=256)
def law_of(formula: str) -> Law:
    """Compile a real formula in nu. The message of an error lacks the name of the load."""
    return compile_law("", formula, ["nu"], {})


def values_of(formulas: Sequence[str], nu: npt.ArrayLike) -> FloatArray:
    """Return the values of real formulas, shape (n_nu, n_formulas)."""
    at = np.atleast_1d(np.asarray(nu, dtype=float))
    found = _native.run("law of_frequency", text=joined(formulas), nu=at)
    return np.asarray(found["values"])


def joined(formulas: Sequence[str]) -> str:
    """Return formulas as a text of the core, one per line."""
    return "".join(f"{one}\n" for one in formulas)


def _is_complex(node: ast.AST) -> bool:
    return any(
        isinstance(one, ast.Constant) and isinstance(one.value, complex) for one in ast.walk(node)
    )


def _terms(node: ast.expr) -> Terms:
    """Return an expression as a sum of real formulas with coefficients."""
    match node:
        case ast.Constant(value=int() | float() | complex() as z) if not isinstance(z, bool):
            return {ONE: complex(z)}
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _scaled(_terms(operand), -1.0)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _terms(operand)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _sum(_terms(left), _terms(right))
        case ast.BinOp(left=left, op=ast.Sub(), right=right):
            return _sum(_terms(left), _scaled(_terms(right), -1.0))
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            x, y = _terms(left), _terms(right)
            if set(x) == {ONE} or set(y) == {ONE} or _is_complex(node):
                return _product(x, y)
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            x, y = _terms(left), _terms(right)
            if set(y) == {ONE}:
                return _scaled(x, 1 / y[ONE])
            divisor = ast.unparse(right)
            if _is_complex(right):
                conjugate = {formula: z.conjugate() for formula, z in y.items()}
                x, divisor = _product(x, conjugate), _real(_product(y, conjugate))
            if set(x) == {ONE} or _is_complex(node):
                return {f"{_factor(formula)}/({divisor})": z for formula, z in x.items()}
        case ast.BinOp(left=left, op=ast.Pow(), right=right) if _is_complex(node):
            return _power(_terms(left), _terms(right))
        case ast.Call(func=ast.Name(id="exp"), args=[z], keywords=[]) if _is_complex(node):
            exponent = _terms(z)
            size = _real({formula: z.real for formula, z in exponent.items()})
            angle = _real({formula: z.imag for formula, z in exponent.items()})
            return {f"exp({size})*cos({angle})": 1.0, f"exp({size})*sin({angle})": 1j}
    if _is_complex(node):
        raise ValueError
    return {ast.unparse(node).replace(" ** ", "^").replace("**", "^"): 1.0}


def _power(base: Terms, exponent: Terms) -> Terms:
    times = exponent.get(ONE, 0.0)
    if set(exponent) != {ONE} or times not in range(1, _MOST_TIMES + 1):
        raise ValueError
    found = base
    for _ in range(int(times.real) - 1):
        found = _product(found, base)
        if sum(map(len, found)) > _MAX_LENGTH:
            raise ValueError
    return found


def _scaled(x: Terms, factor: complex) -> Terms:
    return {formula: factor * z for formula, z in x.items()}


def _sum(x: Terms, y: Terms) -> Terms:
    return {formula: x.get(formula, 0.0) + y.get(formula, 0.0) for formula in {**x, **y}}


def _product(x: Terms, y: Terms) -> Terms:
    found: Terms = {}
    for one, a in x.items():
        for other, b in y.items():
            formula = f"{_factor(one)}*{_factor(other)}"
            if ONE in (one, other):
                formula = other if one == ONE else one
            found = _sum(found, {formula: a * b})
    return found


def _factor(formula: str) -> str:
    return formula if re.fullmatch(r"\w+", formula) else f"({formula})"


def _real(x: Terms) -> str:
    """Return the formula of a real sum."""
    terms = [f"({z.real!r})*{_factor(formula)}" for formula, z in x.items() if z.real]
    return " + ".join(terms) or "0"
