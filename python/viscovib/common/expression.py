"""Polynomials written as text: ``"0.5*(x1 - x2)^3"`` becomes monomials."""

import ast
import math
import re
from collections.abc import Sequence

from viscovib._native import shown
from viscovib.errors import InputError

#: Powers of every coordinate, and the coefficient.
Polynomial = dict[tuple[int, ...], float]

#: Highest degree in the core.
MAX_DEGREE = 15
_MAX_LENGTH = 20_000
_MAX_TERMS = 20_000
_MAX_PRODUCTS = 4_000_000
#: Forms that Python accepts and scenes do not: 0x10, 1_000, and a comment.
_OF_PYTHON = re.compile(r"(?<![A-Za-z_\d])\.?\d[\d.]*(?:[eE][+-]?\d+)?[_xXoObB]|#")


def expand(where: str, text: str, names: Sequence[str]) -> Polynomial:
    """Expand an expression of +, -, *, /, ^ (or **), parentheses, numbers and coordinates.

    ``where``: name of the expression in errors. Terms that cancel are dropped.
    """
    if len(text) > _MAX_LENGTH:
        raise InputError(f"{where}: {len(text)} characters, must be at most {_MAX_LENGTH}")
    if _OF_PYTHON.search(text):
        raise InputError(f"{where} = {_short(text)}: numbers must be decimal, as 16 or 1.5e3")
    try:
        # The most likely error is a product without its sign.
        tree = ast.parse(re.sub(r"\^", "**", re.sub(r"\s", " ", text).strip()), mode="eval")
        result = _Expander(where, tuple(names)).value(tree.body)
    except (RecursionError, MemoryError):
        raise InputError(
            f"{where} = {_short(text)}: has too many parentheses or factors nested in each other"
        ) from None
    except (SyntaxError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{where} = {_short(text)}: must be a polynomial such as 2*x^3 (every product with *)"
        ) from None
    for powers, coefficient in result.items():
        if not math.isfinite(coefficient):
            raise InputError(
                f"{where} = {_short(text)}: must have finite coefficients, that of "
                f"{spell(powers, names)} is not"
            )
    return result


def spell(powers: Sequence[int], names: Sequence[str]) -> str:
    """Write a monomial: ``x1^2*x2``."""
    factors = [
        name if p == 1 else f"{name}^{p}" for name, p in zip(names, powers, strict=True) if p
    ]
    return "*".join(factors) or "1"


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


class _Expander:
    def __init__(self, where: str, names: tuple[str, ...]) -> None:
        self.where, self.names = where, names
        self.one = (0,) * len(names)

    def value(self, node: ast.AST) -> Polynomial:
        match node:
            case ast.Constant(value=bool()):
                raise ValueError
            case ast.Constant(value=int() | float() as number):
                return _cleaned({self.one: float(number)})
            case ast.Name(id=name):
                return self._coordinate(name)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.value(operand)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return {powers: -c for powers, c in self.value(operand).items()}
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                return self._sum(node)
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return self._product(self.value(left), self.value(right))
            case ast.BinOp(left=left, op=ast.Div(), right=right):
                return self._quotient(self.value(left), self.value(right))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(self.value(left), self.value(right))
        raise ValueError

    def _coordinate(self, name: str) -> Polynomial:
        if name.removesuffix("_dot") in self.names and name not in self.names:
            raise InputError(
                f"{self.where}: {name} is a velocity, and forces depend on coordinates only; "
                "linear damping is the argument damping"
            )
        if name not in self.names:
            raise InputError(
                f"{self.where}: unknown coordinate {shown(name)}, must be one of "
                f"{', '.join(self.names)}"
            )
        place = self.names.index(name)
        return {tuple(int(d == place) for d in range(len(self.names))): 1.0}

    def _sum(self, node: ast.AST) -> Polynomial:
        """Sum of any number of terms, which are nested in the tree."""
        terms = []
        while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
            terms.append((node.right, 1.0 if isinstance(node.op, ast.Add) else -1.0))
            node = node.left
        total = self.value(node)
        for term, sign in reversed(terms):
            for powers, c in self.value(term).items():
                total[powers] = total.get(powers, 0.0) + sign * c
        return _cleaned(total)

    def _product(self, a: Polynomial, b: Polynomial) -> Polynomial:
        if len(a) * len(b) > _MAX_PRODUCTS:
            raise self._too_large()
        total: Polynomial = {}
        for p, c in a.items():
            for q, d in b.items():
                powers = tuple(i + j for i, j in zip(p, q, strict=True))
                if sum(powers) > MAX_DEGREE:
                    raise InputError(
                        f"{self.where}: degree of {spell(powers, self.names)} must be at most "
                        f"{MAX_DEGREE}"
                    )
                total[powers] = total.get(powers, 0.0) + c * d
            if len(total) > _MAX_TERMS:
                raise self._too_large()
        return _cleaned(total)

    def _quotient(self, a: Polynomial, b: Polynomial) -> Polynomial:
        if set(b) != {self.one}:
            raise InputError(f"{self.where}: may be divided only by numbers other than 0")
        return {powers: c / b[self.one] for powers, c in a.items()}

    def _power(self, base: Polynomial, exponent: Polynomial) -> Polynomial:
        n = exponent.get(self.one, 0.0)
        # 2^40 is a number like any other; a power of coordinates is limited by their degree.
        if set(exponent) - {self.one} or not 0 <= n <= 1000 or n != int(n):
            raise InputError(f"{self.where}: powers must be whole numbers, 0 to {MAX_DEGREE}")
        result: Polynomial = {self.one: 1.0}
        for _ in range(int(n)):
            result = self._product(result, base)
        return result

    def _too_large(self) -> InputError:
        return InputError(
            f"{self.where}: must expand to at most {_MAX_TERMS} monomials, this has more"
        )


def _cleaned(polynomial: Polynomial) -> Polynomial:
    return {powers: c for powers, c in polynomial.items() if c != 0.0}
