"""Rotors: matrices that depend on the speed, against integrations and eigenvalues by SciPy."""

import json
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

DATA = Path(__file__).parents[2] / "data" / "unbalance_reference.json"


class Rotor:
    """A random rotor of n coordinates with a cubic and a quadratic force."""

    def __init__(self, seed, n, *, nonlinear=True, memory=False):
        rng = np.random.default_rng(seed)
        self.n = n
        a, b = rng.normal(size=(2, n, n))
        self.mass = a @ a.T / n + np.eye(n)
        self.stiffness = b @ b.T / n + 2 * np.eye(n)
        self.damping = 0.15 * (np.eye(n) + 0.3 * rng.normal(size=(n, n)))
        skew = rng.normal(size=(n, n))
        self.gyroscopic = 0.4 * (skew - skew.T)
        self.circulatory = 0.05 * rng.normal(size=(n, n))
        self.centrifugal = 0.1 * rng.normal(size=(n, n))
        self.cubic = 0.3 if nonlinear else 0.0
        self.load = rng.normal(size=n) * 0.4
        self.memory = memory

    def system(self, **changes):
        last = f"x{self.n}"
        forces = {"x1": f"{self.cubic}*x1^3", last: f"{self.cubic}*(x1 - {last})^3 + 0.1*{last}^2"}
        given = dict(
            mass=self.mass,
            stiffness=self.stiffness,
            damping=self.damping,
            gyroscopic=self.gyroscopic,
            circulatory=self.circulatory,
            centrifugal=self.centrifugal,
            forces=forces if self.cubic else None,
            names=[f"x{i + 1}" for i in range(self.n)],
        )
        if self.memory:
            kernel = vv.PronyKernel(weights=[0.2], rates=[0.7])
            given["springs"] = [vv.Springs(stiffness=0.5 * np.eye(self.n), kernel=kernel)]
        return vv.PolynomialSystem(**(given | changes))

    def matrices(self, speed):
        """Damping and stiffness at a speed."""
        return (
            self.damping + speed * self.gyroscopic,
            self.stiffness + speed * self.circulatory + speed**2 * self.centrifugal,
        )

    def flow(self, nu, *, load=True):
        """Return the derivative of (u, u') and of its columns of neighbours."""
        damping, stiffness = self.matrices(nu)
        inverse, n = np.linalg.inv(self.mass), self.n

        def rate(t, z):
            z = z.reshape(2 * n, -1)
            u, v = z[:n, 0], z[n:, 0]
            force, slope = np.zeros(n), stiffness.copy()
            if self.cubic:
                d = u[0] - u[-1]
                force[0] += self.cubic * u[0] ** 3
                slope[0, 0] += 3 * self.cubic * u[0] ** 2
                force[-1] += self.cubic * d**3 + 0.1 * u[-1] ** 2
                slope[-1, 0] += 3 * self.cubic * d**2
                slope[-1, -1] += -3 * self.cubic * d**2 + 0.2 * u[-1]
            push = self.load * np.sin(nu * t) if load else 0.0
            found = np.empty_like(z)
            found[:n] = z[n:]
            found[n:, 0] = inverse @ (push - damping @ v - stiffness @ u - force)
            found[n:, 1:] = -inverse @ (damping @ z[n:, 1:] + slope @ z[:n, 1:])
            return found.ravel()

        return rate

    def monodromy(self, nu, state):
        """State after a period, and the derivative by the state before."""
        n = self.n
        begin = np.column_stack([state, np.eye(2 * n)])
        run = solve_ivp(
            self.flow(nu), (0, 2 * np.pi / nu), begin.ravel(), method="DOP853", rtol=1e-12,
            atol=1e-13,
        )  # fmt: skip
        last = run.y[:, -1].reshape(2 * n, -1)
        return last[:, 0], last[:, 1:]


def start_of(harmonics, coefficients, nu):
    """State (u, u') at t = 0 of u = Im sum X_k exp(i k nu t); coefficients (n_dof, n_orders)."""
    u = coefficients.imag.sum(axis=1)
    v = (1j * nu * np.asarray(harmonics) * coefficients).imag.sum(axis=1)
    return np.concatenate([u, v])


def motion_of(result, i):
    return np.stack([result.coefficients[i, d] for d in range(result.coefficients.shape[1])])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("n", [2, 3, 5])
def test_motions_and_multipliers_are_those_of_an_integration_at_the_speed(seed, n):
    rotor = Rotor(10 * seed + n, n)
    nu = np.array([0.6, 1.3])
    found = vv.forced_response(rotor.system(), nu, load=rotor.load, method="newton", stability=True)
    for i, at in enumerate(nu):
        start = start_of(found.harmonics, motion_of(found, i), at)
        after, derivative = rotor.monodromy(at, start)
        assert after == pytest.approx(start, abs=1e-8)
        multipliers = np.linalg.eigvals(derivative)
        largest = np.sort(np.abs(multipliers))[::-1]
        own = np.sort(np.abs(found.multipliers[i]))[::-1]
        assert own[:2] == pytest.approx(largest[:2], rel=1e-7)
        assert found.stable[i] == (largest[0] < 1)


def test_the_unbalance_response_of_an_overhung_rotor():
    """Reference: closed form and a real 4 x 4 system, 15 digits."""
    reference = {one["name"]: one for one in json.loads(DATA.read_text())}
    wanted = reference["gyroscopic_overhung_rotor"]["value"]["response"]
    rotor = overhung()
    for key, value in wanted.items():
        nu = float(key.removeprefix("nu="))
        # x = Re z, y = Im z of a rotating unbalance: cos(nu t) and sin(nu t).
        load = {"x": "1e-3*nu^2", "y": "1e-3*nu^2"}
        cosine = vv.forced_response(rotor, [nu], load={"x": load["x"]}, method="linear")
        sine = vv.forced_response(rotor, [nu], load={"y": load["y"]}, method="linear")
        x = 1j * cosine.coefficients[0, :, 0] + sine.coefficients[0, :, 0]
        for d, name in ((0, "z"), (2, "theta")):
            # u = Im(X exp(i nu t)) is the real part of |X| exp(i (phase + nu t)).
            assert abs(x[d]) == pytest.approx(value[f"abs_{name}"], rel=1e-12)
            phase = np.angle(x[d] / 1j)
            assert phase == pytest.approx(value[f"phase_{name}"], rel=1e-12)


def overhung(damped=True):
    polar, diametral = 0.035, 0.02
    k11, k12, k22 = 400, -30, 6
    gyroscopic = np.zeros((4, 4))
    gyroscopic[2, 3], gyroscopic[3, 2] = polar, -polar
    stiffness = np.kron([[k11, k12], [k12, k22]], np.eye(2))
    return vv.PolynomialSystem(
        mass=[1, 1, diametral, diametral],
        stiffness=stiffness,
        damping=[1, 1, 0.01, 0.01] if damped else None,
        gyroscopic=gyroscopic,
        names=["x", "y", "a", "b"],
    )


def laval(external, internal, omega=1.0, **given):
    """A disc on a flexible shaft with internal damping."""
    turning = internal * np.array([[0, 1], [-1, 0]])
    return vv.PolynomialSystem(
        mass=[1, 1], stiffness=[omega**2] * 2, damping=[external + internal] * 2,
        circulatory=turning, names=["x", "y"], **given,
    )  # fmt: skip


@pytest.mark.parametrize(("external", "internal"), [(0.05, 0.2), (0.1, 0.1), (0.3, 0.04)])
def test_a_laval_rotor_loses_stability_at_the_speed_of_jeffcott(external, internal):
    """Jeffcott rotor: stable for nu < omega (1 + c_e/c_i)."""
    omega = 1.7
    limit = omega * (1 + external / internal)
    branch = vv.trace_response(
        laval(external, internal, omega), (0.5 * limit, 1.3 * limit), load={"x": 0.1}
    )
    assert [one.kind for one in branch.crossings] == ["Neimark-Sacker"]
    assert branch.crossings[0].parameter == pytest.approx(limit, rel=1e-8)
    assert np.array_equal(branch.stable, branch.nu < limit)


@pytest.mark.parametrize("seed", range(3))
def test_stability_along_branches_of_linear_rotors_is_that_of_the_state_matrix(seed):
    rotor = Rotor(40 + seed, 2 + seed % 4, nonlinear=False)
    rotor.circulatory *= 12
    branch = vv.trace_response(rotor.system(), (0.3, 3), load=rotor.load)
    largest = []
    for nu in branch.nu:
        damping, stiffness = rotor.matrices(nu)
        inverse = np.linalg.inv(rotor.mass)
        upper = np.hstack([np.zeros_like(damping), np.eye(rotor.n)])
        state = np.vstack([upper, np.hstack([-inverse @ stiffness, -inverse @ damping])])
        largest.append(np.linalg.eigvals(state).real.max())
    assert min(np.abs(largest)) > 1e-6
    assert np.array_equal(branch.stable, np.array(largest) < 0)
    growth = branch.exponents.real.max(axis=1)
    assert growth == pytest.approx(np.array(largest), abs=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_a_branch_meets_the_motions_of_shooting_and_its_folds(seed):
    rotor = Rotor(60 + seed, 2)
    rotor.load = 3 * rotor.load
    branch = vv.trace_response(rotor.system(), (0.4, 2.5), load=rotor.load)
    for i in range(0, branch.nu.size, 40):
        nu = branch.nu[i]
        start = start_of(branch.harmonics, branch.coefficients[i], nu)
        after, derivative = rotor.monodromy(nu, start)
        assert after == pytest.approx(start, abs=1e-7 * max(1, np.abs(derivative).max()))
        assert branch.stable[i] == (np.abs(np.linalg.eigvals(derivative)).max() < 1)
    for fold, motion in zip(branch.folds, branch.fold_coefficients, strict=True):
        start = start_of(branch.harmonics, motion, fold)
        multipliers = np.linalg.eigvals(rotor.monodromy(fold, start)[1])
        assert np.abs(multipliers - 1).min() < 1e-6 * max(1, np.abs(multipliers).max())


def test_a_fixed_speed_may_differ_from_the_frequency_of_the_load():
    rotor = Rotor(90, 2, nonlinear=False)
    speed, nu = 2.3, 0.8
    damping, stiffness = rotor.matrices(speed)
    x = np.linalg.solve(stiffness + 1j * nu * damping - nu**2 * rotor.mass, rotor.load)
    fixed = rotor.system().at_speed(speed)
    found = vv.forced_response(fixed, [nu], load=rotor.load, method="linear")
    assert found.coefficients[0, :, 0] == pytest.approx(x, rel=1e-12)
    roots = fixed.characteristic_roots()
    for s in roots.oscillatory:
        singular = s**2 * rotor.mass + s * damping + stiffness
        assert abs(np.linalg.det(singular)) < 1e-9


def test_matrices_of_zeros_are_no_matrices():
    system = vv.PolynomialSystem(mass=[1, 2], stiffness=[1, 2], gyroscopic=np.zeros((2, 2)))
    assert system.natural_frequencies() == pytest.approx([1, 1])


SPEED = "speed: must be given to the system"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"gyroscopic": [[0, 1], [1, 0]]},
            "gyroscopic: must be skew, has 1 in row 1, column 2 and 1 in row 2, column 1",
        ),
        (
            {"gyroscopic": [[0, 1], [1, 0]], "speed": 2},
            "gyroscopic: must be skew, has 1 in row 1, column 2 and 1 in row 2, column 1",
        ),
        ({"gyroscopic": [[0, 1, 2]]}, r"gyroscopic: must have shape \(2,\) or \(2, 2\), got"),
        ({"circulatory": [1, np.nan]}, r"circulatory\[1\] = nan: must be a finite number"),
        ({"centrifugal": "a"}, "centrifugal = 'a': must be numbers"),
        ({"speed": 1}, "speed: has no effect without gyroscopic, circulatory or centrifugal"),
        ({"centrifugal": [1, 1], "speed": "a"}, "speed = 'a': must be a real number"),
        ({"centrifugal": [1, 1], "speed": 1e200}, "stiffness .* must be a finite number"),
    ],
)
def test_wrong_matrices_are_named(given, message):
    with pytest.raises(vv.InputError, match=message):
        vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 1], **given)


@pytest.mark.parametrize(
    "analysis",
    [
        lambda s: vv.simulate(s, 5, initial=[0.1, 0, 0, 0]),
        lambda s: vv.simulate_ensemble(s, initial=np.ones(4), t_end=5),
        lambda s: vv.basins(s, {"x": [0, 1], "y": [0, 1]}, t_end=5),
        lambda s: vv.MultipleScales(s),
        lambda s: vv.backbone(s, 0, (0.01, 0.1)),
        lambda s: s.characteristic_roots(),
        lambda s: s.natural_frequencies(),
        lambda s: s.energy(np.zeros(4)),
        lambda s: vv.trace_motion(s, (0.5, 1), load={"x": 0.1}),
    ],
)
def test_an_analysis_without_a_speed_says_so(analysis):
    with pytest.raises(vv.InputError, match=SPEED):
        analysis(laval(0.1, 0.1))


def test_undamped_modes_refuse_a_gyroscopic_matrix():
    with pytest.raises(vv.InputError, match="gyroscopic: undamped modes omit it; use campbell"):
        overhung().at_speed(20).natural_frequencies()
    with pytest.raises(vv.InputError, match="gyroscopic: must be 0 for a backbone"):
        vv.backbone(overhung().at_speed(20), 0, (0.01, 0.1))


def test_more_than_512_coordinates_are_refused():
    n = 513
    with pytest.raises(vv.InputError, match="gyroscopic: 513 coordinates, must be 1 to 512"):
        vv.PolynomialSystem(mass=np.ones(n), stiffness=np.ones(n), gyroscopic=np.zeros((n, n)))


@pytest.mark.parametrize(
    "system",
    [
        vv.PolynomialSystem(mass=1, stiffness=1),
        vv.Body(mass=1, inertia=[1, 1, 1], mounts=[]),
    ],
)
def test_at_speed_refuses_a_system_without_these_matrices(system):
    with pytest.raises(vv.InputError, match="speed: has no effect without"):
        system.at_speed(2.0)


def test_wrong_parameters_of_an_ensemble_are_named():
    system = vv.PolynomialSystem(mass=1, stiffness=1)
    with pytest.raises(vv.InputError, match="parameters"):
        vv.simulate_ensemble(system, initial=[0, 0], t_end=1, parameters=b"nu")


def body_with_rotor(rng, **given):
    """A body on four mounts with cubic laws, and its matrices."""
    mounts = [
        vv.MountPoint(
            name=f"m{i}", position=(x, y, -0.1), stiffness=rng.uniform(1e4, 3e4, 3),
            damping=rng.uniform(50, 100, 3),
        )
        for i, (x, y) in enumerate([(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)])
    ]  # fmt: skip
    return vv.Body(mass=20.0, inertia=rng.uniform(0.5, 1.0, 3), mounts=mounts, **given)


@pytest.mark.parametrize("seed", range(2))
def test_the_rotor_of_a_body_turns_with_the_load(seed):
    """Reference: the steady rotor with the angular momentum of the speed, given as spin."""
    rng = np.random.default_rng(seed)
    rotor, spin = 0.3 * rng.normal(size=3), rng.normal(size=3)
    bodies = [
        body_with_rotor(np.random.default_rng(seed), rotor=rotor, spin=spin),
        *(body_with_rotor(np.random.default_rng(seed), spin=spin + at * rotor) for at in (30, 70)),
    ]
    load = bodies[0].unbalance(40.0, 0.02, (0.1, 0, 0.2), "x")
    for method in ("linear", "newton"):
        options = dict(load=load, method=method, stability=method == "newton")
        both = vv.forced_response(bodies[0], [30.0, 70.0], **options)
        for i, at in enumerate((30.0, 70.0)):
            steady = vv.forced_response(bodies[1 + i], [at], **options)
            turned = vv.forced_response(bodies[0].at_speed(at), [at], **options)
            for one in (steady, turned):
                assert both.coefficients[i] == pytest.approx(one.coefficients[0], rel=1e-9)
    run = vv.simulate(bodies[0], 1.0, load=load, nu=30.0)
    steady = vv.simulate(bodies[1], 1.0, load=load, nu=30.0)
    assert run.state[-1] == pytest.approx(steady.state[-1], rel=1e-9, abs=1e-12)
    diagram = vv.campbell(bodies[0], [0.0, 30.0, 70.0])
    roots = bodies[2].characteristic_roots().oscillatory
    assert np.sort(diagram.frequencies[2]) == pytest.approx(np.sort(roots.imag), rel=1e-8)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"geometry": "exact"}, "rotor: must be 0 with geometry = 'exact'"),
        ({"base_direction": "rx"}, "base_direction: must not turn the floor with a rotor"),
        ({"rotor": [1, 2]}, "rotor"),
    ],
)
def test_rotors_that_a_body_cannot_have_are_refused(given, message):
    with pytest.raises(vv.InputError, match=message):
        body_with_rotor(np.random.default_rng(1), **({"rotor": (0.1, 0, 0)} | given))


def test_what_a_body_with_a_rotor_has_not_is_refused():
    body = body_with_rotor(np.random.default_rng(1), rotor=(0.1, 0, 0))
    for analysis in (lambda: body.modes(), lambda: vv.simulate(body, 1.0)):
        with pytest.raises(vv.InputError, match=r"spin|speed"):
            analysis()
    with pytest.raises(vv.InputError, match="axis: must not turn the floor"):
        body.base_transmissibility([1.0], "rx")
    with pytest.raises(vv.InputError, match="base: must not turn the floor"):
        vv.forced_response(body, [1.0], base={"rx": 0.1})
