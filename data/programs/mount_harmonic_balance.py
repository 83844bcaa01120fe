"""Steady forced response of the mount: harmonic balance by Newton, 34 digits.

Equations (seed paper 001, corrected; u = (x, phi), (R*g)(t) = int_0^t R(t-s) g(s) ds,
R(t) = A exp(-beta t) t^(alpha-1), its transform Rhat(mu) = A Gamma(alpha) (beta + i mu)^(-alpha)):

    m x''   + C_1 u' + (1-R_x*)[c_x (x - l phi) + n_1]                              = load
    I phi'' + C_2 u' + (1-R_x*)[-c_x l (x - l phi) + n_2] + (1-R_phi*)[c_phi phi]   = 0

    cubic    n_1 =  c_x l/6 phi^3,  n_2 =  c_x l/2 phi^2 x - 2/3 c_x l^2 phi^3
    printed  n_1 = -c_x l/6 phi^3,  n_2 = -c_x l/2 phi^2 x - 8/6 c_x l^2 phi^3   (signs of the print)
    exact    f_x = c_x (1-R_x*)[x - l sin phi];  m x'' + C_1 u' + f_x = load,
             I phi'' + C_2 u' - l cos(phi) f_x + (1-R_phi*)[c_phi phi] = 0

u(t) = Im sum_k X_k exp(i k nu t), the load on x likewise; a mean value is X_0 = i mean.
The sum is truncated to the given orders and the residual is projected on the same orders (Galerkin).
With 64 samples of a period the projection of cubic and printed is free of aliasing. In `exact`
the spring force is kept with all its harmonics (0..31), not only with those of the unknowns;
128 samples change nothing down to 1e-26.

Every number a computer would read as a double is taken as that double.
"""

import argparse
import json
from functools import lru_cache
from pathlib import Path

import mpmath as mp
import numpy as np

mp.mp.dps = 34

GEOMETRIES = ("cubic", "printed", "exact")
REFERENCE = dict(m=1.0, l=0.5, I=0.1, c_x=10.0, c_phi=2.0)
ALPHA, BETA = 0.1, 0.05
AMPLITUDES = (0.078, 0.048, 0.030, 0.020, 0.015)
NU = (0.3, 0.5, 0.7, 0.9, 1.0, 1.1, 1.3, 1.5, 1.7, 1.9, 2.1, 2.4, 2.8, 3.3, 3.9,
      4.4, 4.8, 5.2, 5.6, 6.0, 6.5, 7.5, 9.0, 12.0)
ODD = (1, 3, 5, 7, 9)
FULL = tuple(range(10))
RATE_LIMIT = 0.85  # rows are kept where the successive approximations converge faster than this

to_float = np.vectorize(float, otypes=[float])
to_mp = np.vectorize(mp.mpf, otypes=[object])
mp_sin = np.frompyfunc(mp.sin, 1, 1)
mp_cos = np.frompyfunc(mp.cos, 1, 1)


def rhat(kernel, mu):
    """Transform of the Koltunov-Rzhanitsyn kernel (A, alpha, beta), R_c - i R_s, at mu >= 0."""
    amplitude, alpha, beta = map(mp.mpf, kernel)
    return amplitude * mp.gamma(alpha) * mp.power(mp.mpc(beta, mu), -alpha)


@lru_cache(maxsize=None)
def waves(orders, samples):
    """sin(k theta_j), cos(k theta_j) over one period, and the weights of the projection."""
    turn = [2 * mp.pi * j / samples for j in range(samples)]
    sin = np.array([[mp.sin(turn[k * j % samples]) for j in range(samples)] for k in orders], dtype=object)
    cos = np.array([[mp.cos(turn[k * j % samples]) for j in range(samples)] for k in orders], dtype=object)
    weight = np.array([mp.mpf(1 if k == 0 else 2) / samples for k in orders], dtype=object)
    return sin, cos, weight


class Balance:
    """The residual of the harmonic balance; X is real with shape (re/im, coordinate, order).

    The same code runs on doubles, on complex doubles (complex-step Jacobian) and on mpf objects.
    """

    def __init__(self, geometry, nu, load, kernels, orders, damping=None, samples=None, force_orders=None,
                 par=REFERENCE, digits="double"):
        self.geometry = geometry
        self.par = {name: mp.mpf(value) for name, value in par.items()}
        m, l, inertia, c_x, c_phi = (self.par[name] for name in ("m", "l", "I", "c_x", "c_phi"))
        samples = samples or max(64, 4 * max(orders) + 4)
        self.force_orders = force_orders or tuple(range(samples // 2))
        mu = [k * mp.mpf(nu) for k in orders]
        c = to_mp(np.zeros((2, 2)) if damping is None else damping)

        q_x, q_phi = ([1 - rhat(kernel, w) for w in mu] for kernel in kernels)
        z = np.array([[[1j * w * c[i, j] - (w**2 * (m, inertia)[i] if i == j else 0) for w in mu]
                       for j in (0, 1)] for i in (0, 1)], dtype=object)
        k_x = c_x * np.array([[1, -l], [-l, l**2]], dtype=object)
        stiffness = k_x[:, :, None] * np.array(q_x, dtype=object)
        stiffness[1, 1] = stiffness[1, 1] + c_phi * np.array(q_phi, dtype=object)
        if geometry == "exact":  # the spring c_x enters through its force, c_phi through z
            z[1, 1] = z[1, 1] + c_phi * np.array(q_phi, dtype=object)
        else:
            z = z + stiffness
        dynamic = z + k_x[:, :, None] * np.array(q_x, dtype=object) if geometry == "exact" else z

        if geometry == "exact":
            q = [1 - rhat(kernels[0], k * mp.mpf(nu)) for k in self.force_orders]
        else:
            q = q_x
        if geometry == "cubic":
            gain = (c_x * l / 6, c_x * l / 2, -2 * c_x * l**2 / 3)
        else:
            gain = (-c_x * l / 6, -c_x * l / 2, -4 * c_x * l**2 / 3)

        self.load = to_mp(np.zeros((2, 2, len(orders))))
        for k, value in load.items():
            self.load[0, 0, orders.index(k)] = mp.mpf(complex(value).real)
            self.load[1, 0, orders.index(k)] = mp.mpf(complex(value).imag)
        self.z, self.q = split(z), split(np.array(q, dtype=object))
        self.gain, self.c_x, self.l = gain, c_x, l
        self.wave, self.force_wave = waves(orders, samples), waves(self.force_orders, samples)
        self.sin, self.cos = mp_sin, mp_cos
        # D(k nu) as a plain complex double, for the linear response and the successive approximations
        self.dynamic = np.vectorize(complex, otypes=[complex])(dynamic).transpose(2, 0, 1)

    def in_doubles(self):
        """The same balance with every table rounded to double."""
        other = object.__new__(Balance)
        other.__dict__.update(self.__dict__)
        for name in ("load", "z", "q", "gain"):
            setattr(other, name, to_float(getattr(self, name)))
        other.wave = tuple(map(to_float, self.wave))
        other.force_wave = tuple(map(to_float, self.force_wave))
        other.c_x, other.l, other.sin, other.cos = float(self.c_x), float(self.l), np.sin, np.cos
        return other

    def residual(self, unknown):
        """Z X + F(X) - load, projected on the orders of X."""
        x, phi = synthesis(unknown, self.wave)
        linear = multiply(self.z, unknown[:, None]).sum(axis=2)
        if self.geometry == "exact":
            delta = projection(x - self.l * self.sin(phi), self.force_wave)
            force = self.c_x * synthesis(multiply(self.q, delta), self.force_wave)
            nonlinear = projection(np.stack([force, -self.l * self.cos(phi) * force]), self.wave)
        else:
            n_1 = self.gain[0] * phi**3
            n_2 = phi**2 * (self.gain[1] * x + self.gain[2] * phi)
            nonlinear = multiply(self.q, projection(np.stack([n_1, n_2]), self.wave))
        return linear + nonlinear - self.load


def split(z):
    """Complex mp array -> real array with a leading axis re/im."""
    return np.stack([np.frompyfunc(mp.re, 1, 1)(z), np.frompyfunc(mp.im, 1, 1)(z)])


def multiply(a, b):
    """Complex product of arrays with a leading axis re/im."""
    return np.stack([a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]])


def synthesis(coefficients, wave):
    """Im sum_k X_k exp(i k theta_j)."""
    return coefficients[0] @ wave[0] + coefficients[1] @ wave[1]


def projection(samples, wave):
    """X_k of a sampled function."""
    sin, cos, weight = wave
    return np.stack([samples @ sin.T * weight, samples @ cos.T * weight])


def solve_linear(balance, right):
    """D(k nu)^(-1) right, in double."""
    rhs = (right[0] + 1j * right[1]).T[:, :, None]
    u = np.linalg.solve(balance.dynamic, rhs)[:, :, 0].T
    return np.stack([u.real, u.imag])


def jacobian(balance, unknown):
    """d residual / d X by complex steps (exact to rounding)."""
    n = unknown.size
    columns = []
    for j in range(n):
        step = np.zeros(n, dtype=complex)
        step[j] = 1e-30j
        columns.append(balance.residual(unknown + step.reshape(unknown.shape)).imag.ravel() / 1e-30)
    return np.array(columns).T


def successive(balance, steps=500):
    """U <- U - D^(-1) residual(U) from the linear response; None unless it converges."""
    u = solve_linear(balance, balance.load)
    for _ in range(steps):
        change = solve_linear(balance, balance.residual(u))
        u = u - change
        if not np.all(np.isfinite(u)) or np.abs(u).max() > 1e3:
            return None
        if np.abs(change).max() < 1e-14 * np.abs(u).max():
            return u
    return None


def contraction(balance, u, jac):
    """Spectral radius of the derivative of the successive approximation at its fixed point."""
    shape = u.shape
    back = np.array([solve_linear(balance, column.reshape(shape)).ravel() for column in jac.T]).T
    return np.abs(np.linalg.eigvals(np.eye(u.size) - back)).max()


def newton(balance, u, steps=30):
    """Double-precision Newton from u, then chord steps with residuals in full precision."""
    double = balance.in_doubles()
    for _ in range(steps):
        change = np.linalg.solve(jacobian(double, u), double.residual(u).ravel()).reshape(u.shape)
        u = u - change
        if np.abs(change).max() < 1e-13 * np.abs(u).max():
            break
    else:
        raise RuntimeError("Newton does not converge")
    inverse = np.linalg.inv(jacobian(double, u))
    u = to_mp(u)
    for _ in range(8):
        residual = balance.residual(u)
        scale = max(map(abs, residual.ravel())) or mp.mpf(1)
        change = to_mp(inverse @ to_float(residual / scale).ravel()) * scale
        u = u - change.reshape(u.shape)
        if max(map(abs, change)) < mp.mpf(10) ** -30:
            return u
    raise RuntimeError("the polish does not converge")


def rows(label, load, kernels, orders, damping=None):
    """Yield the rows of one curve, for each geometry and frequency that successive approximation reaches."""
    for geometry in GEOMETRIES:
        for nu in NU:
            balance = Balance(geometry, nu, load, kernels, orders, damping)
            double = balance.in_doubles()
            start = successive(double)
            if start is None:
                continue
            rate = contraction(double, start, jacobian(double, start))
            if rate > RATE_LIMIT:
                continue
            u = newton(balance, start)
            if np.abs(to_float(u) - start).max() > 1e-11:
                raise RuntimeError("Newton left the branch")
            values = [mp.nstr(u[part, coordinate, k], 20, strip_zeros=False)
                      for coordinate in (0, 1) for k in range(len(orders)) for part in (0, 1)]
            yield [geometry, *label, repr(nu), *values, f"{rate:.3f}"]


def response_columns(names, orders):
    return ["geometry", *names, "nu",
            *(f"{part}_{c}{k}" for c in ("x", "phi") for k in orders for part in ("re", "im")), "rate"]


def scene_text(kernels="kernel of x and phi: alpha=0.1 beta=0.05"):
    return "m=1 l=0.5 I=0.1 c_x=10 c_phi=2; " + kernels


def table_h9():
    names = ("A", "P")
    body = []
    for amplitude in AMPLITUDES:
        for load in (0.1, 0.5) if amplitude in (0.078, 0.048) else (0.1,):
            kernel = (amplitude, ALPHA, BETA)
            body += rows((repr(amplitude), repr(load)), {1: load}, (kernel, kernel), ODD)
    return "steady response to P sin(nu t), harmonics 1,3,5,7,9", scene_text(), response_columns(names, ODD), body


def table_two_kernels():
    kernels = ((0.048, ALPHA, BETA), (0.02, 0.3, 0.1))
    damping = ((0.2, 0.05), (0.05, 0.03))
    body = []
    for load in (0.1, 0.5):
        body += rows((repr(load),), {1: load}, kernels, ODD, damping)
    text = scene_text("kernel of x: A=0.048 alpha=0.1 beta=0.05; of phi: A=0.02 alpha=0.3 beta=0.1; "
                      "damping C=[[0.2,0.05],[0.05,0.03]]")
    return ("steady response to P sin(nu t), two kernels and viscous damping, harmonics 1,3,5,7,9", text,
            response_columns(("P",), ODD), body)


def table_full_set():
    kernel = (0.048, ALPHA, BETA)
    load = {0: 0.02j, 1: 0.1, 2: 0.03 + 0.01j}
    body = list(rows(("0.048",), load, (kernel, kernel), FULL))
    text = scene_text() + "; load on x: P_0=0.02i (a mean of 0.02) P_1=0.1 P_2=0.03+0.01i"
    return ("steady response to a load with a mean and an even harmonic, harmonics 0..9", text,
            response_columns(("A",), FULL), body)


def table_curves():
    load, body = mp.mpf(0.1), []
    m, l, inertia, c_x, c_phi = (mp.mpf(REFERENCE[n]) for n in ("m", "l", "I", "c_x", "c_phi"))
    for amplitude in AMPLITUDES:
        for nu in np.linspace(0.3, 12.0, 200):
            q = 1 - rhat((amplitude, ALPHA, BETA), mp.mpf(float(nu)))
            w2 = mp.mpf(float(nu)) ** 2
            d11, d12, d22 = c_x * q - m * w2, -c_x * l * q, (c_x * l**2 + c_phi) * q - inertia * w2
            det = d11 * d22 - d12**2
            x, phi = load * d22 / det, -load * d12 / det
            body.append([repr(amplitude), repr(float(nu)),
                         *(mp.nstr(v, 20, strip_zeros=False) for v in (x.real, x.imag, phi.real, phi.imag))])
    return ("linear steady response to P sin(nu t), first harmonic, P=0.1", scene_text(),
            ["A", "nu", "re_x1", "im_x1", "re_phi1", "im_phi1"], body)


def check(path):
    """Compare with reference values that are converged in harmonics (amplitudes of 1, 3, 5)."""
    reference = json.loads(Path(path).read_text())
    orders = tuple(range(1, 40, 2))
    worst = {"harmonics": 0, "linear": 0}
    for entry in reference["harmonic_balance"]:
        kernel = (entry["A"], ALPHA, BETA)
        guess = None
        for part in np.linspace(0.05, 1, 20):  # the load is raised slowly: the branch from zero
            balance = Balance("cubic", entry["nu"], {1: part * entry["P"]}, (kernel, kernel), orders)
            if guess is None:
                guess = solve_linear(balance, to_float(balance.load))
                linear = guess / part
            guess = to_float(newton(balance, guess))
        u = newton(balance, guess)
        for c, name in enumerate(("x", "phi")):
            for k in (1, 3, 5):
                own = mp.hypot(*u[:, c, orders.index(k)])
                error = abs(own / mp.mpf(entry[name][str(k)]) - 1)
                worst["harmonics"] = max(worst["harmonics"], error)
                print(f"A={entry['A']} nu={entry['nu']} |{name}_{k}| {mp.nstr(own, 20)}  {mp.nstr(error, 2)}")
            own = np.hypot(*linear[:, c, 0])
            worst["linear"] = max(worst["linear"], abs(own / entry["linear"][name + "1"] - 1))
    print("largest relative difference:", {k: mp.nstr(mp.mpf(v), 2) for k, v in worst.items()})

    difference = truncated = mp.mpf(0)
    for nu, load in ((0.5, 0.5), (2.1, 0.5), (1.9, 0.5), (5.6, 0.5)):
        kernel = (0.048, ALPHA, BETA)
        solve = [newton(b, successive(b.in_doubles())) for b in (
            Balance("exact", nu, {1: load}, (kernel, kernel), ODD, samples=s, force_orders=f)
            for s, f in ((64, None), (128, None), (64, ODD)))]
        difference = max(difference, abs(solve[0] - solve[1]).max())
        truncated = max(truncated, abs(solve[0] - solve[2]).max())
    print("exact: 64 against 128 samples", mp.nstr(difference, 2),
          "; spring force truncated to 1..9", mp.nstr(truncated, 2))


TABLES = dict(h9=table_h9, two_kernels=table_two_kernels, full_set=table_full_set, curves=table_curves)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--table", choices=TABLES, default="h9")
    parser.add_argument("--out", type=Path, help="the CSV file to write")
    parser.add_argument("--check", type=Path, help="compare with this reference file instead")
    args = parser.parse_args()
    if args.check:
        return check(args.check)
    if not args.out:
        parser.error("--out is needed")
    what, parameters, columns, body = TABLES[args.table]()
    header = [f"# {what}; u(t) = Im sum_k X_k exp(i k nu t)", f"# {parameters}",
              f"# program: data/programs/mount_harmonic_balance.py --table {args.table}",
              "# 20 digits, at the doubles nearest to the parameters shown",
              "# columns: " + ",".join(columns)]
    if columns[-1] == "rate":
        header.append("# rate: convergence factor of the successive approximations; "
                      f"frequencies where it exceeds {RATE_LIMIT} are left out")
    lines = header + [",".join(columns)] + [",".join(row) for row in body]
    args.out.write_text("\n".join(lines) + "\n")
    print(f"{args.out}: {len(body)} rows")


if __name__ == "__main__":
    main()
