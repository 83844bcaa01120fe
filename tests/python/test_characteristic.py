"""Characteristic roots against independent references and closed forms."""

import json
import math
import warnings

import mpmath
import numpy as np
import pytest
import viscovib as vv
from polynomial_examples import chain
from tables import DATA

BODY = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}


REFERENCE = json.loads((DATA / "mount_memory_reference.json").read_text())["characteristic_roots"]


pytestmark = pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")


@pytest.mark.parametrize("amplitude", [0.078, 0.048])
def test_reference_roots(amplitude):
    rows = [row for row in REFERENCE if row["A"] == amplitude]
    kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=0.1, beta=0.05)
    roots = vv.Mount(**BODY, kernel=kernel).characteristic_roots()
    expected = [complex(*map(float, row["complex_root"])) for row in rows]
    assert roots.oscillatory == pytest.approx(expected, abs=1e-13)
    # Near the limit the relaxed stiffness is a small difference with a rounding error of 1e-13.
    slow = sorted((float(row["real_root"]) for row in rows), reverse=True)
    assert roots.real == pytest.approx(slow, rel=1e-11)
    assert roots.n_unstable == (2 if amplitude == 0.078 else 0)
    assert roots.complete
    assert roots.growth_rate == pytest.approx(max([*slow, *(z.real for z in expected)]), rel=1e-11)


def test_limit_of_the_integral():
    """The limit A Gamma(alpha) = beta^alpha separates decay from growth."""
    limit = 0.05**0.1 / math.gamma(0.1)
    assert limit == pytest.approx(0.0779033846, abs=1e-10)
    for factor, unstable in ((0.999, 0), (1.001, 2)):
        kernel = vv.RzhanitsynKernel(amplitude=factor * limit, alpha=0.1, beta=0.05)
        roots = vv.Mount(**BODY, kernel=kernel).characteristic_roots()
        assert roots.n_unstable == unstable
        assert roots.complete


@pytest.mark.parametrize(
    "kernel",
    [
        vv.AbelKernel(amplitude=0.05, alpha=0.5),
        vv.RabotnovKernel(amplitude=0.3, alpha=0.6, beta=0.2),
        vv.PronyKernel(weights=[0.3, 0.2], rates=[1, 0.1]),
    ],
)
@pytest.mark.parametrize("both", [True, False])
def test_every_growing_motion_is_found(kernel, both):
    body = vv.Mount(**BODY, kernel=kernel, kernel_phi=None if both else False)
    roots = body.characteristic_roots()
    assert roots.complete
    assert roots.n_unstable == (2 if both else 1)
    for s in [*roots.oscillatory, *roots.real]:
        spring, rotation = np.array([[10, -5], [-5, 2.5]]), np.diag([0, 2.0])
        kept = 1 - kernel.laplace(s)
        d = s**2 * np.diag([1, 0.1]) + kept * spring + (kept if both else 1.0) * rotation
        assert abs(np.linalg.det(d)) < 1e-10 * np.abs(d).max() ** 2


def test_a_root_at_rounding_of_zero_is_found():
    """An integral of exactly 1: bisection to the root 0 needs more than a hundred steps."""
    mount = vv.Mount(
        mass=10, inertia=0.1, offset=0.001, stiffness_x=0.1, stiffness_phi=1e4,
        kernel=vv.RzhanitsynKernel(amplitude=10, alpha=1.0, beta=10.0),
    )  # fmt: skip
    assert mount.kernel.integral == pytest.approx(1)
    with pytest.warns(vv.ConvergenceWarning, match="rounding errors of det D hide"):
        roots = mount.characteristic_roots()
    assert not roots.complete
    assert np.isfinite(roots.real).all()
    assert np.isfinite(roots.oscillatory).all()


def test_no_root_is_lost_to_another():
    """A long memory slows the lowest modes most, and roots pass near each other.

    Random chains with a Prony kernel: all roots against eigenvalues of the ordinary equations.
    """
    rng = np.random.default_rng(4)
    for _ in range(30):
        n = int(rng.integers(2, 5))
        mass, springs = rng.uniform(0.6, 1.8, n), rng.uniform(0.5, 1.8, n + 1)
        stiffness = np.diag(springs[:-1] + springs[1:])
        stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
        weight, rate = rng.uniform(0.3, 1.1), rng.uniform(0.7, 1.5)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            system = vv.PolynomialSystem(
                mass=mass, stiffness=stiffness, damping=1e-3 * stiffness,
                kernel=vv.PronyKernel(weights=[weight], rates=[rate]),
            )  # fmt: skip
            found = system.characteristic_roots().oscillatory
        one, zero = np.eye(n), np.zeros((n, n))
        k = stiffness / mass[:, None]
        whole = np.block([[zero, one, zero], [-k, -1e-3 * k, k], [weight * one, zero, -rate * one]])
        roots = np.linalg.eigvals(whole)
        wanted = roots[roots.imag > 1e-6]
        wanted = wanted[np.argsort(wanted.imag)]
        assert len(found) == len(wanted)
        assert found == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-6, 1e-4, 3e-3])
def test_light_modes_side_by_side_are_listed_and_counted(gap):
    """Each phase change by nearly pi falls between two frequencies of any grid."""
    rng = np.random.default_rng(7)
    for _ in range(4):
        n = int(rng.integers(2, 5))
        squares = rng.uniform(0.5, 4, n)
        squares[1] = squares[0] * (1 + gap)
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0] if rng.random() < 0.5 else np.eye(n)
        stiffness = turn @ np.diag(squares) @ turn.T
        stiffness = (stiffness + stiffness.T) / 2
        weight, rate = 10 ** rng.uniform(-8, -2), rng.uniform(0.3, 3)
        # Negative damping in addition to that of the memory: some of the modes grow.
        damping = -weight * rng.uniform(0, 0.3) * np.eye(n)
        memory = vv.PronyKernel(weights=[weight], rates=[rate])
        roots = vv.PolynomialSystem(
            mass=np.ones(n), stiffness=stiffness, damping=damping, kernel=memory
        ).characteristic_roots()
        # u'' = v, v' = -K (u - w m) - C v, m' = u - rate m.
        none, one = np.zeros((n, n)), np.eye(n)
        rows = [[none, one, none], [-stiffness, -damping, weight * stiffness]]
        values = np.linalg.eigvals(np.block([*rows, [one, none, -rate * one]]))
        up = values[values.imag > 0.1]
        up = up[np.argsort(up.imag)]
        assert roots.oscillatory == pytest.approx(up, rel=1e-6)
        clear = np.abs(up.real).min() > 1e-12
        assert not clear or roots.n_unstable == 2 * (up.real > 0).sum()
        assert not clear or roots.complete


def test_roots_with_tables_that_end_are_zeros():
    """For a kernel of finite duration, transforms in the left half plane exceed all other terms."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        end, n = 10 ** rng.uniform(2, 4), int(rng.integers(1, 4))
        t = np.geomspace(1e-4, end, 9)
        v = t ** rng.uniform(-0.6, -0.2) * np.exp(-t / end * rng.uniform(0, 20))
        v *= rng.uniform(0.02, 0.3) / np.trapezoid(v, t)
        chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        damping = 10 ** rng.uniform(-3, -0.7) * chain
        table = vv.TabulatedKernel(times=t, values=v)
        roots = vv.PolynomialSystem(
            mass=np.ones(n), stiffness=chain, damping=damping, kernel=table
        ).characteristic_roots()
        assert roots.complete, seed
        start, first = np.insert(t, 0, 0.0), np.insert(v, 0, v[0])
        fall = np.diff(first) / np.diff(start)
        with mpmath.workdps(40):
            for s in roots.oscillatory:
                # For each mode of the chain: s^2 + (c s + 1 - R(s)) k = 0.
                z = mpmath.mpc(s)
                parts = [
                    float(f) * (mpmath.exp(-z * float(a)) - mpmath.exp(-z * float(b))) / z
                    for f, a, b in zip(fall, start[:-1], start[1:], strict=True)
                ]
                kept = 1 - (v[0] - v[-1] * mpmath.exp(-z * float(t[-1])) + sum(parts)) / z
                share = damping[0, 0] / 2 * z + kept
                of_mode = -(z**2) / share
                modes = np.linalg.eigvalsh(chain)
                off = min(abs(of_mode - k) / k for k in modes)
                assert off < 1e-6, (seed, s, float(off))


def test_rates_in_laws_with_a_kernel_damp_and_drive():
    """(1 - R*) [K u + C u'] is linear: roots by eigenvalues, stiffness by Newton's method."""
    rng = np.random.default_rng(3)
    for _ in range(8):
        n = int(rng.integers(1, 4))
        names = ["x"] if n == 1 else [f"x{i + 1}" for i in range(n)]
        squares, c = rng.uniform(0.5, 4, n), rng.uniform(-0.1, 0.5, n)
        weight, rate = rng.uniform(0.05, 0.6), rng.uniform(0.7, 3)
        system = vv.PolynomialSystem(
            mass=np.ones(n), stiffness=squares, damping=0.02 * np.ones(n), names=names,
            forces={x: f"{a}*tanh(3*{x}_dot)/3" for x, a in zip(names, c, strict=True)},
            kernel=vv.PronyKernel(weights=[weight], rates=[rate]),
        )  # fmt: skip
        none, one, k, dampers = np.zeros((n, n)), np.eye(n), np.diag(squares), np.diag(c)
        # u'' = -0.02 u' - F + w m, m' = F - rate m with F = K u + C u'.
        rows = [none, one, none], [-k, -0.02 * one - dampers, weight * one]
        values = np.linalg.eigvals(np.block([*rows, [k, dampers, -rate * one]]))
        up = values[values.imag > 1e-6]
        roots = system.characteristic_roots()
        assert roots.oscillatory == pytest.approx(up[np.argsort(up.imag)], rel=1e-9)
        assert roots.n_unstable == (values.real > 0).sum()
        nu, push = rng.uniform(0.4, 2), 1e-7 * rng.uniform(0.5, 1, n)
        small = vv.forced_response(system, [nu], load=push, method="newton")
        found = np.linalg.solve(system.dynamic_stiffness(nu), push)
        assert small.coefficients[0, :, 0] == pytest.approx(found, rel=1e-8)
        same = vv.Structure(
            mass=np.ones(n), stiffness=np.zeros(n), damping=0.02 * np.ones(n), names=names,
            elements=[
                vv.Spring(on=x, stiffness=one, law=f"{a}*tanh(3*v)/3", kernel=system.kernel)
                for x, a, one in zip(names, c, squares, strict=True)
            ],
        )  # fmt: skip
        assert same.characteristic_roots().oscillatory == pytest.approx(roots.oscillatory, rel=1e-9)
        for one in system, same:
            linear = vv.forced_response(one, [nu], load=push, method="linear")
            assert linear.coefficients[0, :, 0] == pytest.approx(found, rel=1e-12)


def test_roots_of_sums_of_exponentials_are_all_zeros_of_their_polynomial():
    """Includes strongly damped oscillatory roots; reference with 60 digits."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        n = int(rng.integers(1, 4))
        rates = np.sort(10 ** rng.uniform(-1, 1.3, n))
        shares = rng.dirichlet(np.ones(n)) * rng.uniform(0.3, 0.98)
        damping = rng.uniform(0, 3)
        kernel = vv.PronyKernel(weights=shares * rates, rates=rates)
        system = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, kernel=kernel)
        found = system.characteristic_roots()
        with mpmath.workdps(60):
            s = mpmath.mpf(1)
            product = [s]
            for rate in rates:
                product = multiplied(product, [1, mpmath.mpf(rate)])
            whole = multiplied([1, mpmath.mpf(damping), 1], product)
            for j in range(n):
                part = [-mpmath.mpf(shares[j] * rates[j])]
                for i, rate in enumerate(rates):
                    if i != j:
                        part = multiplied(part, [1, mpmath.mpf(rate)])
                for i, value in enumerate(reversed(part), 1):
                    whole[-i] += value
            exact = [complex(r) for r in mpmath.polyroots(whole, maxsteps=500, extraprec=200)]
        exact = sorted((r for r in exact if r.imag > 1e-6 * abs(r)), key=lambda r: r.imag)
        assert found.complete
        assert found.oscillatory == pytest.approx(np.array(exact, dtype=complex), rel=1e-8)


def multiplied(a, b):
    """Product of two polynomials."""
    total = [mpmath.mpf(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            total[i + j] += x * y
    return total


def test_a_kernel_of_nonlinear_forces_alone_leaves_the_roots():
    """Springs without a linear part have no memory about the state of rest."""
    forces = {"x": "x^3"}
    memory = vv.PronyKernel(weights=[0.3], rates=[0.4])
    system = vv.PolynomialSystem(
        mass=1, stiffness=0, damping=3, names=["x"], forces=forces, kernel=memory,
        springs=[vv.Springs(stiffness=1.25)],
    )  # fmt: skip
    roots = system.characteristic_roots()
    assert roots.region == "the whole plane"
    assert roots.real == pytest.approx([-0.5, -2.5], rel=1e-12)
    assert roots.complete


def test_rounding_errors_that_hide_roots_are_reported():
    """Strong dampers and memory of different orders: terms of D differ by up to 20 decades.

    The count then ends without a number, and a list of roots is complete only if it is right.
    """
    hidden = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        mass, stiffness = 10 ** rng.uniform(-1, 3), 10 ** rng.uniform(3, 7, 3)
        rate = math.sqrt(stiffness.max() / mass)
        kernels = []
        for alpha in rng.uniform(0.05, 1, 3):
            if rng.random() < 0.7:
                size = 10 ** rng.uniform(-2, 0) * rate**alpha
                kernels.append(vv.AbelKernel(amplitude=size, alpha=alpha))
            else:
                beta = rate * 10 ** rng.uniform(-5, 2)
                size = rng.uniform(0.1, 0.9) * beta**alpha / math.gamma(alpha)
                kernels.append(vv.RzhanitsynKernel(amplitude=size, alpha=alpha, beta=beta))
        damping = 10 ** rng.uniform(2, 11) * np.sqrt(stiffness * mass) * rng.uniform(0.1, 1, 3)
        mount = vv.MountPoint(
            name="one", position=rng.uniform(-0.3, 0.3, 3), stiffness=stiffness, damping=damping,
            angles=rng.uniform(-3, 3, 3), kernel=kernels, rotational_stiffness=stiffness / 100,
        )  # fmt: skip
        body = vv.Body(mass=mass, inertia=np.diag([1, 2, 2.5]) * mass / 50, mounts=[mount])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            roots = body.characteristic_roots()
        messages = [str(w.message) for w in caught]
        assert 0 <= roots.n_unstable <= 12
        if any("rounding errors of det D hide" in text for text in messages):
            hidden += 1
            assert not roots.complete
        for text in messages:
            if "argument principle gives" in text:
                assert abs(int(text.split("gives")[1].split()[0])) <= 6
    assert 1 <= hidden <= 30


def test_growing_real_roots_of_structures_are_counted():
    """Masses on springs with Abel kernels: s^2 m + k (1 - A Gamma(alpha)/s^alpha) = 0, s > 0."""
    rng = np.random.default_rng(6)
    for _ in range(4):
        n = int(rng.integers(1, 4))
        mass, stiffness = rng.uniform(0.5, 2, n), rng.uniform(1, 50, n)
        amplitude, alpha = rng.uniform(0.02, 0.3), rng.uniform(0.3, 0.7)
        with pytest.warns(vv.StabilityWarning):
            chain = vv.Structure(
                mass=mass, stiffness=np.zeros((n, n)),
                elements=[
                    vv.Spring(
                        on=i, law=f"{stiffness[i]}*d",
                        kernel=vv.AbelKernel(amplitude=amplitude, alpha=alpha),
                    )
                    for i in range(n)
                ],
            )  # fmt: skip
        roots = chain.characteristic_roots()
        exact = [
            mpmath.findroot(
                lambda s, m=m, k=k, a=amplitude, p=alpha: (
                    m * s**2 + k * (1 - a * mpmath.gamma(p) / s**p)
                ),
                ((amplitude * math.gamma(alpha)) ** (1 / alpha) * 1e-3, 1e3), solver="anderson",
            )
            for m, k in zip(mass, stiffness, strict=True)
        ]  # fmt: skip
        assert roots.real == pytest.approx(sorted(map(float, exact), reverse=True), rel=1e-9)
        assert roots.n_unstable == n
        assert roots.complete


_KERNELS = {
    "none": None,
    "prony": vv.PronyKernel(weights=[0.2, 0.1], rates=[1, 5]),
    "rzhanitsyn": vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05),
}


@pytest.mark.parametrize("name", _KERNELS)
@pytest.mark.parametrize("n", [1, 3, 6])
def test_all_roots_of_a_structure_contain_those_of_its_modes(name, n):
    """Two engines: the argument principle, and Newton's method from each mode."""
    rng = np.random.default_rng(n)
    stiffness, mass = (a @ a.T / n + np.eye(n) for a in rng.standard_normal((2, n, n)))
    kernel = _KERNELS[name]
    elements = [
        vv.Spring(on=rng.standard_normal(n), stiffness=1.5, law="0.5*d^3", kernel=kernel)
        for _ in range(2)
    ]
    system = vv.Structure(
        mass=mass, stiffness=stiffness, damping=0.03 * stiffness, elements=elements
    )
    roots = system.characteristic_roots()
    assert roots.complete
    assert roots.n_unstable == 0
    some = system.characteristic_roots(n).oscillatory
    off = np.abs(roots.oscillatory[:, None] - some).min(axis=0)
    assert (off < 1e-11 * np.abs(some)).all()


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_roots_where_rest_is_unstable():
    """A double well: a real root for leaving the saddle; no natural frequency there."""
    system = vv.PolynomialSystem(mass=2, stiffness=-1, damping=0.1, forces="x^3")
    roots = system.characteristic_roots()
    assert roots.real == pytest.approx(np.sort(np.roots([2, 0.1, -1]))[::-1], rel=1e-13)
    assert (roots.n_unstable, roots.complete) == (1, True)
    with pytest.raises(vv.InputError, match="rest is unstable"):
        system.natural_frequencies()
    # With a mean load, in one of the wells.
    r = vv.forced_response(system, 3.0, load={0: 0.1j, 1: 0.05}, method="newton")
    assert r.converged.all()
    gyroscopic = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[[1, 0.05], [-0.05, 1.2]], damping=[[0, 0.3], [-0.3, 0]]
    )
    assert gyroscopic.natural_frequencies().size == 2
    creeping = chain(3, kernel=vv.PronyKernel(weights=[1.1], rates=[1]))
    assert creeping.characteristic_roots().n_unstable == 3
    assert creeping.characteristic_roots().complete


@pytest.mark.parametrize("held", [False, True])
def test_rigid_motions_hide_no_roots(held):
    """A free chain, and one whose last mass is held by a soft spring without memory."""
    weights, rates = np.array([0.1, 0.3]), np.array([1.0, 5.0])
    mass, soft = np.diag([1.0, 2.0, 1.5]), np.diag([0.0, 0.0, 1e-6 if held else 0.0])
    stiffness = np.array([[3.0, -3, 0], [-3, 5, -2], [0, -2, 2]])
    damping = 0.02 * stiffness
    kernel = vv.PronyKernel(weights=weights, rates=rates)
    roots = vv.PolynomialSystem(
        mass=mass, damping=damping, stiffness=soft,
        springs=[vv.Springs(stiffness=stiffness, kernel=kernel)],
    ).characteristic_roots()  # fmt: skip
    one, none, inverse = np.eye(3), np.zeros((3, 3)), np.linalg.inv(mass)
    states = np.block([
        [none, one, none, none],
        [-inverse @ (stiffness + soft), -inverse @ damping, inverse @ stiffness,
         inverse @ stiffness],
        [weights[0] * one, none, -rates[0] * one, none],
        [weights[1] * one, none, none, -rates[1] * one],
    ])  # fmt: skip
    found = np.linalg.eigvals(states)
    expected = sorted(found[found.imag > 1e-6], key=lambda s: s.imag)
    assert roots.oscillatory == pytest.approx(expected, rel=1e-9)
    assert roots.real.tolist() == ([] if held else [0.0, 0.0])
    assert roots.n_unstable == 0
    assert roots.complete
