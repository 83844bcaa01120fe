"""Common format of the branch of the reference mount without memory, and its errors.

Problem M0: M u'' + C u' + K u + N(u) = (0.5 sin(nu t), 0) with M = diag(1, 0.1), C = 0.02 K and
N = (5/6 phi^3, 5/2 phi^2 x - 5/3 phi^3), nu from 0.5 to 10.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import root

DATA = Path(__file__).parents[1] / "data"
MASS = np.array([1.0, 0.1])
STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])


@dataclass(frozen=True)
class Branch:
    """Points nu (n,), first harmonics X with u = Im X exp(i nu t), (n, 2), folds if located."""

    nu: np.ndarray
    first: np.ndarray
    folds: np.ndarray | None

    def turns(self) -> np.ndarray:
        """Folds: as located, else by a quartic in the length through five points around each."""
        if self.folds is not None:
            return self.folds
        ends = np.flatnonzero(np.diff(np.sign(np.diff(self.nu))) != 0) + 1
        found = []
        for i in ends:
            near = slice(i - 2, i + 3)
            points = np.column_stack([self.nu[near], self.first[near].real, self.first[near].imag])
            length = np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()
            s = np.concatenate([[0.0], length]) - length[1]
            of_s = np.polynomial.Polynomial.fit(s, self.nu[near], 4)
            at = of_s.deriv().roots()
            at = at[np.abs(at.imag) < 1e-12].real
            found.append(float(of_s(at[np.abs(at).argmin()])))
        return np.array(found)


def folds() -> np.ndarray:
    """Folds of the branch with 13 digits, in the order of the branch."""
    found = json.loads((DATA / "mount_periodic_reference.json").read_text())
    return np.array([float(value) for value in found["folds_nu"]])


def fold_error(branch: Branch) -> float:
    """Largest error of the folds; NaN if there are not two folds."""
    found = branch.turns()
    return float(np.abs(found - folds()).max()) if found.size == 2 else np.nan


def periodic(nu: float, first: np.ndarray, highest: int = 41) -> np.ndarray:
    """First harmonics (2,) of the motion nearest to ``first``: many harmonics, solved by SciPy."""
    orders = np.arange(1, highest + 1, 2)
    n, samples = orders.size, 4 * (highest + 1)
    angle = np.outer(orders, 2 * np.pi * np.arange(samples) / samples)
    sin, cos = np.sin(angle), np.cos(angle)

    def residual(q: np.ndarray) -> np.ndarray:
        c = (q[: 2 * n] + 1j * q[2 * n :]).reshape(2, n)
        x, phi = c.real @ sin + c.imag @ cos
        pull = np.array([5 / 6 * phi**3, 2.5 * phi**2 * x - 5 / 3 * phi**3])
        out = (pull @ sin.T + 1j * pull @ cos.T) * 2 / samples
        out += (STIFFNESS @ c) * (1 + 0.02j * nu * orders)
        out -= MASS[:, None] * (nu * orders) ** 2 * c
        out[0, 0] -= 0.5
        return np.concatenate([out.real.ravel(), out.imag.ravel()])

    start = np.zeros((2, n), complex)
    start[:, 0] = first
    found = root(residual, np.concatenate([start.real.ravel(), start.imag.ravel()]), tol=1e-13)
    if np.abs(residual(found.x)).max() > 1e-11:
        return np.full(2, np.nan)
    c = (found.x[: 2 * n] + 1j * found.x[2 * n :]).reshape(2, n)
    return c[:, 0]


def amplitude_error(branch: Branch, points: int = 12) -> float:
    """Largest relative error of |X| at some points, at least 0.02 rad/s from the folds."""
    far = np.abs(branch.nu[:, None] - folds()).min(axis=1) > 0.02
    chosen = np.flatnonzero(far)
    chosen = chosen[np.linspace(0, chosen.size - 1, min(points, chosen.size)).astype(int)]
    worst = 0.0
    for i in chosen:
        exact = np.abs(periodic(float(branch.nu[i]), branch.first[i]))
        worst = max(worst, float(np.abs(np.abs(branch.first[i]) / exact - 1).max()))
    return worst
