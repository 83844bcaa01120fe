"""Reference tables of the mount's steady response: an own harmonic balance in 30 digits.

Nothing here is shared with the library. Equations: seed paper 001 corrected (docs/explanation),

    m x''   + (1-R_x*)[c_x (x - l phi) + c_x l/6 phi^3] + (C u')_1 = load
    I phi'' + (1-R_x*)[-c_x l x + c_x l^2 phi + c_x l/2 phi^2 x - 2/3 c_x l^2 phi^3]
            + (1-R_phi*) c_phi phi + (C u')_2 = 0                                (cubic),

`printed` with the paper's cubic terms, `exact` with f_x = c_x (1-R_x*)(x - l sin phi) and
I phi'' = l cos(phi) f_x - f_phi. Powers are taken by convolution of Fourier coefficients, which is
Galerkin's projection without any sampling (exact: 160 samples, and the deflection keeps the
orders that the motion keeps). The truncated
equations are solved by Newton's method in double precision and refined in 30 digits with that
Jacobian. Convention u = Im sum_k X_k exp(i k nu t).
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path

import mpmath as mp
import numpy as np

mp.mp.dps = 36
C_X, C_PHI, ARM, MASS, INERTIA = 10.0, 2.0, 0.5, 1.0, 0.1
SAMPLES = 160


@dataclass
class Problem:
    """One set of parameters; kernels are (A, alpha, beta)."""

    geometry: str
    kernel_x: tuple
    kernel_phi: tuple
    nu: float
    load: dict
    orders: list
    damping: tuple = ((0.0, 0.0), (0.0, 0.0))
    retained: dict = field(default_factory=dict)

    def __post_init__(self):
        for k in self.orders:
            pair = []
            for a, alpha, beta in (self.kernel_x, self.kernel_phi):
                s = mp.mpf(beta) + mp.mpc(0, k * mp.mpf(self.nu))
                pair.append(1 - mp.mpf(a) * mp.gamma(mp.mpf(alpha)) * s ** (-mp.mpf(alpha)))
            self.retained[k] = pair


def residual(problem, unknowns, number):
    """Return D X + N(X) - P, a complex number an order and coordinate.

    `number` converts to the arithmetic wanted (mp.mpc or complex).
    """
    orders = problem.orders
    n = len(orders)
    x = dict(zip(orders, unknowns[:n], strict=True))
    phi = dict(zip(orders, unknowns[n:], strict=True))
    real = mp.mpf if number is mp.mpc else float
    c_x, c_phi, arm = real(C_X), real(C_PHI), real(ARM)
    keep = {k: [number(r) for r in problem.retained[k]] for k in orders}
    if problem.geometry == "exact":
        force, moment = exact_forces(problem, x, phi, keep, real, number)
    else:
        square = product(two_sided(phi, number), two_sided(phi, number))
        cube = one_sided(product(square, two_sided(phi, number)), orders, number)
        mixed = one_sided(product(square, two_sided(x, number)), orders, number)
        if problem.geometry == "cubic":
            a, b, c = c_x * arm / 6, c_x * arm / 2, -2 * c_x * arm**2 / 3
        else:
            a, b, c = -c_x * arm / 6, -c_x * arm / 2, -8 * c_x * arm**2 / 6
        force = {k: keep[k][0] * (c_x * (x[k] - arm * phi[k]) + a * cube[k]) for k in orders}
        moment = {
            k: keep[k][0] * (-c_x * arm * x[k] + c_x * arm**2 * phi[k] + b * mixed[k] + c * cube[k])
            + keep[k][1] * c_phi * phi[k]
            for k in orders
        }
    rows = []
    nu = real(problem.nu)
    for d, (inertia, forces, own) in enumerate(((MASS, force, x), (INERTIA, moment, phi))):
        for k in orders:
            load = number(problem.load.get(k, 0)) if d == 0 else 0
            viscous = sum(real(c) * u[k] for c, u in zip(problem.damping[d], (x, phi), strict=True))
            rows.append(
                forces[k]
                - (k * nu) ** 2 * real(inertia) * own[k]
                + number(0, 1) * k * nu * viscous
                - load
            )
    return rows


def two_sided(u, number):
    """Coefficients c_k of u = sum_k c_k exp(i k theta) over all k."""
    c = {}
    for k, value in u.items():
        if k == 0:
            c[0] = number(value.imag)
        else:
            c[k] = value / number(0, 2)
            c[-k] = c[k].conjugate()
    return c


def product(a, b):
    """Convolve."""
    c = {}
    for i, u in a.items():
        for j, v in b.items():
            c[i + j] = c.get(i + j, 0) + u * v
    return c


def one_sided(c, orders, number):
    """Back to X_k of the kept orders."""
    return {k: number(0, 1) * c[0].real if k == 0 else c[k] * number(0, 2) for k in orders}


def exact_forces(problem, x, phi, keep, real, number):
    """Forces of the full geometry, from samples of a period."""
    orders, c_x, c_phi, arm = problem.orders, real(C_X), real(C_PHI), real(ARM)
    sin, cos, exp = (mp.sin, mp.cos, mp.exp) if number is mp.mpc else (np.sin, np.cos, np.exp)
    pi = mp.pi if number is mp.mpc else np.pi
    root = [exp(number(0, 1) * 2 * pi * j / SAMPLES) for j in range(SAMPLES)]

    def at(u, j):
        return sum((u[k] * root[k * j % SAMPLES] for k in orders), number(0)).imag

    # The deflection keeps the same orders as the motion.
    angle = [at(phi, j) for j in range(SAMPLES)]
    bent = transform([sin(a) for a in angle], orders, root, number)
    spring = {k: keep[k][0] * c_x * (x[k] - arm * bent[k]) for k in orders}
    force = [at(spring, j) for j in range(SAMPLES)]
    turning = transform(
        [-arm * cos(a) * f for a, f in zip(angle, force, strict=True)], orders, root, number
    )
    moment = {k: turning[k] + keep[k][1] * c_phi * phi[k] for k in orders}
    return spring, moment


def transform(samples, orders, root, number):
    """X_k of samples of a period."""
    result = {}
    for k in orders:
        c = sum((v * root[-k * j % SAMPLES] for j, v in enumerate(samples)), number(0)) / SAMPLES
        result[k] = number(0, 1) * c.real if k == 0 else number(0, 2) * c
    return result


def stiffness(problem, k):
    """Dynamic stiffness of order k in double precision."""
    r_x, r_phi = (complex(r) for r in problem.retained[k])
    in_x = C_X * np.array([[1, -ARM], [-ARM, ARM**2]])
    in_phi = C_PHI * np.diag([0.0, 1.0])
    mass = np.diag([MASS, INERTIA])
    w = k * problem.nu
    return in_x * r_x + in_phi * r_phi - w**2 * mass + 1j * w * np.array(problem.damping)


def successive(problem):
    """Fixed point iteration from the linear response; None where it is not a clear contraction."""
    n = len(problem.orders)
    inverse = [np.linalg.inv(stiffness(problem, k)) for k in problem.orders]
    unknowns = np.zeros(2 * n, dtype=complex)
    for i, k in enumerate(problem.orders):
        unknowns[[i, n + i]] = inverse[i] @ [problem.load.get(k, 0), 0]
    sizes = []
    for _ in range(120):
        rest = np.array(residual(problem, list(unknowns), complex))
        step = np.array([inverse[i] @ rest[[i, n + i]] for i in range(n)])
        unknowns -= np.concatenate([step[:, 0], step[:, 1]])
        sizes.append(np.abs(step).max() / np.abs(unknowns).max())
        if not sizes[-1] < 10:
            return None
        if sizes[-1] < 1e-9:
            break
    steps = len(sizes)
    if sizes[-1] > 1e-9 or (steps > 3 and (sizes[-1] / sizes[1]) ** (1 / (steps - 2)) > 0.85):
        return None
    return unknowns


def refine(problem, start):
    """Newton in double precision, then with the same Jacobian in 30 digits."""
    size = 2 * start.size

    def split(z):
        return np.concatenate([np.real(z), np.imag(z)])

    jacobian = np.empty((size, size))
    for j in range(size):
        step = np.zeros(size)
        step[j] = 1e-6
        values = [
            np.array(
                residual(
                    problem,
                    list(start + sign * (step[: size // 2] + 1j * step[size // 2 :])),
                    complex,
                )
            )
            for sign in (1, -1)
        ]
        jacobian[:, j] = split(values[0] - values[1]) / 2e-6
    # A mean has no real part: its equation is void.
    void = np.flatnonzero(np.abs(jacobian).max(axis=0) == 0)
    jacobian[void, void] = 1.0
    inverse = np.linalg.inv(jacobian)
    unknowns = [mp.mpc(complex(u)) for u in start]
    for _ in range(12):
        rest = residual(problem, unknowns, mp.mpc)
        largest = max(abs(r) for r in rest)
        if largest < mp.mpf(10) ** -29:
            return unknowns
        scaled = np.array([complex(r / largest) for r in rest])
        step = inverse @ split(scaled)
        half = size // 2
        unknowns = [u - largest * mp.mpc(step[i], step[half + i]) for i, u in enumerate(unknowns)]
    raise ArithmeticError(f"no convergence: {problem}")


def row(problem, unknowns):
    """Numbers of one row: re and im of x_k, then of phi_k."""
    numbers = [mp.nstr(part, 20) for u in unknowns for part in (u.real, u.imag)]
    return ",".join([f"{problem.nu!r}", *numbers])


def columns(orders):
    """Names of the columns of `row`."""
    return "nu," + ",".join(
        f"{d}_{k}_{p}" for d in ("x", "phi") for k in orders for p in ("re", "im")
    )


HEADER = """# {what}
# m = 1, I = 0.1, l = 0.5, c_x = 10, c_phi = 2; u = Im sum_k X_k exp(i k nu t)
# by data/programs/mount_harmonic_balance.py, 20 digits; all numbers are exact doubles where given
"""
ODD = [1, 3, 5, 7, 9]


def paper_table(path, points):
    """The five kernels of the paper, all geometries, where successive approximations converge."""
    with open(path, "w", encoding="utf-8") as file:
        file.write(HEADER.format(what="odd harmonics 1..9; kernel A, alpha = 0.1, beta = 0.05"))
        file.write("geometry,A,P," + columns(ODD) + "\n")
        for geometry in ("cubic", "printed", "exact"):
            for a, load in (
                (0.078, 0.1),
                (0.048, 0.1),
                (0.03, 0.1),
                (0.02, 0.1),
                (0.015, 0.1),
                (0.078, 0.5),
                (0.048, 0.5),
            ):
                for nu in np.linspace(0.3, 12.0, points):
                    kernel = (a, 0.1, 0.05)
                    problem = Problem(geometry, kernel, kernel, float(nu), {1: load}, ODD)
                    start = successive(problem)
                    if start is not None:
                        file.write(f"{geometry},{a},{load},")
                        file.write(row(problem, refine(problem, start)) + "\n")


def two_kernel_table(path, points):
    """Different kernels for x and phi, and viscous damping."""
    damping = ((0.2, 0.05), (0.05, 0.03))
    with open(path, "w", encoding="utf-8") as file:
        file.write(
            HEADER.format(
                what="odd harmonics 1..9; kernels (A, alpha, beta) = (0.048, 0.1, 0.05) in x, "
                "(0.02, 0.3, 0.1) in phi; C = (0.2, 0.05; 0.05, 0.03); load 0.2 on x"
            )
        )
        file.write("geometry," + columns(ODD) + "\n")
        for geometry in ("cubic", "printed", "exact"):
            for nu in np.linspace(0.3, 12.0, points):
                problem = Problem(
                    geometry,
                    (0.048, 0.1, 0.05),
                    (0.02, 0.3, 0.1),
                    float(nu),
                    {1: 0.2},
                    ODD,
                    damping,
                )
                start = successive(problem)
                if start is not None:
                    file.write(f"{geometry}," + row(problem, refine(problem, start)) + "\n")


def full_set_table(path, points):
    """A load with a mean and an even harmonic: orders 0..9."""
    orders = list(range(10))
    load = {0: 0.02j, 1: 0.1, 2: 0.03 + 0.01j}
    kernel = (0.048, 0.1, 0.05)
    with open(path, "w", encoding="utf-8") as file:
        file.write(
            HEADER.format(
                what="harmonics 0..9 (mean = Im X_0); kernel A = 0.048, alpha = 0.1, beta = 0.05; "
                "load on x: mean 0.02, P_1 = 0.1, P_2 = 0.03 + 0.01i"
            )
        )
        file.write("geometry," + columns(orders) + "\n")
        for geometry in ("cubic", "printed", "exact"):
            for nu in np.linspace(0.5, 9.5, points):
                problem = Problem(geometry, kernel, kernel, float(nu), load, orders)
                start = successive(problem)
                if start is not None:
                    file.write(f"{geometry}," + row(problem, refine(problem, start)) + "\n")


def linear_table(path, points):
    """First harmonic of the linear response."""
    with open(path, "w", encoding="utf-8") as file:
        file.write(
            HEADER.format(what="linear response to 0.1 sin(nu t) on x; alpha = 0.1, beta = 0.05")
        )
        file.write("A," + columns([1]) + "\n")
        for a in (0.078, 0.048, 0.03, 0.02, 0.015):
            for nu in np.linspace(0.3, 12.0, points):
                problem = Problem("cubic", (a, 0.1, 0.05), (a, 0.1, 0.05), float(nu), {1: 0.1}, [1])
                r = problem.retained[1][0]
                c_x, c_phi, arm = mp.mpf(C_X), mp.mpf(C_PHI), mp.mpf(ARM)
                w = mp.mpf(float(nu)) ** 2
                d = mp.matrix(
                    [
                        [c_x * r - w * mp.mpf(MASS), -c_x * arm * r],
                        [-c_x * arm * r, (c_x * arm**2 + c_phi) * r - w * mp.mpf(INERTIA)],
                    ]
                )
                det = d[0, 0] * d[1, 1] - d[0, 1] ** 2
                load = mp.mpf(0.1)
                solution = [load * d[1, 1] / det, -load * d[0, 1] / det]
                file.write(f"{a}," + row(problem, solution) + "\n")


def main():
    """Write all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1])
    out = parser.parse_args().out
    linear_table(out / "mount_curves.csv", 200)
    paper_table(out / "mount_response_h9.csv", 21)
    two_kernel_table(out / "mount_response_two_kernels.csv", 13)
    full_set_table(out / "mount_response_full_set.csv", 10)


if __name__ == "__main__":
    main()
