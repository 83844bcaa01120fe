"""A steel plate of 1e5 coordinates with a hole, on four rubber mounts that harden.

    python docs/examples/plate_on_mounts.py [--elements 158] [--out out/plate]

The plate's elements are made here: the conforming rectangle of Bogner, Fox and Schmit (1965), in
each direction a beam's cubics; a node has w, w_x, w_y and w_xy.
"""

import argparse
import resource
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import viscovib as vv
from scipy.sparse import csc_array

#: Edge and thickness (m), where the hole is, and where the mounts are, as parts of the edge.
EDGE, THICKNESS, HOLE = 1.2, 0.01, (0.75, 0.7, 0.18)
MOUNTS = ((0.1, 0.1), (0.1, 0.9), (0.9, 0.1), (0.9, 0.9))
#: Band of the load (rad/s), and the highest frequency for which displacements are wanted.
BAND, TOP = (2 * np.pi * 11, 2 * np.pi * 18), 2 * np.pi * 400


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


def mounted(elements: int) -> tuple[vv.Structure, Plate, str]:
    """Return a plate on four rubber mounts, its mesh, and the coordinate that the load pushes."""
    steel = plate(
        elements, elements, length=EDGE, width=EDGE, thickness=THICKNESS, young=2.05e11,
        density=7800.0, hole=HOLE,
    )  # fmt: skip
    rubber = vv.RabotnovKernel(amplitude=4.0, alpha=0.55, beta=16.0)

    def name(x: float, y: float) -> str:
        return f"x{steel.w[round(x * elements), round(y * elements)] + 1}"

    mounts = [
        vv.Spring(on=name(*at), stiffness=3e5, law="k3*d^3", parameters={"k3": 4e11}, kernel=rubber)
        for at in MOUNTS
    ]
    structure = vv.Structure(
        mass=steel.mass, stiffness=steel.stiffness, rayleigh=(0.5, 2e-6), elements=mounts
    )
    return structure, steel, name(0.3, 0.4)


def main() -> None:
    """Reduce, follow a curve, check it against the full equations, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--elements", type=int, default=160, help="along each edge")
    parser.add_argument("--out", type=Path, default=Path("out/plate"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    structure, steel, pushed = mounted(options.elements)
    print(f"{structure.n_coordinates} coordinates, made in {time.perf_counter() - begun:.1f} s")

    begun = time.perf_counter()
    small = structure.reduce(frequency=TOP, tolerance=1e-6, loads=[pushed])
    taken = time.perf_counter() - begun
    found = small.reduction
    print(
        f"reduced to {found.n_modes} modes and {found.squares.size - found.n_modes} corrections in "
        f"{taken:.1f} s; error at 50 frequencies up to {TOP:.0f} rad/s at most "
        f"{found.largest_error:.1e}"
    )
    begun = time.perf_counter()
    branch = vv.trace_response(
        small, BAND, load={pushed: 30.0}, coordinates=[pushed], stability=False, tolerance=1e-6
    )
    taken = time.perf_counter() - begun
    print(branch.summary())
    print(f"in {1e3 * taken:.0f} ms; error of the reduction {branch.reduction_error.max():.1e}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"memory {peak:.2f} GB")

    begun = time.perf_counter()
    checked = branch.check(points=5)
    print(
        f"direct solutions of the full equations at 5 motions differ by {checked.max():.1e} "
        f"({time.perf_counter() - begun:.0f} s)"
    )
    draw(branch, steel, pushed, options.out / "plate.png")


def draw(branch: vv.Branch, steel: Plate, pushed: str, path: Path) -> None:
    """Draw the curve, and how the plate moves at its highest point."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    hertz = branch.nu / (2 * np.pi)
    amplitude = 1e3 * branch.amplitude(pushed)
    at = int(amplitude.argmax())
    places = steel.w >= 0
    moved = branch.at([f"x{i + 1}" for i in steel.w[places]])
    shape = np.full(steel.w.shape, np.nan)
    shape[places] = 1e3 * np.abs(moved.coefficients[at, :, 0])
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    left.plot(hertz, amplitude, color="C0")
    left.plot(hertz[at], amplitude[at], "o", color="C1")
    left.set(xlabel="frequency (Hz)", ylabel="first harmonic where it is pushed (mm)")
    left.set_title("harmonic balance of four mounts")
    mesh = right.pcolormesh(steel.x, steel.y, shape.T, shading="gouraud", cmap="viridis")
    figure.colorbar(mesh, ax=right, label="first harmonic (mm)")
    mounts = np.array(MOUNTS) * EDGE
    right.plot(*mounts.T, "s", color="white", markeredgecolor="black", label="mounts")
    right.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    right.set_title(f"the plate at {hertz[at]:.1f} Hz")
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False)
    figure.savefig(path, dpi=120)
    print(path)


if __name__ == "__main__":
    main()
