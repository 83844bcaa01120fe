"""Moving supports of structures in scenes, against the same structures in Python."""

import numpy as np
import pytest
import viscovib as vv
from scene_texts import columns_of, numbers, scene_of

NAMES = ["x1", "x2", "x3", "x4", "x5", "x6"]
FREE = ["x1", "x3", "x4", "x6"]


def random_matrices(seed):
    """Full matrices with couplings of all coordinates."""
    rng = np.random.default_rng(seed)
    found = []
    for size in (0.15, 0.15, 0.4):
        root = rng.normal(size=(6, 6))
        found.append(size * root @ root.T + np.diag(rng.uniform(0.5, 1.5, 6)))
    return dict(zip(("mass", "damping", "stiffness"), found, strict=True))


def text_of(matrices, more, groups):
    lines = [f"{name} = {numbers(matrix)}" for name, matrix in matrices.items()]
    return (
        "&structure size=6\n"
        + "\n".join(lines)
        + f"\nsupports = 'x5' 'x2' {more} /\n"
        + groups
        + "\n"
    )


LINEAR = vv.Spring(on=("x3", "x5"), stiffness=0.9, damping=0.2)
CUBIC = vv.Spring(on=("x1", "x4"), law="0.05*d^3")
GAP = vv.Spring(on=("x1", "x4"), law="2*max(d - 0.3, 0)")
BENT = vv.Spring(on=("x6", "x2"), stiffness=0.3, law="0.05*d^3")
GROUPS = {
    LINEAR: "&element on='x3' 'x5' stiffness=0.9 damping=0.2 /\n",
    CUBIC: "&element on='x1' 'x4' law='0.05*d^3' /\n",
    BENT: "&element on='x6' 'x2' stiffness=0.3 law='0.05*d^3' /\n",
    GAP: "&element on='x1' 'x4' law='2*max(d - 0.3, 0)' /\n",
}
RESPONSE = "&response nu_from=0.3 nu_to=2.1 nu_count=5 method='newton' harmonics=27 /\n"
#: Loads of a scene, motion of the base in Python, and ``base_direction``.
BASES = {
    "alone": (
        "&load kind='base' on='x2' amplitude=0.2 phase=0.4 /\n"
        "&load kind='base' on='x5' amplitude=0.1 order=3 /\n"
        "&load kind='base' on='x5' amplitude=0.05 order=0 /\n",
        {"x2": {1: 0.2 * np.exp(0.4j)}, "x5": {3: 0.1, 0: 0.05j}},
        None,
    ),
    "given": ("&load kind='base' amplitude=0.2 /\n", 0.2, [0.5, 0.7, -0.2, 0.1, -1.0, 0.3]),
    "together": ("&load kind='base' amplitude=0.2 phase=0.4 /\n", 0.2 * np.exp(0.4j), [0.7, -1.0]),
}


@pytest.mark.parametrize(
    ("base", "elements"),
    [
        ("alone", [LINEAR]),
        ("alone", [LINEAR, CUBIC]),
        ("given", [LINEAR, CUBIC]),
        ("together", [LINEAR]),
        ("together", [LINEAR, CUBIC, BENT]),
    ],
)
def test_responses_are_those_of_python(tmp_path, base, elements):
    matrices = random_matrices(0)
    loads, moved, direction = BASES[base]
    structure = vv.Structure(
        **matrices, supports=["x5", "x2"], base_direction=direction, elements=elements
    )
    more = "" if direction is None else f"base_direction = {numbers(direction)}"
    groups = "".join(GROUPS[one] for one in elements)
    text = text_of(matrices, more, groups) + "&load on='x3' amplitude=0.1 /\n" + loads
    scene = scene_of(tmp_path, text + RESPONSE)
    table = columns_of(vv.run(scene))
    expected = vv.forced_response(
        structure, np.linspace(0.3, 2.1, 5), load={"x3": 0.1}, base=moved, method="newton",
        harmonics=27,
    )  # fmt: skip
    largest = np.abs(expected.coefficients).max()
    for name in FREE:
        for k in expected.harmonics.tolist():
            if f"{name}_{k}_re" in table:
                own = table[f"{name}_{k}_re"] + 1j * table[f"{name}_{k}_im"]
                off = np.abs(own - expected.coefficient(name, k)).max()
                assert off <= 1e-12 * largest, (name, k, off)
    given = scene.loads()
    own = vv.forced_response(
        scene.structure(), np.linspace(0.3, 2.1, 5), method="newton", harmonics=27, **given
    )
    assert np.abs(own.coefficients - expected.coefficients).max() <= 1e-12 * largest


@pytest.mark.parametrize(("base", "law"), [("alone", CUBIC), ("together", GAP)])
def test_motions_in_time_are_those_of_python(tmp_path, base, law):
    matrices = random_matrices(11)
    loads, moved, direction = BASES[base]
    structure = vv.Structure(
        **matrices, supports=["x5", "x2"], base_direction=direction, elements=[LINEAR, law]
    )
    more = "" if direction is None else f"base_direction = {numbers(direction)}"
    text = text_of(matrices, more, GROUPS[LINEAR] + GROUPS[law]) + loads
    scene = scene_of(tmp_path, text + "&transient t_end=8 nu=0.8 rtol=1e-11 /\n")
    table = columns_of(vv.run(scene))
    run = vv.simulate(structure, 8, base=moved, nu=0.8, rtol=1e-11)
    found = [table[name][-1] for name in FREE]
    assert found == pytest.approx(run.state[-1, ::2], abs=1e-9)


@pytest.mark.parametrize(
    ("more", "loads", "message"),
    [
        ("", "kind='base' on='x1' amplitude=1", "on = 'x1': must be one of 'x5', 'x2'"),
        ("", "kind='base' amplitude=1", "needs base_direction"),
        ("", "kind='base' on='x2' amplitude=1", "on = 'x2': &element 1 or a layer"),
        ("", "kind='base' on='x5' amplitude='nu'", "amplitude = 'nu'"),
        ("", "kind='base' on='x5' amplitude=1 shape='step'", "kind = 'base': must be 'force'"),
        ("base_direction=1", "kind='base' amplitude=1", "base_direction has 1 values"),
        ("circulatory=36*0.1", "kind='base' on='x5' amplitude=1", "on = 'x5': supports must not"),
        ("circulatory=36*0.1 base_direction=1 1", "kind='base' amplitude=1", "must be 0 where"),
    ],
)
def test_wrong_motions_of_supports(tmp_path, more, loads, message):
    text = text_of(random_matrices(0), more, GROUPS[BENT]) + f"&load {loads} /\n"
    with pytest.raises(vv.InputError, match=message) as error:
        vv.run(scene_of(tmp_path, text + "&response nu_from=1 nu_to=2 nu_count=2 /\n"))
    assert "\n" not in str(error.value)


def test_what_supports_do_not_allow_is_named(tmp_path):
    text = text_of(random_matrices(0), "base_direction=1 2", "")
    shock = "&load kind='acceleration' shape='half_sine' amplitude=1 duration=1 /\n"
    with pytest.raises(vv.InputError, match="deforms springs or dampers at the supports"):
        vv.run(scene_of(tmp_path, text + shock + "&transient t_end=1 /\n"))
    base = "&load kind='base' amplitude=0.1 /\n&response nu=1 dissipation='yes' /\n"
    with pytest.raises(vv.InputError, match="dissipation = yes: is not available with supports"):
        vv.run(scene_of(tmp_path, text + base))
