"""A steel plate of 1e5 coordinates with a hole, on four rubber mounts that harden.

    python docs/examples/plate_on_mounts.py [--elements 158] [--out out/plate]

The plate's elements are made here: the conforming rectangle of Bogner, Fox and Schmit (1965), in
each direction a beam's cubics; a node has w, w_x, w_y and w_xy.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array


class Plate(NamedTuple):
    """Matrices of a plate and where its nodes are."""

    mass: csc_array
    stiffness: csc_array
    #: Coordinate of w at node (i, j); -1 where the hole is.
    w: np.ndarray
    x: np.ndarray
    y: np.ndarray


def cubics(length: float) -> tuple[np.ndarray, ...]:
    """Integrals of h h, h' h', h'' h'' and h'' h over a beam element's four cubics."""
    at, weights = np.polynomial.legendre.leggauss(4)
    x, weights = (at + 1) / 2, weights / 2 * length
    h = length
    values = np.array(
        [1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2)]
    )
    slopes = np.array(
        [6 * x**2 - 6 * x, h * (1 - 4 * x + 3 * x**2), 6 * x - 6 * x**2, h * (3 * x**2 - 2 * x)]
    )
    bends = np.array([12 * x - 6, h * (6 * x - 4), 6 - 12 * x, h * (6 * x - 2)])
    slopes, bends = slopes / h, bends / h**2

    def integral(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        return (left * weights) @ right.T

    return (
        integral(values, values), integral(slopes, slopes), integral(bends, bends),
        integral(bends, values),
    )  # fmt: skip


def plate(
    n_x: int, n_y: int, *, length: float, width: float, thickness: float, young: float,
    density: float, poisson: float = 0.3, hole: tuple[float, float, float] | None = None,
) -> Plate:  # fmt: skip
    """Return a free plate of n_x x n_y elements; ``hole``: its centre x, y and its radius (m)."""
    x, y = np.linspace(0, length, n_x + 1), np.linspace(0, width, n_y + 1)
    a0, a1, a2, a = cubics(length / n_x)
    b0, b1, b2, b = cubics(width / n_y)
    rigidity = young * thickness**3 / 12 / (1 - poisson**2)
    bending = np.kron(a2, b0) + np.kron(a0, b2) + 2 * (1 - poisson) * np.kron(a1, b1)
    stiffness = rigidity * (bending + poisson * (np.kron(a, b.T) + np.kron(a.T, b)))
    mass = density * thickness * np.kron(a0, b0)

    i, j = (part.ravel() for part in np.meshgrid(np.arange(n_x), np.arange(n_y), indexing="ij"))
    if hole is not None:
        away = np.hypot((x[i] + x[i + 1]) / 2 - hole[0], (y[j] + y[j + 1]) / 2 - hole[1])
        i, j = i[away > hole[2]], j[away > hole[2]]
    # Coordinates of an element: value and slope at both ends in x, times the same in y.
    in_x = np.stack([2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 3], axis=1)
    in_y = np.stack([2 * j, 2 * j + 1, 2 * j + 2, 2 * j + 3], axis=1)
    places = (in_x[:, :, None] * (2 * n_y + 2) + in_y[:, None, :]).reshape(i.size, 16)
    used, places = np.unique(places, return_inverse=True)
    places = places.reshape(i.size, 16)
    rows, columns = np.repeat(places, 16, axis=1).ravel(), np.tile(places, (1, 16)).ravel()

    def assembled(element: np.ndarray) -> csc_array:
        entries = np.tile(element.ravel(), i.size)
        return csc_array((entries, (rows, columns)), shape=(used.size, used.size))

    grid = np.full((2 * n_x + 2, 2 * n_y + 2), -1)
    grid.ravel()[used] = np.arange(used.size)
    return Plate(assembled(mass), assembled(stiffness), grid[::2, ::2], x, y)
