"""Rotors and motors in scenes, against the same systems in Python."""

import numpy as np
import pytest
import viscovib as vv
from scene_texts import columns_of, numbers, scene_of

OF_SPEED = ("gyroscopic", "circulatory", "centrifugal")


def random_rotor(seed, n):
    """Matrices of a random damped rotor."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n)) / np.sqrt(n)
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    gyroscopic, circulatory, centrifugal = 0.1 * rng.normal(size=(3, n, n)) / np.sqrt(n)
    return {
        "mass": np.diag(rng.uniform(0.5, 2, n)) + 0.1 * root @ root.T,
        "stiffness": chain + np.diag(rng.uniform(0.2, 0.6, n)),
        "damping": 0.05 * chain + 0.1 * np.eye(n),
        "gyroscopic": gyroscopic - gyroscopic.T,
        "circulatory": 0.3 * circulatory,
        "centrifugal": 0.3 * centrifugal,
    }


def structure_text(matrices, more="", elements=""):
    lines = [f"{name} = {numbers(matrix)}" for name, matrix in matrices.items()]
    n = len(matrices["mass"])
    lines.append("coordinates = " + " ".join(f"'x{i + 1}'" for i in range(n)))
    return "&structure\n" + "\n".join(lines) + f"\n{more} /\n{elements}\n"


DAMPING = {
    "none": ("", {}),
    "rayleigh": ("rayleigh = 0.02 0.01", {"rayleigh": (0.02, 0.01)}),
    "modal": ("modal_damping = 0.03", {"modal_damping": 0.03}),
}
#: Groups of a scene, and elements in Python.
ELEMENTS = {
    "linear": ("", lambda: []),
    "law": ("&element on='x2' law='0.1*d^3' /", lambda: [vv.Spring(on="x2", law="0.1*d^3")]),
    "memory": (
        "&kernel kind='prony' weights=0.2 rates=0.7 /\n"
        "&element on='x1' 'x2' stiffness=0.7 kernel=1 /\n&element on='x3' law='0.1*d^3' kernel=0 /",
        lambda: [
            vv.Spring(
                on=("x1", "x2"),
                stiffness=0.7,
                kernel=vv.PronyKernel(weights=[0.2], rates=[0.7]),
            ),
            vv.Spring(on="x3", law="0.1*d^3"),
        ],
    ),
}


GRID = np.linspace(0.4, 2.2, 7)
RESPONSE = "&response nu_from=0.4 nu_to=2.2 nu_count=7 method='newton' harmonics=15 /\n"


def harmonics(columns, names):
    """Coefficients of a table in the order of those of a response."""
    orders = sorted({int(name.split("_")[-2]) for name in columns if name.endswith("_re")})
    return orders, np.array(
        [[columns[f"{name}_{k}_re"] + 1j * columns[f"{name}_{k}_im"] for k in orders]
         for name in names]
    ).transpose(2, 0, 1)  # fmt: skip


def check_response(scene, system, load, **given):
    """Compare a scene, the system in Python, and the system that the scene builds."""
    table = columns_of(vv.run(scene))
    given = {"load": load, "method": "newton", "harmonics": 15} | given
    expected = vv.forced_response(system, GRID, **given)
    orders, found = harmonics(table, system.dof_names)
    places = [list(expected.harmonics).index(k) for k in orders]
    largest = np.abs(expected.coefficients).max()
    assert largest > 1e-3
    np.testing.assert_allclose(
        found, expected.coefficients[:, :, places], rtol=0, atol=1e-12 * largest
    )


@pytest.mark.parametrize(
    ("speed", "n", "elements", "damping"),
    [(None, 3, "linear", "none"), (1.3, 3, "law", "rayleigh"), (None, 12, "memory", "modal")],
)
def test_responses_of_structures_are_those_of_python(tmp_path, speed, n, elements, damping):
    matrices = random_rotor(n, n)
    more, given = DAMPING[damping]
    structure = vv.Structure(**matrices, **given, elements=ELEMENTS[elements][1](), speed=speed)
    if speed is not None:
        more += f" speed={speed}"
    text = structure_text(matrices, more, ELEMENTS[elements][0])
    text += (
        "&load on='x1' amplitude='0.1*nu^2' phase=0.3 /\n&load on='x2' order=3 amplitude=0.02 /\n"
    )
    scene = scene_of(tmp_path, text + RESPONSE)
    ahead = complex(np.exp(0.3j))
    load = {1: {"x1": f"({0.1 * ahead.real!r} + {0.1 * ahead.imag!r}j)*nu^2"}, 3: {"x2": 0.02}}
    check_response(scene, structure, load)
    check_response(scene, scene.structure(), load)


def random_body(seed):
    """Text of a random body with a rotor, and the same in Python."""
    rng = np.random.default_rng(seed)
    inertia, rotor, spin = rng.uniform(0.8, 1.5, 3), rng.normal(size=3), rng.normal(size=3)
    text = (
        f"&body mass=3 inertia={numbers(inertia)} rotor={numbers(rotor)} spin={numbers(spin)}"
        " gravity=0 0 -0.5 {} /\n"
    )
    mounts = []
    for i in range(4):
        position, stiffness = rng.uniform(-1, 1, 3), rng.uniform(8, 15, 3)
        text += (
            f"&mount_point name='m{i}' position={numbers(position)} stiffness={numbers(stiffness)}"
            " damping=0.2 0.3 0.4 law_z='0.05*d^3' /\n"
        )
        mounts.append(
            vv.MountPoint(
                name=f"m{i}", position=position, stiffness=stiffness, damping=(0.2, 0.3, 0.4),
                law=(None, None, "0.05*d^3"),
            )
        )  # fmt: skip
    return text, lambda **given: vv.Body(
        mass=3, inertia=inertia, mounts=mounts, rotor=rotor, spin=spin, gravity=0.5, **given
    )


@pytest.mark.parametrize("speed", [None, 1.7])
def test_responses_of_bodies_are_those_of_python(tmp_path, speed):
    text, body = random_body(0)
    text = text.format("" if speed is None else f"speed={speed}")
    body = body() if speed is None else body().at_speed(speed)
    scene = scene_of(tmp_path, text + "&load on='rx' amplitude=0.05 /\n" + RESPONSE)
    load = {1: {"rx": 0.05}}
    check_response(scene, body, load)
    check_response(scene, scene.body(), load)


def test_the_floor_turns_at_a_constant_speed(tmp_path):
    text, body = random_body(0)
    text = text.format("speed=1.7 base_direction=0 0 0 1 0 0.5")
    turned = body().at_speed(1.7)
    turned = vv.Body(
        mass=turned.body_mass, inertia=turned.inertia, mounts=turned.mounts, spin=turned.spin,
        gravity=turned.gravity, base_direction=(0, 0, 0, 1, 0, 0.5),
    )  # fmt: skip
    scene = scene_of(tmp_path, text + "&load kind='base' amplitude=0.05 /\n" + RESPONSE)
    check_response(scene, turned, None, base=0.05)


SPEEDS = "&campbell speed_from=0 speed_to=4 speed_count=9 /\n"


def check_campbell(scene, system):
    table = vv.run(scene).value
    found = vv.campbell(system, np.linspace(0, 4, 9))
    assert table.columns["growth"] == pytest.approx(found.growth, rel=1e-11, abs=1e-11)
    for j in range(found.frequencies.shape[1]):
        assert table.columns[f"frequency_{j}"] == pytest.approx(
            found.frequencies[:, j], rel=1e-12, nan_ok=True
        )


@pytest.mark.parametrize(("n", "damping"), [(3, "modal"), (40, "rayleigh")])
def test_diagrams_of_structures_are_those_of_python(tmp_path, n, damping):
    matrices = random_rotor(n, n)
    more, given = DAMPING[damping]
    scene = scene_of(tmp_path, structure_text(matrices, more) + SPEEDS)
    check_campbell(scene, vv.Structure(**matrices, **given))


@pytest.mark.parametrize(("n", "damping"), [(4, "none"), (9, "modal")])
def test_fixed_supports_and_maxwell_elements(tmp_path, damping, n):
    matrices = random_rotor(n, n)
    more, given = DAMPING[damping]
    structure = vv.Structure(
        **matrices, **given, supports=["x2"],
        elements=[vv.Maxwell(on="x1", stiffness=0.8, coefficient=0.3)],
    )  # fmt: skip
    text = structure_text(
        matrices,
        f"supports='x2' {more}",
        "&element on='x1' series_stiffness=0.8 fluid_coefficient=0.3 /",
    )
    scene = scene_of(tmp_path, text + "&load on='x1' amplitude=0.1 /\n" + RESPONSE)
    check_response(scene, structure, {"x1": 0.1})


@pytest.mark.parametrize("speed", [None, 1.3])
def test_branches_and_motions_in_time(tmp_path, speed):
    matrices = random_rotor(8, 6)
    structure = vv.Structure(**matrices, elements=ELEMENTS["law"][1](), speed=speed)
    text = structure_text(matrices, "" if speed is None else f"speed={speed}", ELEMENTS["law"][0])
    text += "&load on='x1' amplitude=0.1 /\n"
    scene = scene_of(tmp_path, text + "&branch nu_from=0.5 nu_to=2 harmonics=9 /\n")
    columns = columns_of(vv.run(scene))
    expected = vv.trace_response(structure, (0.5, 2), load={"x1": 0.1}, harmonics=9)
    assert columns["nu"][-1] == pytest.approx(expected.nu[-1])
    peak = np.hypot(columns["x1_1_re"], columns["x1_1_im"]).max()
    assert peak == pytest.approx(expected.amplitude("x1").max(), rel=1e-3)
    at_end = vv.run(scene_of(tmp_path, text + "&transient t_end=10 nu=0.9 rtol=1e-10 /\n"))
    fixed = structure if speed is not None else structure.at_speed(0.9)
    run = vv.simulate(fixed, 10, load={"x1": 0.1}, nu=0.9, rtol=1e-10)
    end = [columns_of(at_end)[f"x{i + 1}"][-1] for i in range(6)]
    assert end == pytest.approx(run.state[-1, ::2], abs=1e-9)


BAD = [
    ("structure", "gyroscopic=0 1 1 0", "response", r":1: gyroscopic: must be skew, has 1 in row"),
    ("structure", "gyroscopic=0 1 -1", "response", r":1: gyroscopic has 3 values: must be 2"),
    ("structure", "speed=3", "response", r":1: speed: has no effect without gyroscopic"),
    ("structure", "gyroscopics=0 1 -1 0", "response", r":1: unknown key 'gyroscopics'"),
    ("structure", "circulatory=0 1 -1 0 loss_factor=0.1", "response", r":1: loss_factor: must"),
    ("structure", "circulatory=0 1 -1 0", "roots", r":1: speed: must be given"),
    ("structure", "circulatory=0 1 -1 0 speed=1", "campbell", r":1: speed: must not be given"),
    ("structure", "gyroscopic=0 1 -1 0 speed=1", "modes", r":1: gyroscopic: undamped modes"),
    ("structure", "loss_factor=0.1", "campbell", r":1: loss_factor: must be 0 over several"),
    ("structure", "circulatory=0 1 -1 0 supports='x2' base_direction=1", "response",
     r":1: base_direction: must be 0 where gyroscopic, circulatory"),
    ("body", "rotor=1 0", "response", r":1: rotor has 2 values: must be 3"),
    ("body", "rotors=1 0 0", "response", r":1: unknown key 'rotors'.*'rotor'"),
    ("body", "speed=1", "response", r":1: speed: has no effect without rotor"),
    ("body", "rotor=1 0 0 geometry='exact'", "response", r":1: rotor: must be 0 with geometry"),
    ("body", "rotor=1 0 0", "modes", r":1: rotor: undamped modes"),
    ("body", "rotor=1 0 0", "roots", r":1: speed: must be given"),
    ("body", "rotor=1 0 0 base_direction=0 0 0 1 0 0", "response",
     r":1: base_direction: must not turn the floor"),
    ("body", "geometry='exact'", "campbell", r"&campbell: of a &body with geometry = 'exact'"),
]  # fmt: skip
RESULTS = {
    "response": "&load on='{}' amplitude=0.1 /\n&response nu=1 /",
    "roots": "&characteristic_roots /",
    "modes": "&modes /",
    "campbell": "&campbell speed_from=0 speed_to=1 speed_count=2 /",
}


@pytest.mark.parametrize(("system", "keys", "result", "message"), BAD)
def test_wrong_keys_are_named_in_one_line(tmp_path, system, keys, result, message):
    text = {
        "structure": f"&structure mass=1 1 stiffness=2 1 {keys} /\n",
        "body": f"&body mass=1 inertia=1 1 1 {keys} /\n"
        "&mount_point name='a' position=0 0 0 stiffness=1 1 1 rotational_stiffness=1 1 1 /\n",
    }[system]
    on = {"structure": "x1", "body": "x"}[system]
    with pytest.raises(vv.InputError, match=message) as error:
        vv.run(scene_of(tmp_path, text + RESULTS[result].format(on)))
    assert "\n" not in str(error.value)


def test_a_floor_does_not_turn_at_the_speed_of_the_load(tmp_path):
    text = (
        "&body mass=1 inertia=1 1 1 rotor=1 0 0 /\n"
        "&mount_point name='a' position=0 0 0 stiffness=1 1 1 /\n"
        "&load kind='base' on='rx' amplitude=0.1 /\n&response nu_from=1 nu_to=2 nu_count=2 /"
    )
    with pytest.raises(vv.InputError, match="on = 'rx': must not turn the floor with a rotor"):
        vv.run(scene_of(tmp_path, text))


def test_matrices_of_a_system_may_be_files(tmp_path):
    matrices = random_rotor(1, 3)
    for name, matrix in matrices.items():
        lines = "\n".join(repr(float(x)) for x in matrix.ravel(order="F"))
        (tmp_path / f"{name}.mtx").write_text(
            f"%%MatrixMarket matrix array real general\n3 3\n{lines}\n"
        )
    keys = " ".join(f"{name}='{name}.mtx'" for name in matrices)
    text = f"&system coordinates='x' 'y' 'z' {keys} /\n&load on='x' amplitude=0.1 /\n"
    system = scene_of(tmp_path, text + RESPONSE).polynomial_system()
    assert np.array_equal(system._mass_matrix, matrices["mass"])
    for name in OF_SPEED:
        assert np.array_equal(getattr(system, name), matrices[name])
