"""Rubber from measured data: sums of kernels, temperature, shift laws, by mpmath."""

import mpmath as mp
import numpy as np

from referee.case import Case, Claim, even, few
from referee.kernels import ROUNDING, _power

JUDGES = (
    "SumKernel", "ThermalKernel", "ThermalKernel.at", "ThermalKernel.slowness", "ShiftLaw",
    "ShiftLaw.__call__", "ShiftLaw.log10", "WLF", "WLF.log10", "Arrhenius", "Arrhenius.log10",
)  # fmt: skip


def _warm_sum(rng, index):
    """A sum of kernels at a temperature, by closed forms of its parts."""
    made = [_power(rng, int(rng.integers(4))) for _ in range(int(rng.integers(1, 4)))]
    reference, warm = even(rng, -20, 40, 1), even(rng, 0, 60, 1)
    hot = reference + warm
    # The reference uses the rounded numbers of the sum.
    warm = mp.mpf(hot) - mp.mpf(reference)
    if index % 2:
        c1, c2 = few(rng, 2, 30, 3), even(rng, 40, 200, 1)
        law = f"vv.WLF(reference={reference}, c1={c1}, c2={c2})"
        decades = float(-c1 * warm / (c2 + warm))
    else:
        energy = few(rng, 2e4, 2e5, 3)
        law = f"vv.Arrhenius(reference={reference}, activation_energy={energy})"
        with mp.workdps(30):
            kelvin = mp.mpf(reference) + mp.mpf(273.15)
            slope = energy / mp.mpf(8.31446261815324) / mp.log(10)
            decades = float(slope * (1 / (kelvin + warm) - 1 / kelvin))
    mu = [few(rng, 1e-3, 1e3, 4) for _ in range(5)]
    t = [float(f"{10**decades * few(rng, 1e-3, 1, 4):.4g}") for _ in range(2)]
    call = f"""law = {law}
rubber = vv.ThermalKernel(kernel=vv.SumKernel(parts=[{", ".join(one[0] for one in made)}]), shift=law)
warm = rubber.at({hot!r})
slowness, decades, factor = warm.slowness, law.log10({hot!r}), law({hot!r})
hats, value, relaxation = warm.transform({mu}), warm({t}), warm.relaxation({t})
"""

    def judge(names, reported):
        slow = mp.mpf(10) ** mp.mpf(decades)
        with mp.workdps(30):
            hats = [sum(one[1](mp.mpc(0, m) * slow) for one in made) for m in mu]
            at = [sum(one[2](mp.mpf(x) / slow) for one in made) / slow for x in t]
            passed = [sum(one[3](mp.mpf(x) / slow) for one in made) for x in t]
        hats = np.array([complex(x) for x in hats])
        at, passed = (np.array([float(x) for x in one]) for one in (at, passed))
        # Decades of size 10 have an error of 1e-15, so their powers have an error of 1e-14.
        lost = 1e-14 * (1 + abs(decades))
        yield Claim("decades", float(names["decades"]), decades, 1e-13 * (1 + abs(decades)))
        yield Claim("slowness", float(names["slowness"]), float(slow), lost * float(slow))
        yield Claim("factor", float(names["factor"]), float(slow), lost * float(slow))
        yield Claim("transform", names["hats"], hats, (ROUNDING + lost) * np.abs(hats))
        # Rates of up to 50 lose digits in the exponent.
        yield Claim("value", names["value"], at, (1e-12 + 60 * lost) * np.abs(at))
        yield Claim("relaxation", names["relaxation"], 1 - passed, (1e-12 + lost) * (1 + passed))

    return Case(call, judge, may_refuse=True)


def case(rng: np.random.Generator, index: int) -> Case:
    """The kinds of questions in turn."""
    return _warm_sum(rng, index)
