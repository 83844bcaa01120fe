"""Prony terms for other programs: the numbers of the text have the stated error."""

import re

import numpy as np
import viscovib as vv


def test_terms_for_ls_dyna_meet_the_error_that_they_tell():
    """Regression: fields with four digits had a stated error of 4e-6 and a true error of 1.5e-4."""
    rng = np.random.default_rng(45)
    for _ in range(12):
        rubber = vv.RabotnovKernel(
            amplitude=rng.uniform(0.5, 2), alpha=rng.uniform(0.3, 0.7), beta=rng.uniform(2.5, 5)
        )
        modulus, first = 10 ** rng.uniform(3, 10), 10 ** rng.uniform(-5, 2)
        terms = vv.prony_terms(
            rubber, modulus=modulus, t_min=first, t_max=30 * first,
            tolerance=10 ** rng.uniform(-4, -1.5), quantity="G",
        )  # fmt: skip
        lines = terms.text("ls-dyna").splitlines()
        reported = float(re.search(r"error of the modulus (\S+)", lines[0])[1])
        fields = [(float(line[:10]), float(line[10:])) for line in lines[4:-1]]
        assert all(len(line) == 20 and line[10] == " " for line in lines[4:-1])
        nu = np.geomspace(1 / terms.t_max, 1 / terms.t_min, 200)
        written = sum(g * 1j * nu / (1j * nu + b) if b else g for g, b in fields)
        # The error is stated with two digits.
        assert np.abs(written / (modulus * (1 - rubber.transform(nu))) - 1).max() < 1.06 * reported
        assert reported < 1.5 * terms.error + 1e-4
