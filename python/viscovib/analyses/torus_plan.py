"""Plan of harmonic balance of a pendulum."""

import numpy as np

from viscovib.analyses.torus import AMPLITUDES, IntArray, Torus
from viscovib.common.counts import things
from viscovib.common.plan import Plan
from viscovib.systems.pendulum import Pendulum


def torus_plan(
    first: str, pend: Pendulum, torus: Torus, kept: IntArray, varies: str | None, stability: str
) -> Plan:
    """Return the plan that starts with the line ``first``.

    ``kept``: from `kept_by_symmetry`; ``stability``: "multipliers", "rates", or the reason for
    its absence.
    """
    base = things(torus.n_axes, "base frequency", "base frequencies")
    axes = ", ".join(torus.names)
    real = np.where(np.arange(len(kept)) > 0, 2, 1)
    n, whole = int(real @ kept.sum(axis=1)), 3 * int(real.sum())
    lines = [
        first,
        f"computes: {things(len(kept), 'harmonic')} of {base} ({axes}), {n} unknowns",
    ]
    if torus.n_axes > 1:
        lines.append(f"computes: samples on a torus of {things(torus.n_axes, 'angle')}")
    elif not kept[:, 1:].any():
        lines.append(
            "skips: unknowns of phi and psi (no moment acts on them, and they are at rest)"
        )
    if n < whole and kept[:, 1:].any():
        lines.append(
            f"skips: {whole - n} of {whole} unknowns (they are 0 by the symmetry of system and "
            "loads)"
        )
    silent = [size for size in AMPLITUDES if getattr(pend, size) == 0 and size != varies]
    if silent:
        lines.append(f"skips: loads {', '.join(silent)} (amplitude 0)")
    if stability in ("multipliers", "rates"):
        what = "Floquet multipliers" if stability == "multipliers" else "rates of growth"
        lines.append(f"computes: {what} of every motion")
    else:
        lines.append(f"skips: stability ({stability})")
    return Plan("\n".join(lines))
