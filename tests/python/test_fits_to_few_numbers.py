"""Fits to few numbers state large uncertainties; intervals have the stated coverage."""

import math
import warnings

import numpy as np
import pytest
import viscovib as vv


def test_intervals_of_series_hold_for_few_numbers():
    """With nearly as many terms as numbers, residuals do not determine the scatter."""
    rng = np.random.default_rng(3)
    held = []
    for i in range(45):
        nu = np.geomspace(0.1, 1e3, (2, 3, 4)[i % 3])
        shares, rates = rng.uniform(0.05, 0.4, 2), 10 ** rng.uniform(-0.5, 2.5, 2)
        rubber = vv.PronyKernel(weights=shares * rates, rates=rates)
        stiff = 2e6 * (1 - rubber.transform(nu))
        noise = 1 + 0.02 * rng.standard_normal((2, nu.size))
        data = vv.ModulusData(
            frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vv.ConvergenceWarning)
            fit = vv.fit_kernel(data, kind="prony")
        true = {"modulus": 2e6, "relaxed": 2e6 * (1 - shares.sum())}
        held += [low <= true[name] <= high for name, (low, high) in fit.interval.items()]
    assert np.mean(held) > 0.85


def test_series_that_take_all_numbers_say_so(tmp_path):
    data = vv.ModulusData(frequencies=[0.1, 1000.0], storage=[1.1, 1.9], loss=[0.1, 0.2])
    with pytest.warns(vv.ConvergenceWarning, match="4 numbers for 4 parts of the fit"):
        fit = vv.fit_kernel(data, kind="prony")
    assert fit.interval == {"modulus": (0, math.inf), "relaxed": (0, math.inf)}
    assert fit.unconstrained == ("modulus", "relaxed")
    assert all(map(math.isnan, fit.parameters.values()))
    with pytest.raises(vv.InputError, match="determine the scatter: must be more"):
        vv.propagate(fit, lambda sample: sample.modulus, samples=5)
    fit.to_json(tmp_path / "f.json")
    assert vv.read_fit(tmp_path / "f.json").interval == fit.interval


def test_kernels_of_as_many_numbers_as_parameters():
    stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform([0.1, 1e3]))
    data = vv.ModulusData(frequencies=[0.1, 1e3], storage=stiff.real, loss=stiff.imag)
    with pytest.warns(vv.ConvergenceWarning, match=r"modulus: 0 to inf; .*alpha: 0.01 to 1"):
        fit = vv.fit_kernel(data)
    assert len(fit.unconstrained) == 4
    with pytest.raises(vv.InputError, match="4 numbers for 4 parameters do not"):
        vv.propagate(fit, lambda sample: sample.modulus, samples=5)
