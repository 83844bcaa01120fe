"""Relaxation after a step of strain, sums of kernels, and kernels at a temperature."""

import math

import mpmath as mp
import numpy as np
import pytest
import viscovib as vv

MU = np.geomspace(1e-3, 1e3, 25)


def mittag_leffler(a, b, z):
    """E_{a,b}(-z) by its series, with as many digits as the terms require."""
    with mp.workdps(50 + int(z ** (1 / a))):
        total, power, n = mp.mpf(0), mp.mpf(1), 0
        while True:
            term = power * mp.rgamma(a * n + b)
            total += term
            power *= -z
            n += 1
            if n > 20 and abs(term) < mp.mpf(10) ** -30:
                return total


@pytest.mark.parametrize("alpha", [0.1, 0.5, 0.8, 0.97, 0.9999])
def test_rabotnov_relaxes_as_its_series_says(alpha):
    for z in (0.1, 0.4999, 0.5001, 1.5, 5.0):
        if z ** (1 / alpha) > 300:
            continue
        t = (z / 2.0) ** (1 / alpha)
        kernel = vv.RabotnovKernel(amplitude=1.8, alpha=alpha, beta=2.0)
        power = mp.mpf(t) ** mp.mpf(alpha)
        exact = 1 - mp.mpf(1.8) * power * mittag_leffler(
            mp.mpf(alpha), mp.mpf(alpha) + 1, 2 * power
        )
        assert kernel.relaxation(t) == pytest.approx(float(exact), abs=4e-15)


@pytest.mark.parametrize("alpha", [1e-3, 0.02, 0.5, 0.98])
def test_rabotnov_relaxes_alike_alone_and_among_others(alpha):
    kernel = vv.RabotnovKernel(amplitude=0.3, alpha=alpha, beta=0.5)
    t = np.geomspace(1e-30, 1e30, 41)
    together = kernel.relaxation(t)
    assert together == pytest.approx([float(kernel.relaxation(one)) for one in t], abs=1e-14)
    assert (np.diff(together) <= 1e-15).all()


@pytest.mark.parametrize("alpha", [0.01, 0.4, 1.0])
def test_rzhanitsyn_relaxes_as_the_incomplete_gamma_function_says(alpha):
    kernel = vv.RzhanitsynKernel(amplitude=0.5, alpha=alpha, beta=0.05)
    for z in (1e-8, 0.7, 1.999, 2.0, 9.0, 44.0, 60.0):
        a, b = mp.mpf(alpha), mp.mpf(0.05)
        exact = 1 - mp.mpf(0.5) * b**-a * mp.gammainc(a, 0, b * mp.mpf(z / 0.05))
        assert kernel.relaxation(z / 0.05) == pytest.approx(float(exact), rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("interpolation", ["linear", "exponential"])
def test_a_table_relaxes_by_the_areas_of_its_pieces(interpolation):
    times = np.array([0.0, 0.5, 0.6, 2.0, 7.0])
    table = vv.TabulatedKernel(
        times=times, values=[0.4, 0.3, 0.3, 0.1, 0.02], interpolation=interpolation
    )
    fine = np.linspace(0, 6.9, 100001)
    middle = (fine[1:] + fine[:-1]) / 2
    area = np.cumsum(table(middle)) * (fine[1] - fine[0])
    assert 1 - table.relaxation(fine[1:]) == pytest.approx(area, abs=1e-9)
    if interpolation == "linear":
        assert 1 - table.relaxation(1e3) == pytest.approx(table.integral, rel=1e-14)


@pytest.mark.parametrize("alpha", [0.81, 0.97, 0.985, 0.999, 1 - 1e-6])
def test_rabotnov_close_to_an_exponential_needs_no_more_terms_than_elsewhere(alpha):
    kernel = vv.RabotnovKernel(amplitude=0.3, alpha=alpha, beta=0.5)
    found = kernel.sum_of_exponentials(tolerance=1e-10, t_min=1e-3, t_max=1e5)
    assert found.error <= 1e-10
    assert found.rates.size < 180


def parts():
    return [
        vv.RabotnovKernel(amplitude=0.3, alpha=0.6, beta=1.5),
        vv.PronyKernel(weights=[0.01], rates=[0.05]),
        vv.RzhanitsynKernel(amplitude=0.03, alpha=0.2, beta=0.1),
        vv.TabulatedKernel(times=[0.0, 1.0, 3.0], values=[0.1, 0.05, 0.0]),
    ]


def test_a_sum_is_the_sum_of_its_parts_everywhere():
    total = vv.SumKernel(parts=[vv.SumKernel(parts=parts()[:2]), *parts()[2:]])
    assert len(total.parts) == 4
    s = np.array([0.3 + 2j, 5.0])
    for name, points in (("transform", MU), ("laplace", s), ("relaxation", MU), ("__call__", MU)):
        each = np.array([getattr(part, name)(points) for part in parts()])
        shift = len(parts()) - 1 if name == "relaxation" else 0
        assert getattr(total, name)(points) == pytest.approx(each.sum(axis=0) - shift, rel=1e-14)
    assert total.integral == pytest.approx(sum(part.integral for part in parts()), rel=1e-15)


def test_motion_with_a_sum_is_that_with_its_terms_joined():
    """Two sums of exponentials equal one sum with all terms, in every method."""
    one = vv.PronyKernel(weights=[0.2, 0.3], rates=[0.5, 4.0])
    other = vv.PronyKernel(weights=[0.05], rates=[0.1])
    joined = vv.PronyKernel(weights=[0.2, 0.3, 0.05], rates=[0.5, 4.0, 0.1])
    given = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
    a = vv.Mount(**given, kernel=vv.SumKernel(parts=[one, other]))
    b = vv.Mount(**given, kernel=joined)
    run = [vv.simulate(m, 10, load=0.5, nu=1.5, tolerance=1e-10).state[-1] for m in (a, b)]
    assert run[0] == pytest.approx(run[1], rel=1e-8)
    curve = [vv.trace_response(m, (0.8, 3.0), load=0.3) for m in (a, b)]
    assert curve[0].amplitude("x") == pytest.approx(curve[1].amplitude("x"), rel=1e-9)
    roots = [m.characteristic_roots().oscillatory for m in (a, b)]
    assert roots[0] == pytest.approx(roots[1], rel=1e-9)


def test_shift_laws():
    law = vv.Arrhenius(reference=20.0, activation_energy=80e3)
    assert law(20.0) == 1
    assert np.log(law(40.0)) == pytest.approx(80e3 / 8.31446261815324 * (1 / 313.15 - 1 / 293.15))
    with pytest.raises(vv.InputError, match=r"must be above reference - c2 = -81\.6"):
        vv.WLF(reference=20.0, c1=8.86, c2=101.6)(-90.0)
    with pytest.raises(vv.InputError, match="c1 = -1: must be greater than 0"):
        vv.WLF(reference=20.0, c1=-1.0, c2=101.6)
    with pytest.raises(vv.InputError, match=r"must be above -273\.15"):
        law(-300.0)
    rubber = vv.ThermalKernel(kernel=parts()[0], shift=law)
    with pytest.raises(vv.InputError, match="has a temperature already"):
        vv.ThermalKernel(kernel=rubber, shift=law)


@pytest.mark.parametrize("given", [[], "rubber", [1]])
def test_a_sum_of_nothing_is_refused(given):
    with pytest.raises(vv.InputError, match="parts"):
        vv.SumKernel(parts=given)


def singular_kernels(rng, count):
    """Weakly singular kernels with relaxed stiffnesses of 0.05 to 0.9 at a rate of 0.01."""
    for i in range(count):
        alpha, left = rng.uniform(0.02, 0.98), rng.uniform(0.05, 0.9)
        kind = (vv.RzhanitsynKernel, vv.RabotnovKernel, vv.AbelKernel)[i % 3]
        given = {"alpha": alpha} if kind is vv.AbelKernel else {"alpha": alpha, "beta": 0.01}
        size = abs(kind(amplitude=1.0, **given).transform(0.01))
        yield kind(amplitude=(1 - left) / size, **given)


def test_sums_of_exponentials_have_the_transform_of_the_kernel():
    """The part of the integral before t_min is included."""
    rng = np.random.default_rng(43)
    for kernel in singular_kernels(rng, 24):
        t_min, t_max = 10 ** rng.uniform(-9, -1), 10 ** rng.uniform(0.5, 3)
        tolerance = 10 ** rng.uniform(-11, -3)
        few = kernel.sum_of_exponentials(tolerance=tolerance, t_min=t_min, t_max=t_max)
        assert few.error <= tolerance
        assert few.transform_error <= few.error
        mu = np.exp(rng.uniform(np.log(1 / t_max), np.log(2 * np.pi / t_min), 30))
        exact = kernel.transform(mu)
        miss = np.abs(few.transform(mu) - exact)
        assert (miss <= (1.05 * few.error + 1e-14) * np.minimum(1, np.abs(exact))).all()
    total = vv.SumKernel(parts=parts()[:3])
    few = total.sum_of_exponentials(tolerance=1e-9, t_min=1e-4, t_max=100)
    assert few.transform(2.0) == pytest.approx(total.transform(2.0), rel=1e-9)


@pytest.mark.parametrize("t_min", [1e-3, 1e-8])
def test_motions_with_a_sum_of_exponentials_are_those_with_the_kernel(t_min):
    """Closed transform; in time the run that computes with the kernel itself."""
    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    few = kernel.sum_of_exponentials(tolerance=1e-8, t_min=t_min, t_max=100)
    one = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.01, kernel=few)
    nu = np.array([0.6, 0.8])
    hat = 0.048 * math.gamma(0.1) / (0.05 + 1j * nu) ** 0.1
    exact = np.abs(0.1 / (1 - hat - nu**2 + 0.01j * nu))
    found = vv.forced_response(one, nu, load=0.1, method="linear").amplitude("x")
    assert found == pytest.approx(exact, rel=1e-7)
    same = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.01, kernel=kernel)
    runs = [vv.simulate(s, 20, load=0.1, nu=0.6, dt=0.2).state for s in (one, same)]
    assert runs[0] == pytest.approx(runs[1], abs=1e-8)


def test_layers_with_very_fast_exponentials_have_no_defective_modes():
    """Also in time, without defective modes; reference: one spring as an element."""
    rng = np.random.default_rng(7)
    for kernel in singular_kernels(rng, 18):
        if kernel.integral >= 1:
            continue
        few = kernel.sum_of_exponentials(
            tolerance=1e-8, t_min=10 ** rng.uniform(-12, -7), t_max=100
        )
        n = int(rng.integers(1, 4))
        chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        extra = np.diag(rng.uniform(0, 1, n)) * rng.integers(0, 2)
        body = vv.Structure(
            mass=np.eye(n), stiffness=extra, layers=[(chain, few)], rayleigh=(0.01, 0)
        )
        run = vv.simulate(body, 4, load={"x1": 0.1}, nu=0.8, dt=0.1)
        free = np.array([-1j * 0.1 * np.eye(n)[0]]).T
        assert run.outcome == "completed"
        hat = complex(kernel.transform(0.8))
        whole = extra + chain * (1 - hat) + (0.8j * 0.01 - 0.64) * np.eye(n)
        steady = np.linalg.solve(whole, free)[0, 0]
        found = vv.forced_response(body, [0.8], load={"x1": 0.1}, method="linear")
        assert found.amplitude("x1")[0] == pytest.approx(abs(steady), rel=1e-6)
