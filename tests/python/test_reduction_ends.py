"""End of a reduction: refused only if its error is above the tolerance, with that error."""

from types import SimpleNamespace

import numpy as np
import pytest
from viscovib.systems.reduction import _enriched


class Errors:
    """Errors that decrease by a factor per vector to a floor; larger between check frequencies."""

    def __init__(self, floor, between):
        self.floor, self.between, self.left = floor, between, 1.0
        self.worst = np.nan
        self.basis = SimpleNamespace(vectors=np.zeros((50, 3)), add=self.add)

    def add(self, vectors):
        self.left *= 0.2
        self.basis.vectors = np.hstack([self.basis.vectors, vectors])

    def at(self, frequencies):
        size = max(self.left, self.floor) * (self.between if frequencies.size >= 50 else 1.0)
        return np.full(frequencies.size, size), np.zeros((50, 2))


@pytest.mark.parametrize("most", [8, 12, 1000])
@pytest.mark.parametrize("between", [1.0, 1.3])
@pytest.mark.parametrize("floor", [2e-4, 6e-4, 8.8e-4, 1.2e-3])
def test_a_refusal_names_an_error_above_the_tolerance(floor, between, most):
    estimate = Errors(floor, between)
    reached = _enriched(estimate, 0.0, 1.0, 1e-3, most)
    if reached:
        assert estimate.errors.max() <= 1e-3
    else:
        assert estimate.worst > 1e-3
    if most == 1000:
        assert reached == (floor * between <= 1e-3)
