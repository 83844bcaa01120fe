"""Translation of Python force laws to texts by one call with symbols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

#: NumPy functions in the syntax of laws; {} are the operands.
_TEXTS = {
    "add": "({} + {})", "subtract": "({} - {})", "multiply": "({}*{})",
    "divide": "({}/{})", "power": "({}^{})", "float_power": "({}^{})", "square": "({}^2)",
    "reciprocal": "(1/{})", "negative": "(-{})", "positive": "{}",
    "arctan": "atan({})", "arcsin": "asin({})", "arccos": "acos({})",
    "arctan2": "atan2({}, {})", "arcsinh": "asinh({})", "arccosh": "acosh({})",
    "arctanh": "atanh({})", "absolute": "abs({})", "fabs": "abs({})",
    "minimum": "min({}, {})", "maximum": "max({}, {})", "fmin": "min({}, {})",
    "fmax": "max({}, {})", "less": "({} < {})", "less_equal": "({} <= {})",
    "greater": "({} > {})", "greater_equal": "({} >= {})",
    "logical_and": "({}*{})", "bitwise_and": "({}*{})", "where": "where({}, {}, {})",
    "hypot": "sqrt({}^2 + {}^2)",
    # Without the cancellation of log(1 + x) and exp(x) - 1.
    "log1p": "(2*atanh({0}/(2 + {0})))", "expm1": "(2*sinh({0}/2)*exp({0}/2))",
} | {name: name + "({})" for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log",
                                      "sqrt", "sign")}  # fmt: skip
#: Intermediate results that are used many times make long texts. Then the function is called.
_MAX_LENGTH = 2000


class _Traced(NDArrayOperatorsMixin):
    """An operand or an intermediate result, as a text."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __array_ufunc__(self, function: Any, method: str, *operands: Any, **options: Any) -> Any:
        return _applied(function.__name__, operands) if method == "__call__" else NotImplemented

    def __array_function__(self, function: Any, types: Any, operands: Any, options: Any) -> Any:
        if function.__name__ == "clip" and not any(one is None for one in operands):
            x, low, high = operands
            return _applied("minimum", (_applied("maximum", (x, low)), high))
        return NotImplemented if options else _applied(function.__name__, operands)

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("a traced operand has no numbers")

    def __bool__(self) -> bool:
        raise TypeError("a traced operand has no truth value")


def _applied(name: str, operands: Sequence[Any]) -> Any:
    pattern = _TEXTS.get(name)
    if pattern is None or max(pattern.count("{}"), "{0}" in pattern) != len(operands):
        return NotImplemented
    text = pattern.format(*map(_spelled, operands))
    if len(text) > _MAX_LENGTH:
        raise OverflowError("the text is too long")
    return _Traced(text)


def _spelled(operand: Any) -> str:
    if isinstance(operand, _Traced):
        return operand.text
    number = float(operand)
    if not np.isfinite(number):
        raise ValueError("not a finite number")
    return f"({number!r})" if number < 0 else repr(number).removesuffix(".0")


def text_of(function: Any, names: Sequence[str], keywords: Sequence[bool]) -> str | None:
    """Return a function of these arguments, some passed by name, as a text.

    None: no text is equivalent, so the function must be called.
    """
    first = [_Traced(n) for n, keyword in zip(names, keywords, strict=True) if not keyword]
    by_name = {n: _Traced(n) for n, keyword in zip(names, keywords, strict=True) if keyword}
    try:
        found = function(*first, **by_name)
    except Exception:  # any exception: it needs numbers
        return None
    return found.text if isinstance(found, _Traced) else None
