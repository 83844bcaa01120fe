"""Independent derivation of the method of multiple scales with sympy."""

import itertools

import mpmath
import sympy as sp


def pendulum_equations(e, w2, w3, alpha):
    """Lagrange equations of the undamped spring pendulum, and their variables.

    The Lagrangian is that of a spring with a point mass and an attached body: kinetic energy
    of the body about its mass centre, potential energy of spring and weight.
    """
    _z, _phi, _psi = q = sp.symbols("z phi psi")
    v = sp.symbols("dz dphi dpsi")
    a = sp.symbols("ddz ddphi ddpsi")
    r = w3**2 / w2**2
    t = sp.Symbol("t")
    zt, ft, pt = (sp.Function(n)(t) for n in ("z", "phi", "psi"))
    z_r = sp.Symbol("z_r")
    # End of the spring at (1 + z) (sin phi, cos phi); the mass centre at a distance e along psi.
    x = (1 + zt) * sp.sin(ft) + e * sp.sin(pt)
    y = (1 + zt) * sp.cos(ft) + e * sp.cos(pt)
    kinetic = (sp.diff(x, t) ** 2 + sp.diff(y, t) ** 2) / 2
    kinetic += (e / r - e**2) * sp.diff(pt, t) ** 2 / 2
    total = z_r + zt
    potential = total**2 / 2 + alpha * total**4 / 4 - w2**2 * y
    lagrangian = kinetic - potential
    found = []
    for coordinate in (zt, ft, pt):
        equation = sp.diff(sp.diff(lagrangian, sp.diff(coordinate, t)), t) - sp.diff(
            lagrangian, coordinate
        )
        for function, symbols in zip((zt, ft, pt), zip(q, v, a, strict=True), strict=True):
            equation = equation.subs(sp.diff(function, t, 2), symbols[2])
            equation = equation.subs(sp.diff(function, t), symbols[1])
        for function, symbol in zip((zt, ft, pt), q, strict=True):
            equation = equation.subs(function, symbol)
        found.append(equation)
    real = [
        s for s in sp.Poly(alpha * z_r**3 + z_r - w2**2, z_r).nroots(n=40) if abs(sp.im(s)) < 1e-30
    ]
    static = sp.re(real[0])
    return [f.subs(z_r, static) for f in found], [*q, *v, *a]


def terms_to_third(equations, variables):
    """Taylor terms to third order: for each equation a dict of exponents to coefficient."""
    eps = sp.Symbol("eps")
    result = []
    for equation in equations:
        scaled = equation.subs({x: eps * x for x in variables}, simultaneous=True)
        expanded = sum(sp.diff(scaled, eps, k).subs(eps, 0) / sp.factorial(k) for k in range(4))
        polynomial = sp.Poly(sp.expand(expanded), *variables)
        result.append({m: mpmath.mpf(str(sp.N(c, 35))) for m, c in polynomial.terms()})
    return result


def interaction(terms, n):
    """gamma_jk of an undamped system without resonance, and its frequencies.

    ``terms``: for each of n equations a dict of exponents of (q, q', q'') to coefficient. The
    motion is a sum of exp(i (m . w) t) with coefficients, order by order (Nayfeh, Introduction
    to perturbation techniques, 1981, chapter 15).
    """
    mpmath.mp.dps = 35
    m = 3 * n

    def linear(s):
        matrix = mpmath.matrix(n, n)
        for row, table in enumerate(terms):
            for exponents, c in table.items():
                if sum(exponents) == 1:
                    k = exponents.index(1)
                    matrix[row, k % n] += c * s ** (k // n)
        return matrix

    # Natural frequencies from mass and stiffness.
    mass, stiffness = mpmath.matrix(n, n), linear(mpmath.mpf(0))
    for row, table in enumerate(terms):
        for exponents, c in table.items():
            if sum(exponents) == 1 and exponents.index(1) >= 2 * n:
                mass[row, exponents.index(1) % n] += c
    squares, shapes = mpmath.eigsy(
        mpmath.cholesky(mass) ** -1 * stiffness * (mpmath.cholesky(mass) ** -1).T
    )
    shapes = (mpmath.cholesky(mass) ** -1).T * shapes
    omega = [mpmath.sqrt(s) for s in squares]
    vectors = []
    for j in range(n):
        column = [shapes[i, j] for i in range(n)]
        largest = max(column, key=abs)
        vectors.append([c / largest for c in column])

    def arguments(motion):
        """The arguments x of the terms; ``motion`` is a dict of wave numbers to vector."""
        result = {}
        for wave, u in motion.items():
            s = 1j * sum(w * k for w, k in zip(omega, wave, strict=True))
            result[wave] = [*u, *(s * c for c in u), *(s * s * c for c in u)]
        return result

    def product(series, table, degree):
        """Sum of the terms of one degree over the given series, one series for each factor."""
        total = {}
        for exponents, c in table.items():
            if sum(exponents) != degree:
                continue
            places = [k for k in range(m) for _ in range(exponents[k])]
            for orders in series:
                for waves in itertools.product(*(orders[q].items() for q in range(degree))):
                    wave = tuple(map(sum, zip(*(w for w, _ in waves), strict=True)))
                    value = c
                    for (_, x), place in zip(waves, places, strict=True):
                        value *= x[place]
                    total[wave] = total.get(wave, 0) + value
        return total

    def response(j, k):
        """Secular term of third order in mode j for amplitudes 1 in j and b in k."""
        first = {}
        for mode in {j, k}:
            wave = tuple(int(i == mode) for i in range(n))
            first[wave] = [c / 2 for c in vectors[mode]]
            first[tuple(-i for i in wave)] = first[wave]
        x1 = arguments(first)
        right = [product([(x1, x1)], table, 2) for table in terms]
        second = {}
        for wave in set().union(*right):
            s = 1j * sum(w * q for w, q in zip(omega, wave, strict=True))
            load = mpmath.matrix([-table.get(wave, 0) for table in right])
            second[wave] = list(mpmath.lu_solve(linear(s), load))
        x2 = arguments(second)
        wanted = tuple(int(i == j) for i in range(n))
        total = []
        for table in terms:
            part = product([(x1, x2), (x2, x1)], table, 2).get(wanted, 0)
            part += product([(x1, x1, x1)], table, 3).get(wanted, 0)
            total.append(part)
        return total

    def rate(j, secular):
        """2 i w (l M r) D2 A + l . secular = 0 with A = exp(i shift t)/2: the shift."""
        l_m_r = sum(vectors[j][a] * mass[a, b] * vectors[j][b] for a in range(n) for b in range(n))
        value = sum(u * s for u, s in zip(vectors[j], secular, strict=True))
        return mpmath.re(value / (omega[j] * l_m_r))

    gamma = mpmath.matrix(n, n)
    for j in range(n):
        gamma[j, j] = rate(j, response(j, j))
    for j in range(n):
        for k in range(n):
            if j != k:
                gamma[j, k] = rate(j, response(j, k)) - gamma[j, j]
    return omega, gamma
