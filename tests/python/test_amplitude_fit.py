"""Jenkins elements in parallel with a kernel, and static curves."""

import warnings

import numpy as np
import pytest
import viscovib as vv
from rubber_examples import KERNELS


def by_cycles(x, k, slip, n=200_001):
    """First harmonic of the force of a slider, integrated through three cycles."""
    t = np.linspace(0, 6 * np.pi, n)
    deflection, force = x * np.sin(t), np.zeros(n)
    step = k * np.diff(deflection)
    for i in range(1, n):
        force[i] = min(max(force[i - 1] + step[i - 1], -k * slip), k * slip)
    last = t >= 4 * np.pi
    wave = force[last] * np.exp(-1j * t[last])
    return 2j * np.mean(wave[:-1]) / x


@pytest.mark.parametrize("x", [0.5, 1.5, 4.0])
def test_the_first_harmonic_is_that_of_a_slider(x):
    found = vv.jenkins_stiffness(x, stiffness=3.0, slip=1.0)
    assert found == pytest.approx(by_cycles(x, 3.0, 1.0), abs=3e-4)


def stiffness(kernel, elements, noise=0.0, seed=0):
    nu, x = np.tile(np.geomspace(0.1, 1e3, 15), 5), np.repeat(np.geomspace(1e-4, 1e-2, 5), 15)
    k = 2e5 * (1 - kernel.transform(nu))
    for one, slip in elements:
        k = k + vv.jenkins_stiffness(x, stiffness=one, slip=slip)
    scatter = 1 + noise * np.random.default_rng(seed).standard_normal((2, nu.size))
    return vv.ModulusData(
        frequencies=nu,
        storage=k.real * scatter[0],
        loss=k.imag * scatter[1],
        amplitude=x,
        quantity="K",
    )


@pytest.mark.parametrize("kind", ["rabotnov", "rzhanitsyn"])
@pytest.mark.parametrize("elements", [[(1e5, 3e-4)], [(1e5, 3e-4), (4e4, 3e-3)]])
def test_elements_come_back(kind, elements):
    data = stiffness(KERNELS[kind], elements)
    fit = vv.fit_amplitude(data, kind=kind, elements=len(elements))
    assert fit.stiffness == pytest.approx([k for k, _ in elements], rel=1e-6)
    assert fit.slip == pytest.approx([s for _, s in elements], rel=1e-6)
    assert fit.modulus == pytest.approx(2e5, rel=1e-6)
    said = fit.predict(data.frequencies, data.amplitude)
    assert said == pytest.approx(data.modulus, rel=1e-7)


def test_intervals_hold_the_truth():
    inside = 0
    for seed in range(30):
        data = stiffness(KERNELS["rabotnov"], [(1e5, 3e-4)], 0.01, seed)
        fit = vv.fit_amplitude(data)
        for name, true in (("stiffness_1", 1e5), ("slip_1", 3e-4)):
            low, high = fit.interval[name]
            inside += low <= true <= high
    assert 51 <= inside <= 60


@pytest.mark.parametrize(
    ("elements", "loose"),
    [
        ([(1e5, 3.6e-4), (1e5, 8e-4)], 2),
        ([(1e5, 3.6e-4), (1e5, 2e-2)], 1),
        ([(1e5, 2e-4), (5e4, 8e-4)], 0),
    ],
)
def test_elements_that_amplitudes_do_not_tell_are_reported(elements, loose):
    """Their intervals are unbounded, because the data do not determine them."""
    data = stiffness(KERNELS["rabotnov"], elements, 0.003, 1)
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter("always")
        fit = vv.fit_amplitude(data, elements=2)
    assert len(fit.unconstrained) == 2 * loose
    assert bool(reported) == bool(loose)
    assert all(fit.interval[name] == (0, np.inf) for name in fit.unconstrained)
    if loose == 1:
        # A spring that never slips is part of the modulus: no element represents it.
        return
    for i, pair in enumerate(elements):
        for name, true in zip(("stiffness", "slip"), pair, strict=True):
            low, high = fit.interval[f"{name}_{i + 1}"]
            assert low <= true <= high


@pytest.mark.parametrize(
    ("t", "d", "message"),
    [
        ([30, 40, 50], [3, 2, 1], r"decades\[1\] = 2 at 40 deg C: must be below 0 above the ref"),
        ([0, 20, 40], [-1, 0, 1], r"do not fall with temperature \(-1 at 0 deg C, 1 at 40\)"),
        ([20, 20, 20], [0, 0, 0], "temperatures: are all equal to the reference, 20 deg C"),
    ],
)
@pytest.mark.parametrize("law", ["wlf", "arrhenius"])
def test_a_refused_shift_law_says_what_is_wrong(t, d, message, law):
    with pytest.raises(vv.InputError, match=message):
        vv.fit_shift_law(t, d, law=law, reference=20)


def test_static_curves():
    d = np.linspace(-3e-3, 5e-3, 31)
    force = 1e5 * d + 2e7 * d**2 + 4e9 * d**3
    found = vv.fit_progressive(d, force, odd=False)
    assert found.stiffness == pytest.approx(1e5)
    assert found.parameters == pytest.approx({"k2": 2e7, "k3": 4e9})
    assert found.residual < 1e-12
    with pytest.raises(vv.InputError, match="the fitted force decreases at a deflection"):
        vv.fit_progressive(d, -1e3 * d + 4e9 * d**3)


def test_what_is_refused():
    nu = np.geomspace(1, 10, 5)
    given = {"frequencies": nu, "storage": nu + 1, "loss": nu}
    with pytest.raises(vv.InputError, match="has no amplitudes"):
        vv.fit_amplitude(vv.ModulusData(**given))
    with pytest.raises(vv.InputError, match=r"only one amplitude, 0\.001 m"):
        vv.fit_amplitude(vv.ModulusData(**given, amplitude=1e-3))
    with pytest.raises(vv.InputError, match="slip = -1"):
        vv.jenkins_stiffness(1.0, stiffness=1.0, slip=-1.0)


def test_rubber_that_softens_is_a_kernel_with_sliders():
    """With heavy masses the motion is a sine; load/motion is the kernel part plus Caughey's sum."""
    kernel = vv.RabotnovKernel(amplitude=1.5, alpha=0.5, beta=2.5)
    slips, springs = np.geomspace(1e-4, 3e-3, 6), np.full(6, 0.16)
    elements = [
        vv.Spring(on="x1", stiffness=1.0, kernel=kernel),
        vv.Iwan(on="x1", stiffness=springs, limit=springs * slips),
    ]
    for nu in (0.1, 10.0):
        heavy = vv.Structure(mass=[300 / nu**2], stiffness=[[0.0]], elements=elements)
        for amplitude in (5e-5, 7e-4, 1e-2):
            turn = np.arccos(1 - 2 * np.minimum(1, slips / amplitude))
            sliders = springs / np.pi * (turn - np.sin(2 * turn) / 2 + 1j * np.sin(turn) ** 2)
            total = 1 - kernel.transform(nu) + sliders.sum()
            load = abs(total - 300) * amplitude
            found = vv.forced_response(
                heavy, [nu], load=[load], method="newton", harmonics=11, tolerance=1e-2
            )
            c = found.coefficients[0, 0, list(found.harmonics).index(1)]
            assert abs(load / c + 300 - total) < 2e-5
