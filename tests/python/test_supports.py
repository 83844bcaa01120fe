"""Structures on supports that are fixed or move: full matrices, and reactions."""

import numpy as np
import pytest
import scipy.sparse as sp
import viscovib as vv
from referee.integration import solve_ivp
from scipy.interpolate import PPoly

NAMES = [f"u{i}" for i in range(5)]
FREE, HELD = [0, 2, 4], [3, 1]
MOVED = np.array([0.5, 1.0])


def _definite(rng, n, size=1.0):
    a = rng.normal(size=(n, n))
    return size * (a @ a.T / n + 0.3 * np.eye(n))


def _matrices(rng, n=5):
    return {
        "mass": _definite(rng, n), "stiffness": _definite(rng, n, 10.0),
        "damping": _definite(rng, n, 0.2),
    }  # fmt: skip


def _structure(given, **more):
    return vv.Structure(
        **given, **({"names": NAMES, "supports": ["u3", "u1"], "base_direction": MOVED} | more)
    )


def _e(i, j):
    e = np.zeros(5)
    e[[i, j]] = 1.0, -1.0
    return e


@pytest.mark.parametrize("seed", range(4))
def test_linear_response_and_reactions_solve_the_full_equations(seed):
    rng = np.random.default_rng(seed)
    given, kernel = _matrices(rng), vv.PronyKernel(weights=[0.2], rates=[1.5])
    springs = [
        vv.Spring(on=("u2", "u1"), stiffness=3.0, damping=0.1, kernel=kernel),
        vv.Spring(on=("u4", "u3"), stiffness=2.0),
    ]
    structure = _structure(given, elements=springs[: seed % 3])
    base = {0: 0.05j, 1: 0.2 - 0.1j, 2: 0.03}
    nu = rng.uniform(0.3, 4, 3)
    r = vv.forced_response(structure, nu, load={"u0": 0.3, "u4": 0.1j}, base=base, method="linear")
    reactions = r.support_reactions()
    assert structure.dof_names == r.dof_names == ("u0", "u2", "u4")
    for i, w in enumerate(nu):
        for j, k in enumerate(r.harmonics):
            s = 1j * k * w
            full = given["mass"] * s**2 + given["damping"] * s + given["stiffness"]
            if seed % 3 > 0:
                recalled = kernel.laplace(s) if k else kernel.integral
                full = full + (3 * (1 - recalled) + 0.1 * s) * np.outer(_e(2, 1), _e(2, 1))
            if seed % 3 > 1:
                full = full + 2 * np.outer(_e(4, 3), _e(4, 3))
            u = np.zeros(5, complex)
            u[HELD] = MOVED * base[k]
            p = np.zeros(5, complex)
            if k == 1:
                p[[0, 4]] = 0.3, 0.1j
            u[FREE] = np.linalg.solve(
                full[np.ix_(FREE, FREE)], p[FREE] - full[np.ix_(FREE, HELD)] @ u[HELD]
            )
            assert np.allclose(r.coefficients[i][:, j], u[FREE], rtol=0, atol=1e-13)
            assert np.allclose(reactions[i][:, j], (full @ u)[HELD], rtol=0, atol=2e-12)


@pytest.mark.parametrize("seed", range(2))
def test_nonlinear_elements_on_a_moving_support(seed):
    # The balance of harmonics, with forces sampled in time, on all coordinates.
    rng = np.random.default_rng(seed)
    given = _matrices(rng)
    laws = {_e_name: law for _e_name, law in (("u2", "0.7*d^3"), ("u4", "0.2*d^2 + 0.5*d^3"))}
    elements = [
        vv.Spring(on=("u2", "u1"), stiffness=3.0, law=laws["u2"]),
        vv.Spring(on=("u4", "u3"), damping=0.1, law=laws["u4"]),
    ]
    structure = _structure(given, elements=elements)
    r = vv.forced_response(
        structure, [1.3], load={"u0": 0.4}, base=0.3, method="newton", harmonics=40
    )
    assert r.complete
    k, w = r.harmonics, 1.3
    x = np.zeros((5, k.size), complex)
    x[FREE] = r.coefficients[0]
    x[np.ix_(HELD, np.flatnonzero(k == 1))] = 0.3 * MOVED[:, np.newaxis]
    theta = 2 * np.pi * np.arange(512) / 512
    waves = np.exp(1j * np.outer(k, theta))
    u, v, a = ((x * (1j * k * w) ** p) @ waves for p in range(3))
    d, e = (_e(2, 1) @ u.imag), (_e(4, 3) @ u.imag)
    forces = np.outer(_e(2, 1), 3 * d + 0.7 * d**3)
    forces += np.outer(_e(4, 3), 0.1 * (_e(4, 3) @ v.imag) + 0.2 * e**2 + 0.5 * e**3)
    total = given["mass"] @ a.imag + given["damping"] @ v.imag + given["stiffness"] @ u.imag
    total += forces
    total[0] -= 0.4 * np.sin(theta)
    assert np.abs(total[FREE]).max() < 1e-9
    reactions = (r.support_reactions()[0] @ waves).imag
    assert np.allclose(reactions, total[HELD], rtol=0, atol=1e-9)


def _full(given, base, gap):
    """Accelerations of the free coordinates, and reactions, of the nonlinear test structure."""
    inverse, coupled = np.linalg.inv(given["mass"][FREE][:, FREE]), given["mass"][FREE][:, HELD]
    one, other = _e(2, 1), _e(4, 3)

    def forces(t, x):
        u, v, a = np.zeros((3, 5))
        u[FREE], v[FREE] = x[:3], x[3:]
        for part, moved in zip((u, v, a), base(t), strict=True):
            part[HELD] = MOVED * moved
        d = u[2] - u[1]
        rest = given["damping"] @ v + given["stiffness"] @ u
        rest += (3 * d + 0.7 * d**3 + 0.1 * (v[2] - v[1])) * one
        if gap is not None:
            rest += 20 * max(u[4] - u[3] - gap, 0) * other
        a[FREE] = inverse @ (-rest[FREE] - coupled @ a[HELD])
        return a[FREE], (given["mass"] @ a + rest)[HELD]

    return forces


@pytest.mark.parametrize("seed", range(4))
def test_motions_in_time_and_reactions_follow_the_full_equations(seed):
    rng = np.random.default_rng(100 + seed)
    given, table = _matrices(rng), seed % 2 == 1
    gap = 0.1 if seed % 4 > 1 else None
    elements = [vv.Spring(on=("u2", "u1"), stiffness=3.0, damping=0.1, law="0.7*d^3")]
    if gap is not None:
        elements.append(vv.Gap(on=("u4", "u3"), gap=gap, stiffness=20.0))
    structure = _structure(given, elements=elements)
    end, w, size = 4.0, 1.3, 0.2
    times = np.linspace(0, 5, 9)
    moved = vv.LoadTable(times=times, values=size * np.sin(2 * times), interpolation="cubic")

    pieces = PPoly(moved._base_pieces()[:, 0, : times.size - 1], times)
    slopes = [pieces, pieces.derivative(), pieces.derivative(2)]
    fine = np.linspace(0, 5, 99)
    np.testing.assert_allclose(pieces(fine), moved(fine), rtol=0, atol=1e-15)

    def base(t):
        if table:
            return [float(one(t)) for one in slopes]
        return size * np.sin(w * t), size * w * np.cos(w * t), -size * w**2 * np.sin(w * t)

    call = {"base": moved} if table else {"base": size, "nu": w}
    run = vv.simulate(structure, end, initial=[0.1, 0, 0, 0.2, -0.1, 0], **call)
    full = _full(given, base, gap)
    found = solve_ivp(
        lambda t, x: np.concatenate([x[3:], full(t, x)[0]]), (0, end),
        [0.1, 0, -0.1, 0, 0.2, 0], "DOP853", rtol=1e-11, atol=1e-12, max_step=0.02,
    ).y[:, -1]  # fmt: skip
    accurate = 1e-9 if gap is None else 1e-7
    assert run.outcome == "completed"
    assert np.allclose(
        np.r_[run.state[-1, 0::2], run.state[-1, 1::2]], found, rtol=0, atol=accurate
    )
    acceleration, reaction = full(end, found)
    assert np.allclose(run.acceleration[-1], acceleration, rtol=0, atol=20 * accurate)
    reactions = run.support_reactions()
    assert reactions.names == ("u3", "u1")
    assert np.allclose(reactions.force[-1], reaction, rtol=0, atol=50 * accurate)
    assert np.array_equal(reactions.of("u1"), reactions.force[:, 1])


def test_sparse_reduced_and_written_structures_are_the_same(tmp_path):
    rng = np.random.default_rng(3)
    n = 60
    k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    m = (4 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)) / 6
    given = {"mass": m, "stiffness": 100 * k, "damping": 0.05 * k + 0.01 * np.eye(n)}
    more = {
        "supports": ["x1", f"x{n}"], "base_direction": [1.0, 0.7],
        "elements": [vv.Spring(on=("x30", "x1"), stiffness=0.5, law="d^3")],
    }  # fmt: skip
    call = {"load": {"x20": 0.1}, "base": 0.02, "method": "newton", "harmonics": 9}
    nu = rng.uniform(0.5, 2, 3)
    dense = vv.Structure(**given, **more)
    expected = vv.forced_response(dense, nu, **call)
    sparse = vv.Structure(**{name: sp.csc_array(one) for name, one in given.items()}, **more)
    dense.write(tmp_path / "bar.npz")
    again = vv.Structure.read(tmp_path / "bar.npz", elements=more["elements"])
    reduced = sparse.reduce(frequency=40.0, tolerance=1e-9, loads=["x20"])
    for other, accurate in ((sparse, 1e-12), (again, 1e-14), (reduced, 1e-7)):
        r = vv.forced_response(other, nu, **call)
        size = np.abs(expected.coefficients).max()
        reactions = expected.support_reactions()
        wanted = expected.at(r.dof_names).coefficients
        assert other.supports == ("x1", "x60")
        assert np.allclose(r.coefficients, wanted, rtol=0, atol=accurate * size)
        assert np.allclose(
            r.support_reactions(), reactions, rtol=0, atol=200 * accurate * np.abs(reactions).max()
        )


def test_a_base_that_deforms_nothing_may_be_given_by_its_acceleration():
    # A chain that hangs on one support, with a mass matrix that couples it to the support.
    k = np.array([[4.0, -4, 0], [-4, 7, -3], [0, -3, 3]])
    m = np.array([[2.0, 0.5, 0], [0.5, 1.0, 0.2], [0, 0.2, 1.5]])
    chain = vv.Structure(
        mass=m, stiffness=k, damping=0.02 * k, supports=["x1"], base_direction=[1.0]
    )
    w, size = 1.1, 0.1
    by_base = vv.simulate(chain, 10, base=size, nu=w, initial=[0, w * size, 0, w * size])
    by_push = vv.simulate(chain, 10, base_acceleration=-(w**2) * size, nu=w, times=[10.0])
    moved = size * np.sin(10 * w), w * size * np.cos(10 * w)
    assert np.allclose(by_base.state[-1] - np.tile(moved, 2), by_push.state[-1], atol=1e-12)
    assert np.allclose(
        by_base.support_reactions().force[-1], by_push.support_reactions().force[-1], atol=1e-11
    )
    stuck = vv.Structure(
        mass=m, stiffness=k, damping=[0, 0.1, 0], supports=["x1", "x3"], base_direction=[1.0, 0.0]
    )
    with pytest.raises(vv.InputError, match="base_acceleration: the base deforms springs"):
        vv.simulate(stuck, 10, base_acceleration=1.0, nu=1.0)


def test_supports_without_base_direction_are_fixed():
    k = np.array([[4.0, -4, 0], [-4, 7, -3], [0, -3, 3]])
    fixed = vv.Structure(mass=[1.0, 2, 0], stiffness=k, supports=["x3"])
    plain = vv.Structure(mass=[1.0, 2], stiffness=k[:2, :2])
    assert np.array_equal(fixed.natural_frequencies(), plain.natural_frequencies())
    run = vv.simulate(fixed, 3, initial=[0.1, 0, 0, 0])
    assert np.array_equal(run.state, vv.simulate(plain, 3, initial=[0.1, 0, 0, 0]).state)
    assert np.allclose(run.support_reactions().of("x3"), -3 * run.state[:, 2], rtol=0, atol=1e-14)
    with pytest.raises(vv.InputError, match="base: this system has no base_direction"):
        vv.forced_response(fixed, [1.0], base=0.1)


def test_numbers_of_elements_may_vary():
    rng = np.random.default_rng(5)
    spring = vv.Spring(on=("u2", "u1"), stiffness=3.0, law="k3*d^3", parameters={"k3": 0.7})
    structure = _structure(_matrices(rng), elements=[spring])
    branch = vv.trace_response(
        structure, vary="elements[0].k3", vary_range=(0.2, 1.0), nu=1.3, base=0.3, load={"u0": 0.4},
        harmonics=9,
    )  # fmt: skip
    stiffer = structure._with_parameters({"elements[0].k3": 1.0})
    r = vv.forced_response(stiffer, [1.3], base=0.3, load={"u0": 0.4}, method="newton", harmonics=9)
    assert np.allclose(branch.coefficients[-1], r.coefficients[0], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"supports": "u1"}, "supports = 'u1': must be a list of names"),
        ({"supports": 1.5}, "supports = 1.5: must be a list of names"),
        ({"supports": ["v1"]}, "supports: 'v1' must be one of the 5 coordinates u0, ..."),
        ({"supports": ["u1", "u1"]}, "supports: must differ"),
        ({"supports": NAMES}, "supports: all coordinates are supports"),
        ({"base_direction": [1.0]}, r"base_direction: must have shape \(2,\), the motion of"),
        ({"elements": [vv.Spring(on=("u1", "u3"), stiffness=1)]}, r"elements\[0\]: acts on supp"),
        (
            {"elements": [vv.Spring(on=("u0", name), stiffness=1) for name in ("u1", "u3")]},
            "elements: the base stretches deflection",
        ),
    ],
)
def test_bad_supports(more, message):
    with pytest.raises(vv.InputError, match=message):
        _structure(_matrices(np.random.default_rng(1)), **more)


def test_reactions_need_supports():
    k = np.array([[4.0, -4], [-4, 7]])
    plain = vv.Structure(mass=[1.0, 2], stiffness=k)
    with pytest.raises(vv.InputError, match="support_reactions: this system has no supports"):
        vv.simulate(plain, 1, initial=[1, 0, 0, 0]).support_reactions()
    with pytest.raises(vv.InputError, match="support_reactions: this system has no supports"):
        vv.forced_response(plain, [1.0], load={"x1": 1.0}).support_reactions()
    with pytest.raises(vv.InputError, match="support_reactions: this system has no supports"):
        vv.simulate(vv.PolynomialSystem(mass=1, stiffness=1), 1, initial=[1, 0]).support_reactions()
    turned = vv.Structure(
        mass=[1.0, 2], stiffness=k, gyroscopic=[[0, 0.1], [-0.1, 0]], supports=["x2"]
    )
    with pytest.raises(vv.InputError, match="act on a support: give speed"):
        vv.simulate(turned, 1, load={"x1": 1.0}, nu=2.0).support_reactions()
    kernel = vv.PronyKernel(weights=[0.2], rates=[1.0])
    rubber = vv.Structure(
        mass=[1.0, 0.0], stiffness=np.zeros((2, 2)), supports=["x2"],
        layers=[(np.array([[1.0, -1], [-1, 1]]), kernel)],
    )  # fmt: skip
    with pytest.raises(vv.InputError, match="support_reactions: a layer with memory acts on"):
        vv.simulate(rubber, 1, initial=[1, 0]).support_reactions()


SCENE = """&structure
  coordinates = 'u0' 'u1' 'u2' 'u3'
  mass = 2 0.5 0 0  0.5 1 0.2 0  0 0.2 1.5 0.3  0 0 0.3 1
  stiffness = 4 -4 0 0  -4 7 -3 0  0 -3 5 -2  0 0 -2 2
  damping = {damping}
  supports = {supports}
  base_direction = {moved}
/
&element on = 'u2' 'u0', stiffness = 0.5, law = '{law}' /
&load kind = 'base', amplitude = 0.1 /
"""
PLAIN = "0.08 -0.08 0 0 -0.08 0.14 -0.06 0 0 -0.06 0.1 -0.04 0 0 -0.04 0.04"


def _scene(tmp_path, analysis, **changes):
    given = {"damping": PLAIN, "supports": "'u0'", "moved": "1", "law": "0.8*d^3"} | changes
    path = tmp_path / "scene.nml"
    path.write_text(SCENE.format(**given) + analysis)
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"supports": "'v0'"}, "supports: 'v0' must be one of the 4 coordinates"),
        ({"supports": "'u0' 'u0'", "moved": "1 1"}, "supports: must differ"),
        ({"supports": "'u0' 'u1' 'u2' 'u3'"}, "supports: all coordinates are supports"),
        ({"moved": "1 1"}, "base_direction has 2 values: must be 1, of the supports, or 4"),
        ({"supports": "'u0' 'u2'", "moved": "1 1"}, "&element 1: acts on supports only"),
    ],
)
def test_bad_supports_of_scenes(tmp_path, changes, message):
    path = _scene(tmp_path, "&transient t_end = 1, nu = 1.1 /", **changes)
    with pytest.raises(vv.InputError, match=message):
        vv.run(path)


def _each_on_its_own(rng, given, n_elements, **more):
    """The structure with linear elements at the supports, and its full K and C."""
    k, c = given["stiffness"].copy(), given["damping"].copy()
    elements = []
    for i, j in ((2, 1), (4, 3))[:n_elements]:
        spring, damper = rng.uniform(1, 3), rng.uniform(0.05, 0.2)
        elements.append(vv.Spring(on=(f"u{i}", f"u{j}"), stiffness=spring, damping=damper))
        k += spring * np.outer(_e(i, j), _e(i, j))
        c += damper * np.outer(_e(i, j), _e(i, j))
    more = {"base_direction": None} | more
    more["elements"] = [*elements, *more.get("elements", [])]
    return _structure(given, **more), k, c


def test_branches_over_motions_of_supports_and_of_structures_that_are_reduced():
    rng = np.random.default_rng(12)
    law = vv.Spring(on=("u0", "u2"), law="2*d^3")
    structure, _, _ = _each_on_its_own(rng, _matrices(rng), 1, elements=[law])
    call = {"base": {"u1": 0.2, "u3": 0.1j}, "harmonics": 9, "stability": True}
    branch = vv.trace_response(structure, nu_range=(0.6, 1.5), **call)
    r = vv.forced_response(structure, branch.nu[::4], method="newton", **call)
    size = np.abs(r.coefficients).max()
    assert np.allclose(branch.coefficients[::4], r.coefficients, rtol=0, atol=1e-8 * size)
    assert np.allclose(
        branch.support_reactions()[::4], r.support_reactions(), rtol=0, atol=1e-7 * size
    )
    assert (branch.stable[::4] == r.stable).all()
    run = vv.simulate(structure, 400, base=call["base"], nu=float(branch.nu[4]), keep="last")
    late = branch.coefficients[4] * np.exp(1j * branch.harmonics * branch.nu[4] * 400)
    if branch.stable[4]:
        assert np.allclose(run.state[-1, ::2], late.imag.sum(axis=1), rtol=0, atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_supports_that_move_each_on_its_own_in_time(seed):
    rng = np.random.default_rng([9, seed])
    given, w = _matrices(rng), 1.3
    stop = vv.Gap(on=("u0", "u2"), gap=0.1, stiffness=20.0)
    law = vv.Spring(on=("u0", "u4"), law="0.7*d^3")
    others = [law, stop] if seed % 2 else [law]
    structure, k, c = _each_on_its_own(rng, given, seed % 3, elements=others)
    times = np.linspace(0, 5, 9)
    record = vv.LoadTable(times=times, values=0.2 * np.sin(2 * times) ** 2, interpolation="cubic")
    moved = [PPoly(record._base_pieces()[:, 0, : times.size - 1], times)]
    moved += [moved[0].derivative(), moved[0].derivative(2)]

    def full(t, x):
        u, v, a = np.zeros((3, 5))
        u[FREE], v[FREE] = x[:3], x[3:]
        u[1], v[1], a[1] = (float(one(t)) for one in moved)
        u[3], v[3], a[3] = (np.imag(0.2 * (1j * w) ** p * np.exp(1j * w * t)) for p in range(3))
        d = u[0] - u[2]
        rest = c @ v + k @ u + 0.7 * (u[0] - u[4]) ** 3 * _e(0, 4)
        if seed % 2:
            rest += 20 * max(d - 0.1, 0) * _e(0, 2)
        rest[0] -= 0.3 * np.sin(w * t)
        pushed = -rest[FREE] - given["mass"][np.ix_(FREE, HELD)] @ a[HELD]
        a[FREE] = np.linalg.solve(given["mass"][np.ix_(FREE, FREE)], pushed)
        return a[FREE], (given["mass"] @ a + rest)[HELD], u, v

    start, end = [0.1, 0, 0, 0.2, -0.1, 0], 4.0
    call = {"load": {"u0": 0.3}, "nu": w, "base": {"u1": record, "u3": 0.2}}
    run = vv.simulate(structure, end, initial=start, **call)
    found = solve_ivp(
        lambda t, x: np.concatenate([x[3:], full(t, x)[0]]), (0, end),
        [*start[::2], *start[1::2]], "DOP853", rtol=1e-11, atol=1e-12, max_step=0.02,
    ).y[:, -1]  # fmt: skip
    accurate = 1e-7 if seed % 2 else 1e-9
    assert np.allclose(np.r_[run.state[-1, ::2], run.state[-1, 1::2]], found, rtol=0, atol=accurate)
    acceleration, reaction, u, v = full(end, found)
    assert np.allclose(run.acceleration[-1], acceleration, rtol=0, atol=20 * accurate)
    force = run.support_reactions().force[-1]
    assert np.allclose(force, reaction, rtol=0, atol=50 * accurate)
    own = run.element_forces()
    for e, (i, j) in enumerate(((2, 1), (4, 3))[: seed % 3]):
        one = structure.elements[e]
        pull = one.stiffness * (u[i] - u[j]) + one.damping * (v[i] - v[j])
        assert abs(own.force[-1, e] - pull) < 20 * accurate
    half = vv.simulate(structure, end / 2, initial=start, **call)
    later = vv.simulate(structure, end, resume=half)
    assert np.allclose(later.support_reactions().force[-1], force, rtol=0, atol=50 * accurate)


@pytest.mark.parametrize(
    ("base", "message"),
    [
        ({"u2": 0.1}, r"base = 'u2': must be one of 'u3', 'u1'"),
        ({"u3": "t"}, r"base\['u3'\] = 't': must be a number or \{order: number\}"),
        ({"u1": 0.1}, r"base\['u1'\]: elements\[0\] is not a linear spring or damper"),
    ],
)
def test_bad_motions_of_supports(base, message):
    spring = vv.Spring(on=("u2", "u1"), law="d^3")
    structure = _structure(_matrices(np.random.default_rng(1)), elements=[spring])
    with pytest.raises(vv.InputError, match=message):
        vv.forced_response(structure, [1.0], base=base)
    with pytest.raises(vv.InputError, match=message):
        vv.simulate(structure, 1.0, base=base, nu=1.0)
