"""The interface of a family: a call, and the claims about its result."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Claim:
    """A result (number, text or truth value) and its reference value.

    ``claimed``: the stated error (estimate, tolerance, rounding) plus the uncertainty of the
    reference. None: ``got`` must equal ``true``, such as a count or a word. ``limit``: the ratio of
    true to claimed error above which the result is wrong. ``damage``: the relative error that the
    self-test injects, which must be found.
    """

    what: str
    got: Any
    true: Any
    claimed: Any = None
    limit: float = 1.0
    damage: float = 1e-6

    def ratio(self) -> float:
        """True error divided by claimed error; inf for a wrong value, a wrong shape or a NaN."""
        got, true = np.asarray(self.got), np.asarray(self.true)
        if got.shape != true.shape:
            return math.inf
        if self.claimed is None:
            return 0.0 if (got == true).all() else math.inf
        if not got.size:
            return 0.0
        error = np.abs(got - true)
        allowed = np.broadcast_to(np.asarray(self.claimed, dtype=float), error.shape)
        if not (np.isfinite(error).all() and np.isfinite(allowed).all()):
            return math.inf
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.where(error == 0, 0.0, error / allowed)
        return float(ratios.max())

    def damaged(self) -> "Claim":
        """Return the claim with an error injected into the result."""
        got = np.asarray(self.got)
        if self.claimed is None:
            wrong = (
                ~got
                if got.dtype == bool
                else np.char.add(got, "?")
                if got.dtype.kind == "U"
                else got + 1
            )
            return replace(self, got=wrong)
        return replace(self, got=got * (1 + self.damage))

    def __str__(self) -> str:
        """Describe the location of the largest error."""
        got, true = np.asarray(self.got), np.asarray(self.true)
        if got.shape != true.shape:
            return f"{self.what}: {_short(got)}, should be {_short(true)}"
        if self.claimed is None or not got.size:
            return f"{self.what}: {_short(got)}, should be {_short(true)}"
        allowed = np.broadcast_to(np.asarray(self.claimed, dtype=float), got.shape)
        error = np.abs(got - true)
        with np.errstate(divide="ignore", invalid="ignore"):
            worst = np.where(error == 0, 0.0, error / allowed)
        i = np.unravel_index(np.argmax(np.where(np.isfinite(worst), worst, np.inf)), got.shape)
        place = f"{list(map(int, i))}" if i else ""
        return (
            f"{self.what}{place}: {got[i]:.12g}, should be {true[i]:.12g}, admitted "
            f"{allowed[i]:.2g}, is off by {error[i]:.2g}"
        )


def _short(value: np.ndarray) -> str:
    text = np.array2string(value, threshold=12, edgeitems=4, precision=6).replace("\n", " ")
    return text if len(text) < 200 else text[:200] + "..."


@dataclass(frozen=True)
class Case:
    """A self-contained call and the function that checks it.

    ``call`` is Python code run with np and vv. ``judge`` receives its names and warnings.
    ``may_refuse``: an InputError is allowed (it is counted).
    """

    call: str
    judge: Callable[[dict[str, Any], list[str]], Iterable[Claim]]
    systems: int = 1
    may_refuse: bool = False


def number(x: float) -> str:
    """Write a number so that it can be read back exactly."""
    return repr(float(x))


def numbers(values: Any) -> str:
    """Write an array as nested lists."""
    return repr(np.asarray(values).tolist())


def few(rng: np.random.Generator, low: float, high: float, digits: int = 4) -> float:
    """Draw a number with few digits, uniformly in the logarithm."""
    x = math.exp(rng.uniform(math.log(low), math.log(high)))
    return float(f"{x:.{digits - 1}e}")


def even(rng: np.random.Generator, low: float, high: float, digits: int = 4) -> float:
    """Draw a number of few digits, evenly."""
    return float(f"{rng.uniform(low, high):.{digits - 1}e}")
