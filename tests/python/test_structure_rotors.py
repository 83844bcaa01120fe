"""Structures whose matrices depend on the speed, against full matrices and an integration."""

import pickle

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp
import viscovib as vv
from scipy.integrate import solve_ivp

FORMS = {"dense": np.asarray, "sparse": sp.csc_array}
OF_SPEED = ("gyroscopic", "circulatory", "centrifugal")


class Rotor:
    """A random damped structure with random matrices that depend on the speed."""

    def __init__(self, seed, n, *, kernel=None, form="dense", law="0.4*d^3"):
        rng = np.random.default_rng(seed)
        self.n, self.kernel = n, kernel
        root = rng.normal(size=(n, n)) / np.sqrt(n)
        self.mass = np.diag(rng.uniform(0.5, 2, n)) + 0.1 * root @ root.T
        chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        self.stiffness = chain + np.diag(rng.uniform(0.2, 0.6, n))
        self.damping = 0.05 * chain + 0.1 * np.eye(n)
        gyroscopic, circulatory, centrifugal = 0.1 * rng.normal(size=(3, n, n)) / np.sqrt(n)
        self.gyroscopic = gyroscopic - gyroscopic.T
        self.circulatory, self.centrifugal = 0.3 * circulatory, 0.3 * centrifugal
        self.rayleigh = (0.02, 0.01)
        self.place = n // 2
        elements = [vv.Spring(on=f"x{self.place + 1}", law=law)] if law else []
        if kernel is not None:
            elements.append(vv.Spring(on=("x1", "x2"), stiffness=0.7, kernel=kernel))
        make = FORMS[form]
        self.structure = vv.Structure(
            mass=make(self.mass), stiffness=make(self.stiffness), damping=make(self.damping),
            rayleigh=self.rayleigh, elements=elements,
            **{name: make(getattr(self, name)) for name in OF_SPEED},
        )  # fmt: skip

    def matrices(self, speed):
        """C and K at a speed, without memory."""
        a, b = self.rayleigh
        total = self.stiffness.copy()
        if self.kernel is not None:
            total[:2, :2] += 0.7 * np.array([[1, -1], [-1, 1]])
        damping = self.damping + a * self.mass + b * total + speed * self.gyroscopic
        return damping, total + speed * self.circulatory + speed**2 * self.centrifugal

    def dynamic_stiffness(self, nu, speed):
        damping, stiffness = self.matrices(speed)
        found = stiffness + 1j * nu * damping - nu**2 * self.mass
        if self.kernel is not None:
            lost = 0.7 * complex(self.kernel.transform(nu))
            found[:2, :2] -= lost * np.array([[1, -1], [-1, 1]])
        return found

    def state_matrix(self, speed):
        damping, stiffness = self.matrices(speed)
        inverse = np.linalg.inv(self.mass)
        upper = np.hstack([np.zeros_like(damping), np.eye(self.n)])
        return np.vstack([upper, np.hstack([-inverse @ stiffness, -inverse @ damping])])


def prony():
    return vv.PronyKernel(weights=[0.2], rates=[0.7])


@pytest.mark.parametrize(
    ("n", "remembers", "form"), [(5, True, "dense"), (40, False, "sparse"), (120, True, "sparse")]
)
def test_linear_responses_are_those_of_the_full_matrices(n, remembers, form):
    rotor = Rotor(n, n, kernel=prony() if remembers else None, form=form)
    nu = np.linspace(0.3, 2.4, 9)
    load = {1: {"x2": "0.1*nu^2"}, 2: {f"x{n}": 0.3 - 0.1j}}
    found = vv.forced_response(rotor.structure, nu, load=load, method="linear")
    at_speed = vv.forced_response(
        rotor.structure.at_speed(1.3), nu, load=load, method="linear",
        coordinates=rotor.structure.dof_names,
    )  # fmt: skip
    for result, speed in ((found, None), (at_speed, 1.3)):
        for i, at in enumerate(nu):
            first, second = np.zeros(n, complex), np.zeros(n, complex)
            first[1], second[-1] = 0.1 * at**2, 0.3 - 0.1j
            turn = at if speed is None else speed
            for j, (k, push) in enumerate(((1, first), (2, second))):
                x = np.linalg.solve(rotor.dynamic_stiffness(k * at, turn), push)
                assert result.coefficients[i, :, j] == pytest.approx(x, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("n", [3, 16, 30])
def test_motions_and_exponents_are_those_of_an_integration(n):
    rotor = Rotor(100, n)
    push = np.zeros(n)
    push[0] = 0.4
    nu = 0.7
    found = vv.forced_response(
        rotor.structure, [nu], load={"x1": 0.4}, method="newton", stability=True, tolerance=1e-10
    )
    damping, stiffness = rotor.matrices(nu)
    inverse, e = np.linalg.inv(rotor.mass), np.eye(n)[rotor.place]

    def flow(t, z):
        z = z.reshape(2 * n, -1)
        u, v = z[:n, 0], z[n:, 0]
        force = 0.4 * u[rotor.place] ** 3 * e
        tangent = stiffness + 1.2 * u[rotor.place] ** 2 * np.outer(e, e)
        rate = np.empty_like(z)
        rate[:n] = z[n:]
        rate[n:, 0] = inverse @ (push * np.sin(nu * t) - damping @ v - stiffness @ u - force)
        rate[n:, 1:] = -inverse @ (damping @ z[n:, 1:] + tangent @ z[:n, 1:])
        return rate.ravel()

    orders = 1j * found.harmonics * nu
    start = np.concatenate(
        [found.coefficients[0].imag.sum(axis=1), (found.coefficients[0] * orders).imag.sum(axis=1)]
    )
    begin = np.column_stack([start, np.eye(2 * n)]).ravel()
    run = solve_ivp(flow, (0, 2 * np.pi / nu), begin, method="DOP853", rtol=1e-11, atol=1e-12)
    last = run.y[:, -1].reshape(2 * n, -1)
    assert last[:, 0] == pytest.approx(start, abs=1e-7)
    largest = np.sort(np.abs(np.linalg.eigvals(last[:, 1:])))[::-1]
    own = np.sort(np.abs(found.multipliers[0][np.isfinite(found.multipliers[0])]))[::-1]
    assert own[:2] == pytest.approx(largest[:2], rel=1e-7)
    assert found.stable[0] == (largest[0] < 1)


def test_supports_are_removed_from_the_matrices():
    rotor = Rotor(5, 6)
    given = {name: getattr(rotor, name) for name in ("mass", "stiffness", "damping", *OF_SPEED)}
    held = vv.Structure(**given, supports=["x1", "x4"])
    keep = np.array([1, 2, 4, 5])
    free = vv.Structure(**{name: one[np.ix_(keep, keep)] for name, one in given.items()})
    options = dict(load=[0.1, 0, 0, 0], method="linear")
    for a, b in ((held, free), (held.at_speed(0.6), free.at_speed(0.6))):
        one, other = (vv.forced_response(s, [0.9], **options) for s in (a, b))
        assert one.coefficients == pytest.approx(other.coefficients, rel=1e-12)


def test_supports_on_which_these_matrices_act_do_not_move():
    rotor = Rotor(5, 6)
    given = {name: getattr(rotor, name) for name in ("mass", "stiffness", "damping", *OF_SPEED)}
    held = vv.Structure(**given, supports=["x1"])
    with pytest.raises(vv.InputError, match="supports must not move if gyroscopic"):
        vv.simulate(held.at_speed(1.0), 1.0, base={"x1": 0.1}, nu=1.0)
    with pytest.raises(vv.InputError, match="must not move supports"):
        vv.forced_response(held, [1.0], base={"x1": 0.1})
    with pytest.raises(vv.InputError, match="must not act on supports that move"):
        vv.Structure(**given, supports=["x1"], base_direction=[1.0])


def test_reactions_at_supports_include_these_matrices():
    """In time and in a response: what the full equations lack at the support."""
    rotor, nu = Rotor(5, 4), 1.3
    held = vv.Structure(
        mass=rotor.mass, stiffness=rotor.stiffness, damping=rotor.damping,
        **{name: getattr(rotor, name) for name in OF_SPEED}, speed=2.0, supports=["x2"],
    )  # fmt: skip
    run = vv.simulate(held, 2.0, dt=0.02, load={"x1": 1.0}, nu=nu)
    damping = rotor.damping + 2 * rotor.gyroscopic
    stiffness = rotor.stiffness + 2 * rotor.circulatory + 4 * rotor.centrifugal
    u, v, a = (
        np.insert(part, 1, 0, axis=1)
        for part in (run.state[:, ::2], run.state[:, 1::2], run.acceleration)
    )
    total = a @ rotor.mass + v @ damping.T + u @ stiffness.T
    np.testing.assert_allclose(run.support_reactions().force[:, 0], total[:, 1], atol=1e-12)
    response = vv.forced_response(held, [nu], load={"x1": 1.0})
    first = list(response.harmonics).index(1)
    row = (stiffness + 1j * nu * damping - nu**2 * rotor.mass)[1]
    reaction = row @ np.insert(response.coefficients[0][:, first], 1, 0)
    assert response.support_reactions()[0, 0, first] == pytest.approx(reaction, abs=1e-12)


def test_a_reduced_rotor_goes_by_its_modes():
    rotor = Rotor(9, 60, law=None)
    structure = vv.Structure(
        mass=rotor.mass, stiffness=rotor.stiffness, damping=rotor.damping,
        **{name: getattr(rotor, name) for name in OF_SPEED},
    )  # fmt: skip
    loads = list(structure.dof_names)
    modal = structure.reduce(frequency=3.0, loads=loads, tolerance=1e-10, max_modes=200).in_modes()
    load = modal.load({"x3": 0.1})
    small = vv.forced_response(modal.structure, [0.8], load=load, method="linear")
    whole = vv.forced_response(structure, [0.8], load={"x3": 0.1}, method="linear")
    found = modal.shapes @ small.coefficients[0, :, 0]
    assert found == pytest.approx(whole.coefficients[0, :, 0], rel=1e-8, abs=1e-10)


def test_elements_may_vary_and_structures_be_pickled():
    rotor = Rotor(13, 4)
    nu = 0.8
    branch = vv.trace_response(
        rotor.structure, load={"x1": 0.3}, nu=nu, vary="elements[0].stiffness",
        vary_range=(0.0, 0.5), at=[0.5], stability=False,
    )  # fmt: skip
    stiffer = vv.Structure(
        mass=rotor.mass, stiffness=rotor.stiffness, damping=rotor.damping, rayleigh=rotor.rayleigh,
        elements=[vv.Spring(on="x3", stiffness=0.5, law="0.4*d^3")],
        **{name: getattr(rotor, name) for name in OF_SPEED}, speed=nu,
    )  # fmt: skip
    wanted = vv.forced_response(stiffer, [nu], load={"x1": 0.3}, method="newton")
    again = pickle.loads(pickle.dumps(stiffer))
    same = vv.forced_response(again, [nu], load={"x1": 0.3}, method="newton")
    assert same.coefficients == pytest.approx(wanted.coefficients, rel=1e-12)
    assert branch.parameter[-1] == pytest.approx(0.5)


@pytest.mark.parametrize(
    "analysis",
    [
        lambda s: vv.simulate(s, 5),
        lambda s: s.characteristic_roots(),
        lambda s: vv.steady_motion(s, 1.0, load={"x1": 0.1}).speed,
        lambda s: vv.trace_motion(s, (0.5, 1), load={"x1": 0.1}),
        lambda s: vv.simulate_ensemble(s, initial=np.zeros(8), t_end=5),
        lambda s: s.deflections,
    ],
)
def test_an_analysis_without_a_speed_says_so(analysis):
    structure = Rotor(1, 4).structure
    with pytest.raises((vv.InputError, AttributeError), match="speed"):
        analysis(structure)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"gyroscopic": [[0, 1], [1, 0]]}, "gyroscopic: must be skew, has 1 in row 1, column 2"),
        ({"circulatory": [[0, 1, 2]]}, "circulatory: must have shape"),
        ({"speed": 1.0}, "speed: has no effect without gyroscopic"),
        ({"centrifugal": [1, 1], "speed": "a"}, "speed = 'a': must be a real number"),
        ({"centrifugal": [1, 1], "speed": 1e200}, "stiffness .*must be a finite number"),
        ({"centrifugal": [1, 1], "loss_factor": 0.1}, "loss_factor: must be 0 with centrifugal"),
    ],
)
def test_wrong_matrices_are_named(given, message):
    with pytest.raises(vv.InputError, match=message):
        vv.Structure(mass=[1, 1], stiffness=[1, 1], **given)


def test_what_is_not_available_is_refused():
    rotor = Rotor(2, 4)
    with pytest.raises(vv.InputError, match="gyroscopic: undamped modes omit it"):
        rotor.structure.natural_frequencies()
    with pytest.raises(vv.InputError, match="gyroscopic: must be 0 for a backbone"):
        vv.backbone(rotor.structure, 0, (0.01, 0.1))
    reduced = rotor.structure.reduce(frequency=1.0, loads=["x1"], tolerance=0.1)
    with pytest.raises(vv.InputError, match="in_modes"):
        vv.forced_response(reduced, [0.5], load={"x1": 0.1})
    with pytest.raises(vv.InputError, match="in_modes"):
        vv.simulate(reduced, 5, load={"x1": 0.1}, nu=0.5)
    found = vv.forced_response(rotor.structure, [0.5], load={"x1": 0.1})
    with pytest.raises(vv.InputError, match="at_speed"):
        found.dissipation()


def test_more_than_512_coordinates_are_refused_with_a_remedy():
    n = 520
    eye = sp.eye_array(n).tocsc()
    shaft = vv.Structure(mass=eye, stiffness=eye, damping=0.1 * eye, centrifugal=0.1 * eye)
    with pytest.raises(vv.InputError, match=r"at most 512 coordinates, has 520: use .*in_modes"):
        vv.forced_response(shaft, [0.5], load={"x1": 1.0}, method="linear")
    assert vv.forced_response(shaft.at_speed(0.5), [0.5], load={"x1": 1.0}).converged.all()


def test_modal_damping_is_that_at_rest():
    rotor = Rotor(4, 5)
    structure = vv.Structure(
        mass=rotor.mass,
        stiffness=rotor.stiffness,
        modal_damping=0.03,
        circulatory=rotor.circulatory,
    )
    squares, shapes = la.eigh(rotor.stiffness, rotor.mass)
    pushed = rotor.mass @ shapes
    damping = (pushed * (0.06 * np.sqrt(squares))) @ pushed.T
    nu = 0.9
    x = np.linalg.solve(
        rotor.stiffness + nu * rotor.circulatory + 1j * nu * damping - nu**2 * rotor.mass,
        np.eye(5)[0],
    )
    for system in (structure, structure.at_speed(nu)):
        found = vv.forced_response(system, [nu], load=1.0, method="linear")
        assert found.coefficients[0, :, 0] == pytest.approx(x, rel=1e-10)


ELEMENTS = {
    "spring with memory": lambda: vv.Spring(on="x2", stiffness=0.5, law="0.3*d^3", kernel=prony()),
    "law of rates": lambda: vv.Spring(on=("x1", "x3"), law="0.1*tanh(v) + 0.2*d^2"),
    "stop": lambda: vv.Stop(on="x2", gap=0.05, stiffness=2.0),
    "slider": lambda: vv.Jenkins(on="x2", stiffness=1.0, limit=0.05),
    "fluid damper": lambda: vv.FluidDamper(on="x3", coefficient=0.1, exponent=2.0),
    "coupling": lambda: vv.Coupling(
        on={"a": "x1", "b": "x4"}, law={"a": "0.5*a*b^2", "b": "0.5*a^2*b"}
    ),
}


@pytest.mark.parametrize("kind", ELEMENTS)
def test_elements_act_as_at_the_constant_speed(kind):
    rotor = Rotor(17, 5, law="0.1*d^3")
    structure = vv.Structure(
        mass=rotor.mass, stiffness=rotor.stiffness, damping=rotor.damping,
        layers=[(0.1 * np.eye(5), prony())],
        elements=[ELEMENTS[kind](), vv.Spring(on="x4", law="0.1*d^3")],
        **{name: getattr(rotor, name) for name in OF_SPEED},
    )  # fmt: skip
    loose = kind in ("stop", "slider", "fluid damper")
    options = dict(
        load={"x1": 0.3}, method="newton", harmonics=31 if loose else 11, stability=not loose,
        tolerance=1e-4 if loose else 1e-9,
    )  # fmt: skip
    for nu in (0.6, 1.3):
        one = vv.forced_response(structure, [nu], **options)
        other = vv.forced_response(structure.at_speed(nu), [nu], **options)
        assert one.converged.all()
        same = [np.flatnonzero(other.harmonics == k)[0] for k in one.harmonics[:3]]
        own = one.coefficients[0][:, :3]
        size = np.abs(own).max()
        near = 1e-5 if loose else 1e-8
        assert own == pytest.approx(other.coefficients[0][:, same], abs=near * size)
        if not loose:
            assert one.stable[0] == other.stable[0]
            growth = one.exponents[0, 0].real
            assert growth == pytest.approx(other.exponents[0, 0].real, rel=1e-6)
