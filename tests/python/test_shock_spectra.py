"""Shock response spectra against closed forms in complex exponentials."""

import itertools
import math
import pickle

import matplotlib.pyplot as plt
import numpy as np
import pytest
import viscovib as vv

KINDS = ("absolute_acceleration", "relative_displacement", "pseudo_velocity")


def exact(times, values, hz, zeta, kind):
    """Extremes of x or A: residues of the modes of each segment, critical points by bisection.

    Returns primary positive and negative, residual positive and negative.
    """
    w = 2 * math.pi * hz
    root = w * complex(-zeta, math.sqrt(1 - zeta**2))
    period = 2 * math.pi / root.imag
    x, v = 0.0, 0.0
    found = []
    ends = [*np.diff(times), period]
    levels = [*itertools.pairwise(values), (0.0, 0.0)]
    for part, (h, (a, b)) in enumerate(zip(ends, levels, strict=True)):
        slope = (b - a) / h
        # x = p + q t + Re(c exp(root t)) solves x'' + 2 zeta w x' + w^2 x = -(a + slope t).
        q = -slope / w**2
        p = -(a + 2 * zeta * w * q) / w**2
        c = complex(x - p, ((x - p) * root.real - (v - q)) / root.imag)

        def quantity(t, order, p=p, q=q, c=c):
            straight = (p + q * t, q, 0.0, 0.0)
            wave = c * root**order * np.exp(root * t)
            if kind != "absolute_acceleration":
                return straight[order] + wave.real
            line = 2 * zeta * w * straight[order + 1] + w**2 * straight[order]
            return -line - ((2 * zeta * w * root + w**2) * wave).real

        def zeros(at, order, quantity=quantity):
            values = quantity(at, order)
            turns = np.flatnonzero(values[1:] * values[:-1] < 0)
            low, high, sign = at[turns], at[turns + 1], np.sign(values[turns])
            for _ in range(24):
                middle = (low + high) / 2
                same = np.sign(quantity(middle, order)) == sign
                low, high = np.where(same, middle, low), np.where(same, high, middle)
            return (low + high) / 2

        at = np.linspace(0, h, int(np.ceil(h / period * 32)) + 8)
        # Between zeros of the second derivative there is at most one extreme.
        low = zeros(np.sort(np.concatenate([at, zeros(at, 2)])), 1)
        reached = quantity(np.concatenate([[0.0, h], low]), 0)
        found.append((reached.max(), -reached.min()))
        if part == len(values) - 2:
            primary = np.max(found, axis=0)
        end = c * np.exp(root * h)
        x, v = p + q * h + end.real, q + (root * end).real
    factor = w if kind == "pseudo_velocity" else 1.0
    return factor * np.maximum([*primary, *found[-1]], 0.0)


def extremes(found):
    return np.array([
        found.primary_positive, found.primary_negative, found.residual_positive,
        found.residual_negative,
    ])  # fmt: skip


def test_random_piecewise_linear_records_have_the_extremes_of_exact_solutions():
    """1000 records, equal and unequal steps, up to 40 periods per step, damping 0 to 0.99."""
    random = np.random.default_rng(20)
    worst = 0.0
    for case in range(1000):
        n = int(random.integers(2, 14))
        values = random.standard_normal(n) * 10.0 ** random.uniform(-3, 3)
        times = np.append(0.0, np.cumsum(random.uniform(0.1, 1.0, n - 1)))
        if case % 2:
            times = np.arange(n) * 0.1
        hz = 10.0 ** random.uniform(-2, 1.3, 1)
        zeta = float(random.choice([0.0, random.uniform(0, 0.2), random.uniform(0, 0.99)]))
        kind = KINDS[case % 3]
        record = values if case % 2 else vv.LoadTable(times=times, values=values)
        found = vv.shock_response_spectrum(
            record, hz, dt=0.1 if case % 2 else None, damping=zeta, kind=kind
        )
        wanted = np.array([exact(times, values, one, zeta, kind) for one in hz]).T
        worst = max(worst, (abs(extremes(found) - wanted) / wanted.max(axis=0)).max())
    assert worst < 1e-9


def test_long_records_find_the_extremes_between_their_samples():
    """Blocks of samples that cannot contain the extreme are skipped; the others are searched."""
    random = np.random.default_rng(4)
    t = np.arange(200)
    noise = random.standard_normal(t.size)
    pulse = np.exp(-(((t - 150) / 40) ** 2)) * np.sin(0.5 * t)
    hz = np.array([3e-3, 0.1, 0.3])
    for record in (noise, np.sin(0.4 * t), pulse):
        for zeta, kind in ((0.0, KINDS[0]), (0.3, KINDS[0]), (0.03, KINDS[1])):
            found = vv.shock_response_spectrum(record, hz, dt=1, damping=zeta, kind=kind)
            wanted = np.array([exact(t, record, one, zeta, kind) for one in hz]).T
            assert (abs(extremes(found) - wanted) / wanted.max(axis=0)).max() < 1e-9


@pytest.mark.parametrize(
    ("zeta", "hz", "acceleration", "displacement"),
    [
        # Half sine of height 1 and 11 ms: primary and residual, mpmath in closed form.
        (0.0, 10.0, (0.14736578157283706, 0.43504365105071374), 1.101978441513562e-4),
        (0.0, 500 / 11, (math.pi / 2, math.pi / 2), 1.9257748114119334e-5),
        (0.0, 63.0, (1.7473593201370092, 1.7151360969387193), 1.115170789649486e-5),
    ],
)
def test_half_sine_has_its_closed_form(zeta, hz, acceleration, displacement):
    shock = vv.LoadTable.half_sine(1.0, 0.011)
    found = vv.shock_response_spectrum(shock, [hz], damping=zeta)
    assert [found.primary[0], found.residual[0]] == pytest.approx(acceleration, rel=1e-9)
    moved = vv.shock_response_spectrum(shock, [hz], damping=zeta, kind="relative_displacement")
    rate = vv.shock_response_spectrum(shock, [hz], damping=zeta, kind="pseudo_velocity")
    assert moved.maximax[0] == pytest.approx(displacement, rel=1e-9)
    assert rate.maximax[0] == pytest.approx(displacement * 2 * math.pi * hz, rel=1e-9)


def test_values_in_g_differ_by_their_unit_alone():
    record = np.sin(np.pi * np.linspace(0, 1, 201))
    for kind, factor in zip(KINDS, (1.0, 9.80665, 9.80665), strict=True):
        in_si = vv.shock_response_spectrum(record, [40.0], dt=1e-4, kind=kind)
        in_g = vv.shock_response_spectrum(record, [40.0], dt=1e-4, kind=kind, unit="g")
        assert in_g.maximax == pytest.approx(factor * in_si.maximax, rel=1e-14)
    assert (in_si.unit, in_g.peak) == ("m/s", pytest.approx(9.80665))


def test_spectrum_of_a_run_is_that_of_its_absolute_acceleration():
    """Two masses in a row on a base: the second one is the oscillator of the spectrum."""
    hz, zeta = 7.0, 0.03
    w = 2 * np.pi * hz
    shock = vv.HalfSine(amplitude=30.0, duration=0.05)
    alone = vv.PolynomialSystem(mass=1.0, stiffness=900.0, damping=2.0, base_direction=[1.0])
    run = vv.simulate(alone, 1.5, base_acceleration=shock, dt=2e-4)
    found = vv.shock_response_spectrum(run, [hz], damping=zeta)
    tiny = 1e-9
    both = vv.PolynomialSystem(
        mass=np.diag([1.0, tiny]), base_direction=[1.0, 1.0],
        stiffness=[[900 + tiny * w**2, -tiny * w**2], [-tiny * w**2, tiny * w**2]],
        damping=[[2 + 2 * tiny * zeta * w, -2 * tiny * zeta * w],
                 [-2 * tiny * zeta * w, 2 * tiny * zeta * w]],
    )  # fmt: skip
    row = vv.simulate(both, 1.5, base_acceleration=shock, dt=2e-4)
    assert found.primary[0] == pytest.approx(np.abs(row.acceleration[:, 1]).max(), rel=1e-5)
    named = vv.shock_response_spectrum(row, [hz], coordinate="x1", damping=zeta)
    assert named.maximax == pytest.approx(found.maximax, rel=1e-6)
    with pytest.raises(vv.InputError, match="coordinate"):
        vv.shock_response_spectrum(row, [hz])
    with pytest.raises(vv.InputError, match="only a Trajectory has coordinates"):
        vv.shock_response_spectrum([0.0, 1.0], [hz], dt=1, coordinate="x1")


def test_result_is_saved_drawn_and_described(tmp_path):
    record = np.sin(np.pi * np.linspace(0, 1, 200))
    found = vv.shock_response_spectrum(
        record, np.geomspace(1, 1000, 30), dt=1e-4, kind="pseudo_velocity"
    )
    assert pickle.loads(pickle.dumps(found)) == found
    assert "pseudo velocity at 30 frequencies" in repr(found)
    data = found.to_dataset()
    assert data["maximax"].attrs["units"] == "m/s"
    assert np.array_equal(data["frequency"], found.frequencies)
    found.to_csv(tmp_path / "shock.csv")
    assert "primary_positive" in (tmp_path / "shock.csv").read_text()
    axis = found.plot()
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")
    texts = [one.get_text() for one in axis.texts]
    # Lines of constant displacement and of constant acceleration.
    assert any(one.endswith(" m") for one in texts)
    assert any(one.endswith(" m/s$^2$") for one in texts)
    plt.close("all")


def test_wrong_input_is_refused_in_a_line():
    ones, hz = np.sin(np.arange(30)), [1.0]
    for change, says in [
        ({"record": [1.0, math.nan]}, "record"),
        ({"record": [1.0]}, "record: must have shape"),
        ({"dt": None}, "dt: must be given"),
        ({"dt": 0.0}, "dt = 0: must be greater than 0"),
        ({"frequencies": [0.0]}, "must be greater than 0"),
        ({"frequencies": []}, "frequencies: must have shape"),
        ({"damping": 1.0}, "damping = 1: must be less than 1"),
        ({"damping": -0.1}, "damping = -0.1: must not be negative"),
        ({"kind": "velocity"}, "kind"),
        ({"unit": "ft/s^2"}, "unit"),
    ]:
        given = {"record": ones, "frequencies": hz, "dt": 0.1} | change
        with pytest.raises(vv.InputError, match=says):
            vv.shock_response_spectrum(given.pop("record"), given.pop("frequencies"), **given)
    with pytest.raises(vv.InputError, match="has its own times"):
        vv.shock_response_spectrum(vv.LoadTable.sawtooth(1.0, 0.1), hz, dt=0.1)


def test_a_doubtful_unit_and_an_offset_are_reported():
    t = np.linspace(0, 1, 1001)
    shock = 50 * np.exp(-(((t - 0.3) / 0.02) ** 2))
    vv.shock_response_spectrum(shock, [10.0], dt=1e-3)
    vv.shock_response_spectrum(np.sin(np.pi * t), [10.0], dt=1e-5)
    with pytest.warns(vv.RangeWarning, match=r"its peak is 5000 m/s\^2 = 509.858 g"):
        vv.shock_response_spectrum(100 * shock, [10.0], dt=1e-3)
    with pytest.warns(vv.RangeWarning, match=r"its peak is 4903.33 m/s\^2 = 500 g.*is in g"):
        vv.shock_response_spectrum(10 * shock, [10.0], dt=1e-3, unit="g")
    with pytest.warns(vv.RangeWarning, match=r"offset of 0.01 m/s\^2, with which the base drifts"):
        vv.shock_response_spectrum(shock + 0.01, [10.0], dt=1e-3)
