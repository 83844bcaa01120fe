"""Force laws that are not polynomials, as programs of the core."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.python_law import CalledLaw, PythonLaw
from viscovib.systems.traced_law import text_of

#: Powers of every coordinate, and the coefficient.
Polynomial = dict[tuple[int, ...], float]

#: Highest degree in the core.
MAX_DEGREE = 15
_FIELD, _MAX_LENGTH = 64, 20_000
#: Instruction codes of the core.
_NUMBER, _ARGUMENT, _SUBTRACT, _MULTIPLY = 1, 2, 4, 5
_ODD = -1
#: Code of a Python function of n operands: this + n; its number is its index in `Law.calls`.
_CALLED = 40
#: Codes with a kink or a jump: abs, sign, heaviside, atan2, min, max and comparisons.
BRANCHES = (26, 27, 28, 29, 30, 31, 32, 33, 34, 35)
#: Value that the core returns outside a domain; distance from rest at which laws are defined.
WALL, _NEAR = 1e60, 1e-9
#: Relative tolerance for a function and its equivalent text; values that are rounding errors.
_SAME, _NONE = 1e-10, 1e-25
#: Largest number of variables in a message.
_LISTED = 8


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
    #: 1: even, -1: odd, 0: unknown.
    parity: int
    #: Degree of a polynomial; 0 if the law is not a polynomial.
    degree: int = 0
    #: Number of arguments, at the end, that are rates of the first arguments.
    n_rates: int = 0
    #: Kind of hysteresis (1: Jenkins, 2: Bouc-Wen, 3: Dahl, from 1001: user elements). The program
    #: then contains only parameters.
    state: int = 0
    #: Python functions that the law calls.
    calls: tuple[CalledLaw, ...] = ()

    def __call__(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values, shape (n,), and derivatives, shape (n, n_arguments), at (n, n_arguments)."""
        found = _native.run("law values", **self._program, arguments=at, with_slopes=True)
        return found["values"], found["slopes"]

    def values(self, at: FloatArray) -> FloatArray:
        """Values without derivatives, in half the time."""
        found = _native.run("law values", **self._program, arguments=at, with_slopes=False)
        return np.asarray(found["values"])

    @cached_property
    def _program(self) -> dict[str, Any]:
        """Instruction codes and their numbers for the core."""
        return {"code": np.array(self.code), "number": np.array(self._numbers_of_core, dtype=float)}

    @property
    def _numbers_of_core(self) -> tuple[float, ...]:
        """Numbers of the instructions; for Python functions, their numbers in the core."""
        if not self.calls:
            return self.number
        return tuple(
            float(self.calls[int(x)].number) if code > _CALLED else x  # type: ignore[attr-defined]
            for code, x in zip(self.code, self.number, strict=True)
        )

    @cached_property
    def slopes_at_rest(self) -> FloatArray:
        """Derivatives where all arguments are 0, shape (n_arguments,)."""
        return np.asarray(self(np.zeros((1, len(self.arguments))))[1][0])

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Indices of the arguments that the law reads."""
        pairs = zip(self.code, self.number, strict=True)
        return tuple(sorted({int(x) - 1 for code, x in pairs if code == _ARGUMENT}))

    @cached_property
    def branches(self) -> bool:
        """True if the law has a kink or a jump."""
        return any(code in BRANCHES for code in self.code)

    @property
    def stiffness_at_rest(self) -> FloatArray:
        """Derivatives at rest with respect to the positions."""
        return self.slopes_at_rest[: len(self.arguments) - self.n_rates]

    def damping_at_rest(self, *, remembers: bool = False) -> FloatArray:
        """Derivatives at rest with respect to the rates; 0 with a kernel (no viscous damping)."""
        slopes = self.slopes_at_rest[len(self.arguments) - self.n_rates :]
        return np.asarray(0.0 * slopes if remembers else slopes)

    def remainder(self, *, remembers: bool = False) -> Law:
        """Return the law without its linear part at rest; with a kernel, rates keep their part."""
        slopes = [*self.stiffness_at_rest, *self.damping_at_rest(remembers=remembers)]
        return self.without(slopes)

    def without(self, slopes: Sequence[float]) -> Law:
        """Return the law minus ``slopes`` times its arguments."""
        code, number = list(self.code), list(self.number)
        for place, slope in enumerate(slopes, start=1):
            if slope != 0:
                code += [_ARGUMENT, _NUMBER, _MULTIPLY, _SUBTRACT]
                number += [place, float(slope), 0.0, 0.0]
        # An even law has zero slope at rest unless it has a kink at 0.
        parity = self.parity if self.parity == _ODD or len(code) == len(self.code) else 0
        return replace(self, code=tuple(code), number=tuple(number), parity=parity)

    def less(self, other: Law) -> Law:
        """Return the difference of two laws of the same arguments."""
        places = [
            number + len(self.calls) if code > _CALLED else number
            for code, number in zip(other.code, other.number, strict=True)
        ]
        return replace(
            self,
            text=f"({self.text}) - ({other.text})",
            code=(*self.code, *other.code, _SUBTRACT),
            number=(*self.number, *places, 0.0),
            parity=self.parity if self.parity == other.parity else 0,
            degree=max(self.degree, other.degree) if self.degree and other.degree else 0,
            calls=(*self.calls, *other.calls),
        )

    def read_at(self, there: FloatArray) -> dict[str, float]:
        """Return the arguments that the law reads at a point, without rates if it reads others."""
        n_positions = len(self.arguments) - self.n_rates
        read = [place for place in self.places if place < n_positions] or self.places
        return {self.arguments[place]: float(there[place]) for place in read}

    def with_arguments(self, texts: Mapping[str, str]) -> str:
        """Return the text with expressions substituted for arguments."""
        return re.sub(r"[A-Za-z_]\w*", lambda m: f"({texts[m[0]]})" if m[0] in texts else m[0],
                      self.text)  # fmt: skip

    def about(self, name: str, at: float) -> Law:
        """Return f(at + d) - f(at) of one argument and possibly its rate."""
        at_rest = float(self(np.array([[at, *(0.0,) * self.n_rates]]))[0][0])
        text = f"({self.with_arguments({name: f'{name} + ({at!r})'})}) - ({at_rest!r})"
        return compile_law("law", text, self.arguments, {}, self.n_rates)

    def numbers(self, reads: FloatArray, targets: Mapping[int, float], kernel: int) -> list[float]:
        """Return the law as numbers for the core.

        ``reads``: matrix from coordinates to arguments, shape (m, n), also used from velocities to
        rates; ``targets``: weights of the law in the equations; ``kernel``: number of its kernel,
        from 1 (0: none).
        """
        n = len(self.arguments)
        of_coordinates, of_rates = np.zeros((2, n, reads.shape[1]))
        of_coordinates[: n - self.n_rates] = reads
        of_rates[n - self.n_rates :] = reads[: self.n_rates]
        used = self.places or (0,)
        place = {old + 1: new for new, old in enumerate(used, start=1)}
        steps = [
            x
            for code, number in zip(self.code, self._numbers_of_core, strict=True)
            for x in (code, place[int(number)] if code == _ARGUMENT else number)
        ]
        head = [len(used), len(targets), len(self.code), kernel]
        head += [self.parity, self.degree, self.state]
        rows = [part[list(used)].ravel(order="F").tolist() for part in (of_coordinates, of_rates)]
        pairs = [x for on, weight in targets.items() for x in (on + 1, weight)]
        return [*head, *rows[0], *rows[1], *pairs, *steps]


def expand(where: str, text: str, names: Sequence[str]) -> Polynomial:
    """Expand a polynomial of +, -, *, /, ^ (or **), parentheses, numbers and coordinates.

    ``where``: its name in errors. Terms that cancel are dropped.
    """
    _check_length(where, text)
    letters = _native.letters(where, text)
    try:
        found = _native.run("law expand", text=letters, names=_fields(names))
    except InputError as error:
        raise InputError(f"{where} = {_short(text)}: {error}") from None
    powers = map(tuple, found["powers"].T.tolist())
    return dict(zip(powers, found["coefficients"].tolist(), strict=True))


def spell(powers: Sequence[int], names: Sequence[str]) -> str:
    """Write a monomial: ``x1^2*x2``."""
    factors = [
        name if p == 1 else f"{name}^{p}" for name, p in zip(names, powers, strict=True) if p
    ]
    return "*".join(factors) or "1"


def _check_length(where: str, text: str) -> None:
    if len(text) > _MAX_LENGTH:
        raise InputError(f"{where}: {len(text)} characters, must be at most {_MAX_LENGTH}")


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def compile_law(
    where: str,
    text: str,
    arguments: Sequence[str],
    parameters: Mapping[str, float],
    n_rates: int = 0,
    *,
    named: bool = False,
) -> Law:
    """Compile a text; ``where``: its name in errors; the last ``n_rates`` arguments are rates.

    ``named``: True if the caller accepts parameters.
    """
    _check_length(where, text)
    names = list(parameters)
    letters = _native.letters(where, text)
    try:
        found = _native.run(
            "law compile", text=letters, arguments=_fields(arguments), names=_fields(names),
            values=np.array([parameters[name] for name in names], dtype=float),
        )  # fmt: skip
    except InputError as error:
        note = _name_text(str(error), arguments, named=named)
        raise InputError(f"{where} = {_short(text)}: {note}") from None
    steps = tuple(found["code"].tolist()), tuple(found["number"].tolist())
    return Law(text, tuple(arguments), *steps, found["parity"], found["degree"], n_rates)


@dataclass(frozen=True, eq=False)
class ManyLaws:
    """A law with n sets of parameters: one program per row, without the linear parts at rest."""

    code: npt.NDArray[np.intc]
    number: FloatArray
    #: Quantities that are equal for all runs of one form, one column each.
    form: list[npt.NDArray[Any]]
    #: Derivatives at rest, shape (n, n_arguments).
    slopes: FloatArray

    def numbers(self, runs: npt.NDArray[np.intp]) -> FloatArray:
        """Numbers on the stacks of the programs of runs of one form, as in `Law.remainder`."""
        first = runs[0]
        own = self.number[runs][:, self.code[first] == _NUMBER]
        return np.concatenate([own, self.slopes[runs][:, self.slopes[first] != 0]], axis=1)


def compile_many(
    text: str, arguments: Sequence[str], parameters: Mapping[str, FloatArray], n: int
) -> ManyLaws | None:
    """Compile a text for n values of each parameter; the last half of the arguments are rates.

    None: the law cannot be compiled for some of the values.
    """
    values = np.array(list(parameters.values())).reshape(len(parameters), n)
    letters = _native.letters("law", text)
    names = {"arguments": _fields(arguments), "names": _fields(list(parameters))}
    found = _native.run_in_parts(
        "law compile_many", None, 5e-8 * len(text) + 5e-6,
        {"text": letters, **names, "near": _NEAR}, values=values,
    )  # fmt: skip
    if found["flaws"].any():
        return None
    code, number, slopes = (found[name].T for name in ("code", "number", "slopes"))
    longest = int(found["lengths"].max())
    code, number = code[:, :longest], number[:, :longest]
    fixed = np.where(code == _NUMBER, 0.0, number)
    form = [*code.T, *fixed.T, *(slopes != 0).T]
    return ManyLaws(code, number, form, slopes)


def function_law(
    where: str,
    function: object,
    arguments: Sequence[str],
    parameters: Mapping[str, float],
    rates: Sequence[str],
) -> str | Law:
    """Return a Python function as a text if an equivalent text exists, else as a law.

    The law calls the function with its parameters as operands, so that they may be varied.
    """
    law = function if isinstance(function, PythonLaw) else PythonLaw(function)  # type: ignore[arg-type]
    variables = [*arguments, *rates]
    called = law._bound_to(where, variables, parameters)
    text = text_of(law.function, called.names, called.keywords)
    same = text is not None and _is_text(text, called, variables, parameters, len(rates))
    if law.slopes is not None or not same:
        called.check(where, parameters)
    if text is not None and same:
        return text
    steps = [
        (_ARGUMENT, variables.index(name) + 1.0) if variable else (_NUMBER, parameters[name])
        for name, variable in zip(called.names, called.of_variables, strict=True)
    ]
    steps.append((_CALLED + len(steps), 0.0))
    code, number = zip(*steps, strict=True)
    text = f"{law._name}({', '.join(called.names)})"
    found = Law(text, tuple(variables), code, number, 0, n_rates=len(rates), calls=(called,))
    _refuse_edge(where, found)
    return found


def _is_text(
    text: str,
    called: CalledLaw,
    variables: Sequence[str],
    parameters: Mapping[str, float],
    n_rates: int,
) -> bool:
    """True if a text and a function have the same values at random operands of all sizes."""
    at = called.places(parameters)
    rows = np.zeros((at.shape[1], len(variables)))
    for name, row in zip(called.names, at, strict=True):
        if name in variables:
            rows[:, variables.index(name)] = row
    try:
        values = compile_law("law", text, variables, parameters, n_rates).values(rows)
        wanted = called.values(at)
    except Exception:  # the function is called instead and raises its own error
        return False
    valid = np.isfinite(wanted) & (np.abs(values) < WALL)
    off = np.abs(values - wanted)[valid]
    return bool(valid.any() and (off <= _SAME * np.abs(wanted[valid]) + _NONE).all())


def _refuse_edge(where: str, law: Law) -> None:
    """Refuse a law without a value or a finite derivative near rest."""
    fault = _native.run("law fault", **law._program, n_arguments=len(law.arguments))["fault"]
    if fault:
        raise InputError(f"{where} = {law.text!r}: {fault}") from None


def read_law(
    where: str,
    text: Any,
    arguments: Sequence[str],
    parameters: Mapping[str, float],
    rates: Sequence[str] = (),
    *,
    named: bool = True,
    preloaded: bool = False,
) -> Polynomial | Law:
    """Return a text as a polynomial in its arguments if possible, else compiled.

    A Python function becomes a law that calls it.

    ``rates``: names of the rates of the arguments; laws with rates are compiled. ``named``: True if
    the caller accepts parameters. ``preloaded``: laws that are not 0 at rest are compiled.
    """
    if not isinstance(text, str):
        text = function_law(where, text, arguments, parameters, rates)
    if isinstance(text, Law):
        return text
    names = [*arguments, *parameters]
    try:
        terms = expand(where, text, names)
    except InputError as error:
        if "its coefficients must" in str(error):
            raise
        # It is not a polynomial; the reader of all laws reports possible errors.
        law = compile_law(where, text, [*arguments, *rates], parameters, len(rates), named=named)
        _refuse_edge(where, law)
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
    if preloaded and result.get((0,) * len(arguments)):
        # A static force: only compiled laws may have one.
        return compile_law(where, text, [*arguments, *rates], parameters, len(rates))
    return result


def _name_text(note: str, variables: Sequence[str], *, named: bool) -> str:
    """Message of an error; for an unknown name also the known names and the use of parameters."""
    parts = re.fullmatch(r"'(\w+)' is neither a variable nor a parameter(.*)", note)
    if parts is None:
        return note
    name, near = parts.groups()
    listed = ", ".join(variables[:_LISTED]) + ", ..." * (len(variables) > _LISTED)
    hint = f"; to make it one, give parameters={{{name!r}: its value}}" if named else ""
    return f"{name!r} is neither a variable ({listed}) nor a parameter{near}{hint}"


def named_in(names: Iterable[str], *laws: object) -> tuple[str, ...]:
    """The names that occur in laws: texts, lists of texts or mappings to texts.

    For a Python function all names: it is called only with parameters that it has.
    """
    texts: list[object] = []
    for law in laws:
        if isinstance(law, Mapping):
            texts += law.values()
        elif isinstance(law, Sequence) and not isinstance(law, str):
            texts += law
        else:
            texts.append(law)
    if any(callable(one) or isinstance(one, PythonLaw) for one in texts):
        return tuple(names)
    words = set(re.findall(r"[A-Za-z_]\w*", " ".join(one for one in texts if isinstance(one, str))))
    return tuple(name for name in names if name in words)


#: A name, or a number (the e of an exponent is not a name).
_WORD = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?|[A-Za-z_]\w*")


def with_numbers(text: str, parameters: Mapping[str, float]) -> str:
    """Return a law with numbers substituted for parameters."""
    return _WORD.sub(lambda m: f"({parameters[m[0]]!r})" if m[0] in parameters else m[0], text)


def parameter_values(parameters: object, taken: Sequence[str]) -> dict[str, float]:
    """Parameters of a law by name."""
    if parameters is None:
        return {}
    if not isinstance(parameters, Mapping):
        raise InputError(f"parameters = {_native.shown(parameters)}: must be a mapping to numbers")
    values = {}
    for name, value in parameters.items():
        if not isinstance(name, str) or not name.isidentifier() or name in taken:
            raise InputError(
                f"parameters: {_native.shown(name)} must be a name, other than {', '.join(taken)}"
            )
        values[name] = _native.number(f"parameters[{name!r}]", value)
    return values


def _fields(names: Sequence[str]) -> bytes:
    """Names in fields of fixed length for the core."""
    fields = [name.encode() for name in names]
    for name, field in zip(names, fields, strict=True):
        if len(field) > _FIELD:
            raise InputError(f"{name!r}: must have at most {_FIELD} characters")
    return b"".join(field.ljust(_FIELD) for field in fields)
