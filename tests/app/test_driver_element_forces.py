"""The standalone driver: tables of forces of elements and springs, and of reactions at supports."""

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from test_driver_forces import read_csv

PARTS = ("", "_elastic", "_damping", "_memory", "_deflection", "_rate", "_work", "_dissipated")
KERNEL = "&kernel kind='prony' weights=0.3 0.6 rates=1 5 /\n"
PRONY = vv.PronyKernel(weights=[0.3, 0.6], rates=[1, 5])
NU, END, STEP = 1.3, 2.0, 0.02


def relaxed(elastic):
    """-R * g for the kernel of the scenes, at the last time, of a force that is 0 before t = 0."""
    spline = CubicSpline(STEP * np.arange(elastic.size), elastic)
    end = STEP * (elastic.size - 1)
    rest = [quad(lambda s, w=w, r=r: w * np.exp(-r * (end - s)) * spline(s), 0, end, limit=200)[0]
            for w, r in ((0.3, 1), (0.6, 5))]  # fmt: skip
    return -sum(rest)


#: Keys of the scene, the element of Python, and its force without damping and memory.
ELEMENTS = {
    "linear": (
        "stiffness=1.5 damping=0.2", lambda on: vv.Spring(on=on, stiffness=1.5, damping=0.2),
        lambda d, v: 1.5 * d,
    ),
    "cubic": (
        "stiffness=0.5 law='0.4*d^3 - 0.2*d^2'",
        lambda on: vv.Spring(on=on, stiffness=0.5, law="0.4*d^3 - 0.2*d^2"),
        lambda d, v: 0.5 * d + 0.4 * d**3 - 0.2 * d**2,
    ),
    "rubber": (
        "stiffness=2 law='0.3*d^3'",
        lambda on: vv.Spring(on=on, stiffness=2, law="0.3*d^3", kernel=PRONY),
        lambda d, v: 2 * d + 0.3 * d**3,
    ),
    "function": (
        "law='0.3*tanh(2*d) + 0.1*v*abs(v)'",
        lambda on: vv.Spring(on=on, law="0.3*tanh(2*d) + 0.1*v*abs(v)"),
        lambda d, v: 0.3 * np.tanh(2 * d) + 0.1 * v * np.abs(v),
    ),
    "friction": ("law='0.3*sign(v)'", lambda on: vv.Spring(on=on, law="0.3*sign(v)"), None),
    "slider": (
        "hysteresis='jenkins' hysteresis_numbers=2 0.1",
        lambda on: vv.Jenkins(on=on, stiffness=2, limit=0.1), None,
    ),
    "series": (
        "series_stiffness=3 fluid_coefficient=0.7 fluid_exponent=0.6",
        lambda on: vv.Maxwell(on=on, stiffness=3, coefficient=0.7, exponent=0.6), None,
    ),
}  # fmt: skip
#: Kinds of supports, and two elements, of which the second acts on a support.
CASES = [
    ("none", "series", "linear"), ("none", "function", "cubic"), ("fixed", "friction", "rubber"),
    ("base", "slider", "rubber"), ("apart", "rubber", "linear"), ("shock", "cubic", "rubber"),
]  # fmt: skip


def matrix_text(matrix):
    return " ".join(f"{x:.17g}" for x in np.asarray(matrix).ravel())


def random_structure(case):
    """Scene, call of Python, matrices, directions of the elements, and motion of the supports."""
    kind, *elements = case
    rng = np.random.default_rng([83, CASES.index(case)])
    n = 3 if kind == "none" else 5
    k = 6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    k[0, 0] = k[-1, -1] = 6
    m = np.diag(rng.uniform(1, 2, n)) + 0.1 * (np.eye(n, k=1) + np.eye(n, k=-1))
    c = 0.01 * k
    if kind != "shock":
        a = rng.normal(size=(n, n))
        k, c = k + 0.5 * a @ a.T, c + 0.02 * a @ a.T
    names = [f"u{i}" for i in range(n)]
    e = np.zeros((2, n))
    e[0, [0, 1]] = 1, -1
    e[1, [2, n - 1 if n > 3 else 1]] = 1, -1
    scene = (
        f"{KERNEL}&structure coordinates={' '.join(map(repr, names))} mass={matrix_text(m)} "
        f"stiffness={matrix_text(k)} damping={matrix_text(c)}"
    )
    more = {}
    if kind != "none":
        scene += " supports='u3' 'u4'"
        more["supports"] = ["u3", "u4"]
    if kind in ("base", "shock"):
        direction = [1.0, 1.0] if kind == "shock" else [1.0, 0.7]
        scene += " base_direction=" + matrix_text(direction)
        more["base_direction"] = direction
    scene += " /\n"
    ends = [("u0", "u1"), ("u2", names[-1] if n > 3 else "u1")]
    for name, (i, j) in zip(elements, ends, strict=True):
        kernel = int(name == "rubber")
        scene += f"&element on='{i}' '{j}' {ELEMENTS[name][0]} kernel={kernel} /\n"
    scene += "&load on='u1' amplitude=0.9 /\n"
    given = {"load": {"u1": 0.9}, "nu": NU}
    if kind == "base":
        scene += "&load kind='base' amplitude=0.2 /\n"
        given["base"] = 0.2
    elif kind == "apart":
        scene += "&load kind='base' on='u3' amplitude=0.2 /\n"
        scene += "&load kind='base' on='u4' amplitude=0.1 phase=0.5 order=2 /\n"
        given["base"] = {"u3": 0.2, "u4": {2: 0.1 * np.exp(0.5j)}}
    elif kind == "shock":
        scene += "&load kind='acceleration' shape='half_sine' amplitude=3 duration=0.7 /\n"
        given["base_acceleration"] = vv.LoadTable.half_sine(3.0, 0.7)
    free = 3 + elements.count("series")
    given["initial"] = np.round(rng.uniform(-0.2, 0.2, 2 * free), 4)
    if kind in ("base", "shock"):
        # Without impact at the start.
        given["initial"] *= 0
    system = vv.Structure(
        mass=m, stiffness=k, damping=c, names=names,
        elements=[ELEMENTS[name][1](on) for name, on in zip(elements, ends, strict=True)], **more,
    )  # fmt: skip
    keys = f"dt={STEP} initial={matrix_text(given['initial'])}"
    scene += (
        f"&transient nu={NU} t_end={END} {keys} acceleration='yes' forces='yes' peaks='yes' /\n"
    )
    return scene, system, given, (m, c, k), e


def support_motion(kind, t):
    """Displacements, velocities and accelerations of both supports, shape (3, n, 2)."""
    found = np.zeros((3, t.size, 2))
    amplitudes = {"base": ((0.2, NU), (0.14, NU)),
                  "apart": ((0.2, NU), (0.1 * np.exp(0.5j), 2 * NU))}  # fmt: skip
    for j, (a, w) in enumerate(amplitudes.get(kind, ())):
        for p in range(3):
            found[p, :, j] = (a * (1j * w) ** p * np.exp(1j * w * t)).imag
    if kind == "shock":
        found[2] = np.where(t < 0.7, 3 * np.sin(np.pi * t / 0.7), 0)[:, None]
    return found


def tables_of(solve, folder, text, names):
    """The tables of the driver by their names."""
    scene = folder / "scene.nml"
    scene.write_text(text)
    done = solve(scene, "--out", folder)
    assert done.returncode == 0, done.stderr
    return {name: read_csv(folder / f"scene_{name}.csv") for name in names}


def check_parts(table, names, forces, near):
    """The columns of a table are the arrays of Python."""
    arrays = {"": forces.force, "_elastic": forces.elastic, "_damping": forces.damping,
              "_memory": forces.memory, "_deflection": forces.deflection, "_rate": forces.rate,
              "_work": forces.work, "_dissipated": forces.dissipated}  # fmt: skip
    assert list(table)[1:] == [f"{name}{part}" for name in names for part in PARTS]
    size = np.abs(forces.force).max()
    for part in PARTS:
        largest = max(size, np.abs(arrays[part]).max())
        for j, name in enumerate(names):
            np.testing.assert_allclose(
                table[name + part], arrays[part][:, j], rtol=0, atol=near * largest,
                err_msg=name + part,
            )  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_forces_in_random_structures(solve, tmp_path, case):
    """Driver, Python and the full equations, of free coordinates and of supports, agree."""
    kind, *elements = case
    text, system, given, (m, c, k), e = random_structure(case)
    names = ["transient", "forces", "peaks"] + ["reactions"] * (kind != "none")
    tables = tables_of(solve, tmp_path, text, names)
    forces, motion = tables["forces"], tables["transient"]
    run = vv.simulate(system, END, dt=STEP, **given)
    own = run.element_forces()
    check_parts(forces, ("element1", "element2"), own, 1e-10)
    size = np.abs(own.force).max()

    t = forces["t"]
    u, v, a = (
        np.stack([motion[f"u{i}{dot}"] for i in range(3)], axis=1) for dot in ("", "_dot", "_ddot")
    )
    if kind != "none":
        ends = support_motion(kind, t)
        u, v, a = (np.hstack(pair) for pair in zip((u, v, a), ends, strict=True))
    both = np.stack([forces["element1"], forces["element2"]], axis=1)
    total = a @ m + v @ c + u @ k + both @ e
    total[:, 1] -= 0.9 * np.sin(NU * t)
    # Laws with kinks have no unique acceleration at the kink.
    near = 1e-9 if kind == "shock" or "function" in case else 1e-11
    assert np.abs(total[:, :3]).max() < near * np.abs(u @ k).max()
    if kind != "none":
        reactions = tables["reactions"]
        found = np.stack([reactions["reaction_u3"], reactions["reaction_u4"]], axis=1)
        assert np.abs(found - total[:, 3:]).max() < near * np.abs(found).max()
        force = run.support_reactions().force
        np.testing.assert_allclose(found, force, rtol=0, atol=1e-10 * np.abs(force).max())
    for j, name in enumerate(elements):
        column = {part: forces[f"element{j + 1}{part}"] for part in PARTS}
        d, rate = column["_deflection"], column["_rate"]
        np.testing.assert_allclose(d, u @ e[j], atol=1e-12)
        np.testing.assert_allclose(rate, v @ e[j], atol=1e-12)
        if ELEMENTS[name][2] is not None:
            elastic = ELEMENTS[name][2](d, rate)
            np.testing.assert_allclose(column["_elastic"], elastic, atol=1e-12)
        if name == "rubber":
            assert column["_memory"][-1] == pytest.approx(relaxed(elastic), abs=1e-6 * size)
        elif name == "series":
            # The spring and the damper have the same force.
            flow = np.sign(column[""]) * np.abs(column[""] / 0.7) ** (1 / 0.6)
            off = CubicSpline(t, column[""] / 3).derivative()(t) - (rate - flow)
            assert np.median(np.abs(off)) < 1e-4 * np.abs(rate).max()
    peaks = tables["peaks"]
    quantities = [str(name) for name in peaks["quantity"]]
    assert quantities[-2:] == (
        ["element1", "element2"] if kind == "none" else ["reaction_u3", "reaction_u4"]
    )
    for name, value, error in zip(*(peaks[key] for key in ("quantity", "value", "error")),
                                  strict=True):  # fmt: skip
        table = next(table for table in tables.values() if str(name) in table)
        largest = np.abs(table[str(name)]).max()
        assert largest <= abs(value) + error + 1e-12 * size
        assert abs(value) <= 1.02 * largest


@pytest.mark.parametrize("seed", [0, 3])
def test_forces_of_springs_by_kernel(solve, tmp_path, seed):
    """Those of Python for all springs with a kernel; their sum accelerates the masses."""
    rng = np.random.default_rng([84, seed])
    a = rng.normal(size=(2, 2))
    m, k = a @ a.T + np.eye(2), 4 * np.eye(2) + rng.uniform(-1, 1)
    own, of_kernel = seed % 2, 1 - seed % 2
    law = ["0.4*x^3", "0.2*tanh(x)", "0.3*sign(y_dot)", "0.5*x*y^2"][seed]
    text = (
        f"{KERNEL}&system coordinates='x' 'y' mass={matrix_text(m)} stiffness={matrix_text(k)} "
        f"damping=0.1 0 0 0.2 kernel={own} /\n"
        f"&spring stiffness=1 -0.5 -0.5 2 kernel={of_kernel} /\n"
        f"&force on='y' law='{law}' kernel={0 if 'sign' in law else 1} /\n"
        f"&load on='x' amplitude=1.3 /\n&transient initial=0.3 0 0.1 0 t_end={END} nu={NU} "
        f"dt={STEP} acceleration='yes' forces='yes' /\n"
    )
    tables = tables_of(solve, tmp_path, text, ["transient", "forces"])
    forces, motion = tables["forces"], tables["transient"]
    result = vv.Scene.read(tmp_path / "scene.nml")
    run = vv.simulate(**result._motion())
    python = run.element_forces()
    remembers = np.repeat([one.kernel is not None for one in run.system.groups], 2)
    total = a = np.stack([motion["x_ddot"], motion["y_ddot"]], axis=1) @ m
    for kernel in (0, 1):
        for j, axis in enumerate("xy"):
            chosen = (remembers == kernel) & (np.arange(remembers.size) % 2 == j)
            for part in ("elastic", "damping", "memory"):
                expected = getattr(python, part)[:, chosen].sum(axis=1)
                found = forces[f"kernel{kernel}_{axis}_{part}"]
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
        total = total + np.stack([forces[f"kernel{kernel}_{axis}"] for axis in "xy"], axis=1)
    total[:, 0] -= 1.3 * np.sin(NU * forces["t"])
    # The panels of the memory do not end where the friction switches.
    assert np.abs(total).max() < (1e-9 if "sign" in law else 1e-11) * np.abs(a).max()
    near = relaxed(forces["kernel1_x_elastic"])
    assert forces["kernel1_x_memory"][-1] == pytest.approx(near, abs=1e-6)


@pytest.mark.parametrize("geometry", ["exact", "cubic"])
def test_forces_of_the_springs_of_a_mount(solve, tmp_path, geometry):
    text = (
        f"{KERNEL}&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 "
        f"geometry='{geometry}' memory_scale=0.8 /\n&load on='x' amplitude=0.1 /\n"
        f"&transient initial=0.2 0 0.3 0 t_end={END} nu={NU} dt={STEP} acceleration='yes' "
        "forces='yes' /\n"
    )
    tables = tables_of(solve, tmp_path, text, ["transient", "forces"])
    forces, motion = tables["forces"], tables["transient"]
    run = vv.simulate(**vv.Scene.read(tmp_path / "scene.nml")._motion())
    check_parts(forces, ("spring_x", "spring_phi"), run.element_forces(), 1e-12)
    push = 0.1 * np.sin(NU * forces["t"])
    if geometry == "exact":
        np.testing.assert_allclose(motion["x_ddot"], push - forces["spring_x"], atol=1e-11)
        arm = 0.5 * np.cos(motion["phi"])
        turn = arm * forces["spring_x"] - forces["spring_phi"]
        np.testing.assert_allclose(0.1 * motion["phi_ddot"], turn, atol=1e-11)


def test_peaks_of_element_forces_in_ensembles(solve, tmp_path):
    """Of supports that move, scaled with the loads: those of the single motion."""
    text = random_structure(("apart", "rubber", "linear"))[0]
    head, _ = text.split("&transient")
    start = text.split("initial=")[1].split(" acceleration")[0]
    keys = f"t_end={END} dt={STEP} nu={NU} initial={start} forces='yes' peaks='yes' /\n"
    ensemble = f"{head}&ensemble vary='load_scale' from=0.5 to=1.5 count=3 {keys}"
    many = tables_of(solve, tmp_path, ensemble, ["peaks"])["peaks"]
    one = tables_of(solve, tmp_path, f"{head}&transient {keys}", ["peaks"])["peaks"]
    mine = many["load_scale"] == 1
    np.testing.assert_array_equal(many["quantity"][mine], one["quantity"])
    np.testing.assert_allclose(many["value"][mine], one["value"], rtol=1e-9, atol=1e-12)


def test_reactions_of_a_rotor(solve, tmp_path):
    """Matrices that depend on the speed act on supports, in time and in a response."""
    rng = np.random.default_rng(85)
    n, speed = 4, 2.0
    a, g, h = rng.normal(size=(3, n, n))
    g, h = 0.3 * (g - g.T), 0.1 * (h + h.T)
    k, m, c = a @ a.T + 6 * np.eye(n), np.diag(rng.uniform(1, 2, n)), 0.1 * np.eye(n)
    text = (
        f"&structure size=4 mass={matrix_text(m)} stiffness={matrix_text(k)} "
        f"damping={matrix_text(c)} gyroscopic={matrix_text(g)} circulatory={matrix_text(0.2 * h)} "
        f"centrifugal={matrix_text(h)} speed={speed} supports='x2' /\n&load on='x1' amplitude=1 /\n"
        f"&transient nu={NU} t_end={END} dt={STEP} forces='yes' acceleration='yes' /\n"
    )
    tables = tables_of(solve, tmp_path, text, ["transient", "reactions"])
    motion = tables["transient"]
    free = [f"x{i}" for i in (1, 3, 4)]
    u, v, a = (
        np.insert(np.stack([motion[name + dot] for name in free], axis=1), 1, 0, axis=1)
        for dot in ("", "_dot", "_ddot")
    )
    damping, stiffness = c + speed * g, k + speed * (0.2 * h + speed * h)
    total = a @ m + v @ damping.T + u @ stiffness.T
    reaction = tables["reactions"]["reaction_x2"]
    np.testing.assert_allclose(reaction, total[:, 1], atol=1e-12)
    given = {"mass": m, "stiffness": k, "damping": c, "supports": ["x2"], "gyroscopic": g,
             "circulatory": 0.2 * h, "centrifugal": h}  # fmt: skip
    rotor = vv.Structure(**given, speed=speed)
    run = vv.simulate(rotor, END, dt=STEP, load={"x1": 1.0}, nu=NU)
    np.testing.assert_allclose(run.support_reactions().force[:, 0], reaction, atol=1e-12)
    response = vv.forced_response(rotor, [NU], load={"x1": 1.0})
    first = list(response.harmonics).index(1)
    u = np.insert(response.coefficients[0][:, first], 1, 0)
    row = (-(NU**2) * m + 1j * NU * damping + stiffness)[1]
    assert response.support_reactions()[0, 0, first] == pytest.approx(row @ u, abs=1e-12)


def test_forces_that_scenes_refuse(solve, tmp_path):
    plain = "&structure mass=1 2 stiffness=2 -1 -1 2 "
    for head, reported in (
        (f"{plain} size=2 /\n", "forces = 'yes': needs an &element or supports"),
        (f"{plain} size=2 loss_factor=0.1 /\n&element on='x1' hysteresis='jenkins' "
         "hysteresis_numbers=2 0.1 /\n", "hysteresis: a motion in time needs"),
    ):  # fmt: skip
        check_refused(
            solve, tmp_path, f"{head}&transient t_end=1 dt=0.1 forces='yes' /\n", reported
        )
