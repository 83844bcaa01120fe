"""Multiple scales at many values: neighbours help the search, without effect on results."""

import numpy as np
import pytest
import viscovib as vv

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")


def pendulums(rng, count):
    """Random pendulums under one load near a mode, with energy exchange of three modes."""
    while count:
        w2, w3 = rng.uniform(0.3, 0.7), rng.uniform(0.7, 1.1)
        e = rng.uniform(0.03, 0.1)
        if e * (w3 / w2) ** 2 >= 0.9:
            continue
        body = {
            "e": e, "w2": w2, "w3": w3, "alpha": rng.uniform(0, 0.5),
            "c1": 0.005, "c2": 0.005, "c3": 0.005,
        }  # fmt: skip
        j = rng.integers(3)
        name, load = ("p1", "p2", "p3")[j], ("f0", "m01", "m02")[j]
        p = vv.MultipleScales(vv.Pendulum(**body)).frequencies[j] * rng.uniform(0.95, 1.05)
        yield name, p, vv.Pendulum(**body, **{name: p, load: 10 ** rng.uniform(-4, -2)})
        count -= 1


def test_neighbours_change_nothing():
    """All motions at a single value equal those found with twenty others, within rounding.

    Motions appear in pairs: a missing one would leave an even number.
    """
    rng = np.random.default_rng(1)
    most = 0
    for name, p, system in pendulums(rng, 12):
        ms = vv.MultipleScales(system)
        values = p * np.linspace(0.99, 1.01, 21)
        found = ms.response(name, values)
        counts = np.bincount(found.index, minlength=21)
        assert (counts % 2 == 1).all()
        most = max(most, counts.max())
        for k in rng.integers(21, size=2):
            alone = ms.response(name, [values[k]])
            assert alone.index.size == counts[k]
            np.testing.assert_allclose(
                np.sort(abs(alone.amplitudes), axis=0),
                np.sort(abs(found.amplitudes[found.index == k]), axis=0),
                rtol=1e-9, atol=1e-12,
            )  # fmt: skip
    assert most >= 5
