"""Arguments of constructors are copied: later changes do not affect the value."""

import inspect
import pickle

import numpy as np
import pytest
import viscovib as vv
from scipy.sparse import csc_array

KERNEL = vv.PronyKernel(weights=[0.1], rates=[1.0])
PAIR = np.array([[2.0, -1.0], [-1.0, 2.0]])
ROW = np.array([1.0, 2.0])
TABLE = np.array([1.0, 2.0, 3.0])
FOOT = {
    "name": "foot",
    "position": np.array([0.1, 0.2, 0.3]),
    "stiffness": np.full(3, 1e5),
    "damping": np.full(3, 10.0),
    "rotational_stiffness": np.ones(3),
    "law": [None, None, "k3*d^3"],
    "kernel": [None, None, KERNEL],
    "parameters": {"k3": np.array(1e9)},
}
#: For each public class with array arguments: arguments with arrays wherever possible.
GIVEN = [
    (vv.MountPoint, FOOT | {"angles": np.array([0, 0.1, 0])}),
    (vv.MountPoint, FOOT | {"axes": np.eye(3)}),
    (
        vv.Body,
        {
            "mass": 80,
            "inertia": np.diag([2.0, 3.0, 3.5]),
            "mounts": [
                vv.MountPoint(name=f"foot{i}", position=(x, y, -0.1), stiffness=(1e5, 1e5, 1e5))
                for i, (x, y) in enumerate([(0.3, 0.2), (0.3, -0.2), (-0.3, 0)])
            ],
            "center": np.zeros(3) + 0.01,
            "gravity": np.array([0, 0, -9.81]),
            "base_direction": np.eye(6)[2],
            "spin": np.array([0.1, 0, 0]),
        },
    ),
    (
        vv.CubicSystem,
        {
            "mass": np.eye(2),
            "stiffness": PAIR,
            "damping": 0.1 * PAIR,
            "quadratic": np.ones((2, 2, 2)),
            "cubic": [np.ones((2, 2, 2)), np.ones((2, 2, 2))],
            "load": np.ones((2, 1)),
            "drives": np.ones(1),
        },
    ),
    (vv.Monomial, {"coefficient": 0.5, "powers": np.array([3, 0]), "on": "x1"}),
    (vv.Monomial, {"coefficient": 0.5, "powers": {"x1": 3}, "on": "x1"}),
    (vv.Springs, {"stiffness": PAIR, "forces": {"x1": "x1^3"}, "kernel": KERNEL}),
    (
        vv.PolynomialSystem,
        {
            "mass": ROW,
            "stiffness": PAIR,
            "damping": 0.1 * PAIR,
            "forces": [vv.Monomial(coefficient=0.5, powers=[3, 0], on="a1")],
            "springs": [vv.Springs(stiffness=ROW, kernel=KERNEL)],
            "names": ["a1", "a2"],
            "units": ["m", "m"],
            "base_direction": ROW,
        },
    ),
    (
        vv.PolynomialSystem,
        {"mass": ROW, "stiffness": ROW, "forces": {"x1": "k*x1^3"}, "parameters": {"k": 1.0}},
    ),
    (
        vv.PolynomialSystem,
        {
            "mass": ROW,
            "stiffness": PAIR,
            "gyroscopic": np.array([[0.0, 1.0], [-1.0, 0.0]]),
            "circulatory": 0.1 * PAIR,
            "centrifugal": ROW,
        },
    ),
    (
        vv.Structure,
        {
            "mass": np.eye(2),
            "stiffness": PAIR,
            "damping": np.zeros((2, 2)),
            "modal_damping": np.array([0.01, 0.02]),
            "elements": [vv.Spring(on="a1", law="d^3")],
            "layers": [[PAIR.copy(), KERNEL]],
            "names": ["a1", "a2"],
            "units": ["m", "m"],
            "base_direction": ROW,
        },
    ),
    (vv.Structure, {"mass": ROW, "stiffness": PAIR, "rayleigh": np.array([0.1, 0.1])}),
    (vv.Structure, {"mass": csc_array(np.eye(2)), "stiffness": csc_array(PAIR)}),
    (
        vv.Mount,
        {
            "mass": 1,
            "inertia": 0.1,
            "offset": 0.5,
            "stiffness_x": 10,
            "stiffness_phi": 2,
            "damping": 0.1 * PAIR,
        },
    ),
    (vv.Spring, {"on": ROW, "law": "k*d^3", "parameters": {"k": 1.0}}),
    (vv.Spring, {"on": {"x1": np.array(1.0), "x2": -1.0}, "stiffness": 1}),
    (
        vv.Coupling,
        {"on": {"a": ROW, "b": {"x2": 1.0}}, "law": {"a": "k*a*b^2"}, "parameters": {"k": 1.0}},
    ),
    (vv.Gap, {"on": ROW, "stiffness": 100, "gap": 0.5}),
    (vv.Stop, {"on": ROW, "stiffness": 100, "gap": 0.5}),
    (vv.Jenkins, {"on": ROW, "stiffness": 20, "limit": 1}),
    (vv.Iwan, {"on": ROW, "stiffness": ROW, "limit": TABLE[:2]}),
    (vv.BoucWen, {"on": ROW, "stiffness": 20, "beta": 2, "gamma": 1, "ratio": 0.1, "exponent": 1}),
    (vv.Dahl, {"on": ROW, "stiffness": 20, "limit": 1}),
    (vv.FluidDamper, {"on": ROW, "coefficient": 1, "exponent": 0.5}),
    (vv.Maxwell, {"on": ROW, "stiffness": 20, "coefficient": 1, "exponent": 0.5}),
    (vv.StribeckFriction, {"on": ROW, "coulomb": 1, "static": 2, "velocity": 0.1}),
    (vv.LoadTable, {"times": TABLE, "values": TABLE, "on": {"x1": 1.0}}),
    (vv.LoadTable, {"times": TABLE, "values": TABLE, "on": ROW}),
    (vv.HalfSine, {"amplitude": ROW, "duration": 1.0}),
    (vv.Haversine, {"amplitude": ROW, "duration": 1.0}),
    (vv.Sawtooth, {"amplitude": ROW, "duration": 1.0}),
    (vv.Trapezoid, {"amplitude": ROW, "duration": 1.0}),
    (vv.Chirp, {"amplitude": ROW, "duration": 1.0, "hz": ROW}),
    (
        vv.PistonEngine,
        {
            "crank_radius": 0.1,
            "rod_length": 0.3,
            "reciprocating_mass": 1.0,
            "crank_angles": ROW,
            "positions": ROW,
            "bank_angles": ROW,
            "rotating_mass": ROW,
            "at": np.array([1.0, 2.0, 3.0]),
            "strokes": 2,
            "gas_torque": {1: 3.0},
        },
    ),
    (vv.RunUp, {"unbalance": ROW, "duration": 1.0, "speed": ROW}),
    (vv.DriveTorque, {"torque": "1", "inertia": 1.0, "unbalance": ROW}),
    (vv.Step, {"amplitude": ROW}),
    (vv.Past, {"times": TABLE - 3, "displacements": np.outer(TABLE, ROW)}),
    (vv.PronyKernel, {"weights": ROW / 10, "rates": ROW}),
    (vv.TabulatedKernel, {"times": TABLE, "values": 0.1 / TABLE}),
    (vv.SumKernel, {"parts": [KERNEL, KERNEL]}),
    (vv.ShiftTable, {"temperatures": TABLE, "decades": TABLE - 2}),
    (
        vv.ModulusData,
        {name: TABLE for name in ("frequencies", "storage", "loss", "temperature", "amplitude")}
        | {"set": np.zeros(3)},
    ),
    (vv.RelaxationData, {"times": TABLE, "modulus": TABLE, "set": np.zeros(3)}),
    (vv.CreepData, {"times": TABLE, "compliance": TABLE, "temperature": TABLE}),
    (vv.PythonLaw, {"function": np.arctan, "arguments": ["d"]}),
]
#: Arguments that are texts, numbers and other immutable values.
TAKE_NONE = {
    "AbelKernel", "Arrhenius", "Event", "FluidTrack", "Pendulum", "RabotnovKernel",
    "RzhanitsynKernel", "ThermalKernel", "WLF",
}  # fmt: skip


def copied(value):
    """A deep copy of all mutable parts."""
    return pickle.loads(pickle.dumps(value))


def spoil(value):
    """Change every mutable part of the arguments."""
    if isinstance(value, np.ndarray):
        value[...] = 9
    elif isinstance(value, csc_array):
        value.data[:] = 9
    elif isinstance(value, dict):
        for one in value.values():
            spoil(one)
        value.clear()
    elif isinstance(value, list):
        for one in value:
            spoil(one)
        value[:] = [9] * len(value)


def reported(value):
    """All fields of a value; arrays with all digits and their writeable flag."""
    if isinstance(value, np.ndarray):
        return "array", value.tolist(), value.flags.writeable
    if isinstance(value, csc_array):
        return value.toarray().tolist()
    if isinstance(value, (list, tuple)):
        return [reported(one) for one in value]
    if isinstance(value, dict):
        return {key: reported(one) for key, one in value.items()}
    return repr(value)


def fields(value):
    names = [name for name in vars(value) if not name.startswith("__")]
    return {name: reported(getattr(value, name)) for name in names}


def name_of(case):
    return case.__name__ if isinstance(case, type) else ""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("kind", "given"), GIVEN, ids=name_of)
def test_a_value_owns_what_it_was_given(kind, given):
    given = copied(given)
    value = kind(**given)
    before, printed = fields(value), repr(value)
    spoil(given)
    assert fields(value) == before
    assert repr(value) == printed
    for name, field in vars(value).items():
        if name in inspect.signature(kind).parameters and isinstance(field, np.ndarray):
            assert not field.flags.writeable, name


def test_results_after_the_arguments_changed():
    powers, on = np.array([3]), np.array([1.0, 0.0])
    cubic = vv.Monomial(coefficient=0.5, powers=powers, on="x")
    spring = vv.Spring(on=on, law="d^3")
    powers[0], on[:] = 2, (0, 1)
    one = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=[cubic])
    two = vv.Structure(mass=ROW, stiffness=PAIR, elements=[spring])
    assert one.groups[0].forces == {(0, (3,)): 0.5}
    assert two.deflections == ("x1",)


def test_all_classes_that_systems_are_made_of_are_held_to_it():
    rooms = ("kernels", "systems", "bodies", "common.past", "rubber.data", "analyses.events")
    starts = tuple(f"viscovib.{room}" for room in rooms)
    found = {kind.__name__ for kind, _ in GIVEN} | TAKE_NONE
    made = {
        "BodyModes", "CharacteristicRoots", "ExponentialSum", "ModalModel", "MountForces", "Sag",
        "NormalCoordinates",
    }  # fmt: skip
    bases = {"Kernel", "ShiftLaw"}
    for name in dir(vv):
        one = getattr(vv, name, None)
        if inspect.isclass(one) and one.__module__.startswith(starts):
            assert name in found | made | bases, name
