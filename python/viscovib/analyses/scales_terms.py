"""Terms of modulation equations, and the frequencies of free vibration that follow from them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viscovib._native import FloatArray
from viscovib.errors import InputError


@dataclass(frozen=True)
class FlowTerm:
    """A term of the modulation equations of mode ``mode``: coefficient times product.

    ``factors``: amplitudes such as "a1" or "a2*" (conjugate), and loads such as "p3".
    """

    mode: int
    factors: tuple[str, ...]
    coefficient: complex


def formula(terms: Sequence[FlowTerm], names: Sequence[str], n_modes: int) -> str:
    """Return the solution in LaTeX: the leading order, and the modulation equations by their order.

    The order of a term is its number of factors; a load near a resonance has the third order.
    """
    lines = [
        rf"u_{{\mathrm{{{name}}}}} &= \sum_{{j=1}}^{{{n_modes}}} "
        rf"\phi_{{\mathrm{{{name}}},j}}\, a_j "
        r"e^{i \omega_j t} + \mathrm{c.c.} + O(a^2)"
        for name in names
    ]
    for mode in range(n_modes):
        sums: dict[tuple[str, ...], complex] = {}
        for one in terms:
            if one.mode == mode:
                sums[one.factors] = sums.get(one.factors, 0) + one.coefficient
        own = [FlowTerm(mode, factors, value) for factors, value in sums.items()]
        own.sort(key=_order)
        parts = [rf"\dot a_{{{mode + 1}}} &= "]
        order = 0
        for one in own:
            if _order(one) != order:
                line = rf"\\{chr(10)}&\quad " if order else ""
                order = _order(one)
                parts.append(rf"{line}O(a^{order}):\ ")
            product = r"\,".join(map(_symbol, one.factors))
            parts.append(f"+ ({_number(one.coefficient)})\\,{product} ")
        lines.append("".join(parts) + ("" if own else "0 ") + "+ O(a^4)")
    return r"\begin{aligned}" + (r"\\" + "\n").join(lines) + r"\end{aligned}"


def _order(term: FlowTerm) -> int:
    alone = len(term.factors) == 1 and term.factors[0].startswith("p")
    return 3 if alone else len(term.factors)


def _symbol(factor: str) -> str:
    letter, number = factor[0], factor[1:].rstrip("*")
    plain = f"{letter}_{{{number}}}"
    return rf"\bar {plain}" if factor.endswith("*") else plain


def _number(value: complex) -> str:
    return f"{value.real:.6g} {'-' if value.imag < 0 else '+'} {abs(value.imag):.6g}\\,i"


def free_frequencies(
    j: int, b: FloatArray, terms: list[FlowTerm], natural: FloatArray, interaction: FloatArray
) -> FloatArray:
    """Frequencies of mode j at real amplitudes b, for `MultipleScales.backbone`."""
    alone = {f"a{j + 1}", f"a{j + 1}*"}
    driven = {x.mode for x in terms if x.mode != j and set(x.factors) <= alone}
    if not driven:
        shifts = [x.coefficient for x in terms if (x.mode, x.factors) == (j, (f"a{j + 1}",))]
        at_rest = natural[j] + sum(shifts).imag
        return np.asarray(at_rest + interaction[j, j] * b**2)
    if len(driven) > 1:
        raise InputError(
            f"mode = {j}: moves {len(driven)} modes by internal resonance, must be at most "
            "one; use modulation"
        )
    ways = [_joint_frequencies(j, next(iter(driven)), terms, natural, x) for x in b.ravel()]
    found = np.full((b.size, max(map(len, ways), default=0)), np.nan)
    for row, values in zip(found, ways, strict=True):
        row[: len(values)] = values
    return found.reshape(*b.shape, -1)


def _joint_frequencies(
    j: int, k: int, terms: list[FlowTerm], natural: FloatArray, amplitude: float
) -> FloatArray:
    """Frequencies of mode j at an amplitude with mode k locked to it, ascending.

    With W_k = n W_j and real a: W_j = w_j + G_j/a_j and (w_k - n W_j) a_k + G_k = 0, a
    polynomial for a_k.
    """
    a = amplitude / 2
    if a == 0:
        shifts = [x.coefficient for x in terms if (x.mode, x.factors) == (j, (f"a{j + 1}",))]
        return np.array([natural[j] + sum(shifts).imag])
    names = {j: f"a{j + 1}", k: f"a{k + 1}"}

    def power(term: FlowTerm, mode: int) -> int:
        plain = term.factors.count(names[mode])
        return plain - term.factors.count(names[mode] + "*")

    locks = [x for x in terms if x.mode == k and all(f.rstrip("*") == names[j]
                                                     for f in x.factors)]  # fmt: skip
    n = power(locks[0], j)
    change = {j: np.zeros(4), k: np.zeros(4)}
    for x in terms:
        inside = all(f.rstrip("*") in names.values() for f in x.factors)
        if x.mode not in names or not inside:
            continue
        if power(x, j) + n * power(x, k) == (1 if x.mode == j else n):
            of_k = sum(f.rstrip("*") == names[k] for f in x.factors)
            change[x.mode][of_k] += x.coefficient.imag * a ** (len(x.factors) - of_k)
    frequency = change[j] / a + natural[j] * np.eye(4)[0]
    poly = np.polynomial.polynomial
    balance = poly.polyadd(
        poly.polymul([0, 1], poly.polysub([natural[k]], n * frequency)), change[k]
    )
    if not np.isfinite(balance).all():
        # Amplitudes that overflow have no frequency.
        return np.empty(0)
    balance[abs(balance) < 1e-14 * abs(balance).max()] = 0
    roots = poly.polyroots(np.trim_zeros(balance, "b"))
    real = roots.real[abs(roots.imag) < 1e-9 * (abs(a) + abs(roots))]
    # Larger amplitudes are vibrations of mode k.
    real = real[abs(real) <= abs(a)]
    return np.sort(poly.polyval(real, frequency))
