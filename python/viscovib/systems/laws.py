"""Force laws written as text that are no polynomials, as programs of the core."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray, core
from viscovib.common.expression import Polynomial, expand
from viscovib.errors import InputError

_FIELD, _MAX_CODE, _MAX_LENGTH = 64, 2000, 20_000
#: Instructions of the core.
_NUMBER, _ARGUMENT, _SUBTRACT, _MULTIPLY = 1, 2, 4, 5
_ODD = -1
#: What the core gives outside a domain, and how near to rest a law must have a value.
_WALL, _NEAR = 1e60, 1e-9


@dataclass(frozen=True, eq=False)
class Law:
    """f(arguments) as a program: code and number of each instruction.

    Functions may be sin, cos, tan, asin, acos, atan, atan2, sinh, cosh, tanh, asinh, acosh, atanh,
    exp, log, sqrt, abs, sign, heaviside, pow, min, max, where and comparisons. The derivatives are
    exact (forward differentiation by the same program). At a kink, such as that of abs or max, the
    mean of both sides is taken.
    """

    text: str
    arguments: tuple[str, ...]
    code: tuple[int, ...]
    number: tuple[float, ...]
    #: 1: even, -1: odd, 0: neither is known.
    parity: int

    def __call__(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values, shape (n,), and derivatives, shape (n, n_arguments), at (n, n_arguments)."""
        code = np.array(self.code, dtype=np.intc)
        number = np.array(self.number)
        value, slopes = core.law_values(code, number, np.asfortranarray(at))
        return np.asarray(value), np.asarray(slopes)

    @cached_property
    def slopes_at_rest(self) -> FloatArray:
        """Derivatives where all arguments are 0, shape (n_arguments,)."""
        return np.asarray(self(np.zeros((1, len(self.arguments))))[1][0])

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Which arguments it reads at all."""
        pairs = zip(self.code, self.number, strict=True)
        return tuple(sorted({int(x) - 1 for code, x in pairs if code == _ARGUMENT}))

    @cached_property
    def remainder(self) -> Law:
        """What is left of the law without its linear part at rest."""
        code, number = list(self.code), list(self.number)
        for place, slope in enumerate(self.slopes_at_rest, start=1):
            if slope != 0:
                code += [_ARGUMENT, _NUMBER, _MULTIPLY, _SUBTRACT]
                number += [place, float(slope), 0.0, 0.0]
        # An even law has no slope at rest, unless it has a kink there.
        parity = self.parity if self.parity == _ODD or len(code) == len(self.code) else 0
        return Law(self.text, self.arguments, tuple(code), tuple(number), parity)

    def with_argument(self, name: str, text: str) -> str:
        """Return its text with another expression in place of an argument."""
        return re.sub(rf"\b{name}\b", f"({text})", self.text)

    def about(self, name: str, at: float) -> Law:
        """Return f(at + d) - f(at), of one argument."""
        rest = float(self(np.array([[at]]))[0][0])
        text = f"({self.with_argument(name, f'{name} + ({at!r})')}) - ({rest!r})"
        return compile_law("law", text, self.arguments, {})

    def numbers(self, reads: FloatArray, targets: Mapping[int, float], kernel: int) -> list[float]:
        """Return it as the core takes it.

        ``reads`` maps coordinates to arguments, shape (n_arguments, n); ``targets``: weights of
        the equations in which it stands; ``kernel``: behind which, from 1 (0: none).
        """
        used = self.places or (0,)
        place = {old + 1: new for new, old in enumerate(used, start=1)}
        steps = [
            x
            for code, number in zip(self.code, self.number, strict=True)
            for x in (code, place[int(number)] if code == _ARGUMENT else number)
        ]
        head = [len(used), len(targets), len(self.code), kernel, self.parity]
        pairs = [x for on, weight in targets.items() for x in (on + 1, weight)]
        return [*head, *reads[list(used)].ravel(order="F").tolist(), *pairs, *steps]


def compile_law(
    where: str, text: str, arguments: Sequence[str], parameters: Mapping[str, float]
) -> Law:
    """Compile a text; ``where`` is what an error calls it."""
    if len(text) > _MAX_LENGTH:
        raise InputError(f"{where}: {len(text)} characters, must be at most {_MAX_LENGTH}")
    names = list(parameters)
    shown = repr(text if len(text) <= 60 else text[:57] + "...")
    if not text.isascii():
        raise InputError(f"{where} = {shown}: must have letters of the English alphabet")
    try:
        code, number, n, parity = _native.call(
            core.law_compile, text.replace("\n", " "), _fields(arguments), len(arguments),
            _fields(names), np.array([parameters[name] for name in names]), _MAX_CODE,
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"{where} = {shown}: {error}") from None
    return Law(text, tuple(arguments), tuple(code[:n].tolist()), tuple(number[:n].tolist()), parity)


def read_law(
    where: str, text: str, arguments: Sequence[str], parameters: Mapping[str, float]
) -> Polynomial | Law:
    """Return a text as a polynomial in its arguments if it is one, else compiled."""
    names = [*arguments, *parameters]
    try:
        terms = expand(where, text, names)
    except InputError as error:
        try:
            law = compile_law(where, text, arguments, parameters)
        except InputError as other:
            # Of a text with a function the other reader knows what is wrong.
            raise (other if re.search(r"[A-Za-z_]\w*\s*\(|[<>]", text) else error) from None
        n = len(arguments)
        near = _NEAR * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
        if (np.abs(law(near)[0]) >= _WALL).any():
            raise InputError(
                f"{where} = {text!r}: must be defined around rest, where what it depends on is 0"
            ) from None
        return law
    result: Polynomial = {}
    for powers, c in terms.items():
        factor = c
        for value, power in zip(parameters.values(), powers[len(arguments) :], strict=True):
            factor *= value**power
        if not np.isfinite(factor):
            raise InputError(f"{where}: a coefficient is not finite")
        own = powers[: len(arguments)]
        result[own] = result.get(own, 0.0) + factor
    return result


def _fields(names: Sequence[str]) -> str:
    for name in names:
        if len(name) > _FIELD:
            raise InputError(f"{name!r}: must have at most {_FIELD} characters")
    return "".join(name.ljust(_FIELD) for name in names)
