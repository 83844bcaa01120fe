"""Energy loss of periodic motions in the elements of a structure, or parts of a system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError
from viscovib.results.structure_view import View
from viscovib.systems.element_laws import laws_along, laws_of_groups
from viscovib.systems.friction import cycles
from viscovib.systems.laws import Law
from viscovib.systems.load import base_shifts
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.spring_groups import SpringGroup

#: Samples per period and harmonic, smallest number, and number for laws with kinks or jumps.
_PER_ORDER, _FEWEST, _KINKED = 16, 1024, 16384
#: A direction depends on the condensed ones if its relative remainder is below this.
_DEPENDENT = 1e-9


@dataclass(frozen=True)
class Parts:
    """A system and its base motion, for the energy loss of its motions.

    ``orders``, ``series``: harmonics of load and base for a load factor of 1, in the form of the
    core.
    """

    system: Any
    orders: Any
    series: ComplexArray

    def relative(self, orders: Any, x: ComplexArray, factors: FloatArray) -> ComplexArray:
        """Harmonics relative to the base, shape (n, n_dof, m)."""
        shifts = base_shifts(self.orders, self.series, self.system._base_direction)
        if not shifts:
            return x
        y = x.copy()
        for order, moved in shifts:
            y[:, :, orders == order] -= np.outer(factors, moved)[:, :, np.newaxis]
        return y

    def dissipated(
        self, nu: FloatArray, orders: Any, x: ComplexArray, factors: FloatArray, *, linear: bool
    ) -> FloatArray:
        """Energy loss per period in dampers and each group of springs, shape (n, 1 + n_groups).

        ``x``: harmonics of all coordinates, (n, n_dof, m); ``linear``: only linear forces.
        """
        system = self.system
        if not isinstance(system, PolynomialSystem) or system._turns:
            raise InputError(
                "dissipation: is of a PolynomialSystem, a Structure, or a Body with geometry = "
                f"'small', this is of {type(system).__name__}"
            )
        if system._has_hidden_forces:
            raise InputError(
                "dissipation: is not available for a Structure at the speed of its load: use "
                "structure.at_speed(speed)"
            )
        y = self.relative(orders, x, factors)
        losses = np.full((nu.size, 1 + len(system.groups)), np.nan)
        damping = np.asarray(system.damping, dtype=float)
        for i in np.flatnonzero(np.isfinite(y).all(axis=(1, 2))):
            power = np.einsum("ak,ab,bk->k", y[i].conj(), damping, y[i]).real
            losses[i, 0] = np.pi * nu[i] * (orders**2 * power).sum()
            for column, group in enumerate(system.groups, start=1):
                losses[i, column] = _of_group(group, float(nu[i]), orders, y[i], linear)
        return losses


def _of_group(group: SpringGroup, nu: float, orders: Any, y: ComplexArray, linear: bool) -> float:
    """Energy loss in a group of springs: K u, forces and laws with their part of C."""
    stiffness, n = group.stiffness, y.shape[0]
    laws, forces = (group.laws, group.forces) if not linear else ((), {})
    if group.kernel is None:
        # A symmetric stiffness loses no energy.
        stiffness = 0.5 * (stiffness - stiffness.T)
    if not (stiffness.any() or laws or forces or group.law_damping is not None):
        return 0.0
    theta, at, rate = _samples(orders, nu, y, any(law.branches for _, law in laws))
    force = at @ stiffness.T
    if group.law_damping is not None:
        force += rate @ group.law_damping.T
    if laws or forces:
        force += laws_of_groups([group]).forces_at(at.T, rate.T)[0].T
    return sum(
        _work(force[:, a], rate[:, a], theta, nu, orders, y[a], group.kernel) for a in range(n)
    )


def dissipated(
    view: View, nu: FloatArray, orders: Any, y: ComplexArray, factors: FloatArray,
    *, linear: bool = False,
) -> FloatArray:  # fmt: skip
    """Energy loss per period in each element, shape (n, n_elements).

    ``y``: harmonics of the condensed coordinates relative to the base, shape (n, q, m);
    ``linear``: by the forces linearized at rest, for linear motions.
    """
    losses = np.full((nu.size, len(view.elements)), np.nan)
    for column, terms in enumerate(view.elements):
        d = _deflections(view, column, nu, orders, y, factors)
        for i in np.flatnonzero(np.isfinite(d).all(axis=(1, 2))):
            losses[i, column] = _loss_of(terms, float(nu[i]), orders, d[i], linear)
    return losses


def _deflections(
    view: View, place: int, nu: FloatArray, orders: Any, y: ComplexArray, factors: FloatArray
) -> ComplexArray:
    """Harmonics of the deflections of an element, relative to the base, shape (n, n_own, m)."""
    loaded, terms = view.loaded, view.elements[place]
    condensed = loaded.condensation.laws.directions
    found = []
    for e in terms.directions if hasattr(terms, "directions") else (terms.direction,):
        weights = np.linalg.lstsq(condensed, e, rcond=None)[0]
        if np.linalg.norm(e - condensed @ weights) <= _DEPENDENT * np.linalg.norm(e):
            found.append(np.einsum("q,nqm->nm", weights, y))
            continue
        places = np.flatnonzero(e)
        u = loaded.expand(nu, orders, y, places, factors)
        if loaded.direction is not None:
            for j, order in enumerate(loaded.orders):
                base = np.outer(factors, loaded.direction[places] * loaded.base[j])
                u[:, :, orders == order] -= base[:, :, np.newaxis]
        found.append(np.einsum("q,nqm->nm", e[places], u))
    all_of_them = np.stack(found, axis=1)
    for order, moved in loaded.apart.items():
        assert view.held is not None
        stretched = np.multiply.outer(factors, view.held.ends[place] @ moved)
        all_of_them = all_of_them + np.multiply.outer(stretched, orders == order)
    return all_of_them


def _loss_of(terms: Any, nu: float, orders: Any, d: ComplexArray, linear: bool) -> float:
    """Energy loss of one motion, pi sum_k k Im(F_k conj(D_k)) with the forces F_k."""
    if hasattr(terms, "directions"):
        # A coupling has no linear part.
        return 0.0 if linear else _of_coupling(terms, nu, orders, d)
    own = d[0]
    work = float(np.pi * nu * terms.damping * (orders**2 * np.abs(own) ** 2).sum())
    law = terms.law
    if law is not None and law.state:
        # A slider at rest sticks.
        return work if linear else work + _of_hysteresis(law, orders, own)
    elastic = law is None or max(law.places, default=0) < 1
    if terms.kernel is None and terms.series is None and elastic:
        # A force that depends only on the deflection loses no energy.
        return work
    theta, force, rate = _sampled(terms, nu, orders, d, linear)
    if terms.series is not None:
        # The force of the damper is k q, q = s' + r s, and its rate is that of this law by k.
        at = (np.exp(1j * np.outer(theta, orders)) @ own).imag
        flow = (force + terms.damping * rate) * (rate + terms.series.rate * at)
        return float(flow.mean() * 2 * np.pi / nu)
    return work + _work(force, rate, theta, nu, orders, own, terms.kernel)


def _sampled(
    terms: Any, nu: float, orders: Any, d: ComplexArray, linear: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phases of a period, forces of springs and laws without memory, and rates, shape (n,)."""
    law = terms.law
    theta, at, rate = _samples(orders, nu, d, law is not None and law.branches and not linear)
    powers = {power: c for power, c in terms.powers.items() if power == 1 or not linear}
    force = sum((c * at[:, 0] ** power for power, c in powers.items()), 0 * at[:, 0])
    if law is not None and law.state:
        if not linear:
            force = cycles(law.state, law.number[1:], at)[0][:, 0]
    elif law is not None:
        both = np.stack([at[:, 0], rate[:, 0]], axis=1)
        force = force + _values(law, both, linear)
    return theta, force, rate[:, 0]


def forces_of_elements(
    view: View, nu: FloatArray, orders: Any, y: ComplexArray, factors: FloatArray, chosen: Any,
    *, linear: bool,
) -> ComplexArray:  # fmt: skip
    """Harmonics of the forces of the elements ``chosen``, shape (n, n_chosen, m).

    Arguments as of `dissipated`; couplings are not possible.
    """
    found = np.full((nu.size, len(chosen), orders.size), np.nan, dtype=complex)
    for column, place in enumerate(chosen):
        terms = view.elements[place]
        d = _deflections(view, place, nu, orders, y, factors)
        for i in np.flatnonzero(np.isfinite(d).all(axis=(1, 2))):
            theta, force, _ = _sampled(terms, float(nu[i]), orders, d[i], linear)
            parts = 2j / theta.size * (force @ np.exp(-1j * np.outer(theta, orders)))
            parts[orders == 0] /= 2
            if terms.kernel is not None:
                parts[orders == 0] *= 1 - terms.kernel.integral
                parts[orders > 0] *= 1 - terms.kernel.laplace(1j * nu[i] * orders[orders > 0])
            found[i, column] = parts + 1j * orders * nu[i] * terms.damping * d[i, 0]
    return found


def _values(law: Law, at: FloatArray, linear: bool) -> FloatArray:
    """Values of a law at samples of its arguments, or of its linear part at rest."""
    at = at[:, : len(law.arguments)]
    return at @ law.slopes_at_rest if linear else law(at)[0]


def _of_coupling(terms: Any, nu: float, orders: Any, d: ComplexArray) -> float:
    kinked = any(law.branches for _, law in terms.programs)
    theta, at, rate = _samples(orders, nu, d, kinked)
    q = d.shape[0]
    laws = laws_along(np.eye(q), [], [], [terms], [[{j: 1.0} for j in range(q)]])
    force = laws.forces_at(at.T, rate.T)[0].T
    return sum(
        _work(force[:, a], rate[:, a], theta, nu, orders, d[a], terms.kernel) for a in range(q)
    )


def _samples(
    orders: Any, nu: float, d: ComplexArray, kinked: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phases of a period, and deflections and rates at these phases, shape (n, n_own)."""
    n = max(_KINKED if kinked else _FEWEST, _PER_ORDER * int(orders.max(initial=1)))
    theta = 2 * np.pi * np.arange(n) / n
    waves = np.exp(1j * np.outer(theta, orders))
    return theta, (waves @ d.T).imag, (waves @ (1j * orders * nu * d).T).imag


def _work(
    force: FloatArray, rate: FloatArray, theta: FloatArray, nu: float, orders: Any,
    d: ComplexArray, kernel: Any,
) -> float:  # fmt: skip
    """Work of a force per period; with a kernel, of (1 - R(i k nu)) F_k."""
    if kernel is None:
        return float((force * rate).mean() * 2 * np.pi / nu)
    parts = 2j / theta.size * (force @ np.exp(-1j * np.outer(theta, orders)))
    factors = np.ones(orders.size, dtype=complex)
    factors[orders > 0] -= kernel.laplace(1j * nu * orders[orders > 0])
    return float(np.pi * (orders * (factors * parts * d.conj()).imag).sum())


def _of_hysteresis(law: Any, orders: Any, d: ComplexArray) -> float:
    """Energy loss of a hysteresis element, from the turning points of its deflection."""
    n = max(_FEWEST, _PER_ORDER * int(orders.max(initial=1)))
    theta = 2 * np.pi * np.arange(n) / n
    waves = np.exp(1j * np.outer(theta, orders))
    at, slope = (waves @ d).imag, (waves @ (1j * orders * d)).imag
    turns = np.flatnonzero(slope * np.roll(slope, -1) <= 0)
    if turns.size < 2 or not np.ptp(at):
        return 0.0
    # Newton's method from the secant: an error x of the phase has the effect x^2.
    phase = theta[turns] + 2 * np.pi / n * slope[turns] / (
        slope[turns] - np.roll(slope, -1)[turns] + np.finfo(float).tiny
    )
    for _ in range(2):
        waves = np.exp(1j * np.outer(phase, orders))
        rate, bend = (waves @ (1j * orders * d)).imag, (waves @ (-(orders**2) * d)).imag
        step = rate / np.where(bend == 0, np.inf, bend)
        phase = phase - np.clip(step, -2 * np.pi / n, 2 * np.pi / n)
    ends = (np.exp(1j * np.outer(phase, orders)) @ d).imag
    return float(cycles(law.state, law.number[1:], ends[:, np.newaxis])[1][0])
