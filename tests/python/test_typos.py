"""Typical mistakes of a new user, in Python and in scenes, and their one-line messages."""

import pytest
import viscovib as vv

MOUNT = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}


def system(**changed):
    given = {"mass": 1, "stiffness": 1, "damping": 0.1, "forces": "x^3"} | changed
    return vv.PolynomialSystem(**given)


def respond(**options):
    return vv.forced_response(system(), [1.0], **({"load": 1} | options))


def point(**given):
    return vv.MountPoint(**({"name": "a", "position": (0, 0, 0), "stiffness": (1, 1, 1)} | given))


def structure(**given):
    return vv.Structure(**({"mass": [1.0], "stiffness": [1.0]} | given))


PYTHON = [
    # Values of systems.
    (lambda: vv.Mount(**MOUNT | {"mass": "1 kg"}), "mass = '1 kg': must be a real number"),
    (lambda: vv.Mount(**MOUNT | {"mass": -1}), "mass = -1: must be greater than 0"),
    (
        lambda: vv.Mount(**MOUNT, damping=0.1),
        "damping: must have shape (2, 2), got (): a viscous damping matrix in x and phi, such as "
        "damping=[[c_x, 0], [0, c_phi]]",
    ),
    (lambda: vv.Mount(**MOUNT, kernel=0.1), "kernel = 0.1: must be a Kernel or None"),
    (
        lambda: vv.Mount(**MOUNT, kernel="rabotnov"),
        "kernel = 'rabotnov': must be a Kernel or None; give RabotnovKernel(amplitude=..., "
        "alpha=..., beta=...)",
    ),
    (
        lambda: point(kernel=vv.PronyKernel),
        "a: kernel = <class 'viscovib.kernels.relaxation.PronyKernel'>: must be a Kernel, None or "
        "three of them; give PronyKernel(weights=..., rates=...)",
    ),
    (
        lambda: vv.Mount(**MOUNT, geometry="exakt"),
        "geometry = 'exakt': must be one of 'exact', 'cubic', 'printed'; did you mean 'exact'?",
    ),
    (
        lambda: vv.RzhanitsynKernel(amplitude=1, alpha=2, beta=1),
        "alpha = 2: must be in (0, 1]",
    ),
    (lambda: point(position=(0, 0)), "a: position: must have shape (3,), got (2,)"),
    (lambda: point(stiffness=1e5), "a: stiffness: must have shape (3,), got ()"),
    (
        lambda: point(name="front left"),
        "name = 'front left': must be letters, digits and _, not begin with a digit, and have at "
        "most 14 characters",
    ),
    (
        lambda: structure(elements=[vv.Spring(on="x2", law="d^3")]),
        "elements[0].on = 'x2': must be one of the 1 coordinates x1",
    ),
    # Laws as text.
    (
        lambda: system(forces="x^3 + y"),
        "forces['x'] = 'x^3 + y': 'y' is neither a variable (x, x_dot) nor a parameter; to make "
        "it one, give parameters={'y': its value}",
    ),
    (
        lambda: system(forces="0.1*xdot"),
        "forces['x'] = '0.1*xdot': 'xdot' is neither a variable (x, x_dot) nor a parameter (did "
        "you mean x_dot?); to make it one, give parameters={'xdot': its value}",
    ),
    (
        lambda: system(forces="sgn(x_dot)"),
        "forces['x'] = 'sgn(x_dot)': 'sgn' is not a known function (did you mean sign?)",
    ),
    (
        lambda: system(forces="2x^3"),
        "forces['x'] = '2x^3': 'x' (character 2): expected an operator or the end; "
        "write products with *",
    ),
    (
        lambda: vv.Spring(on="x1", law="x^3"),
        "law = 'x^3': 'x' is neither a variable (d, v) nor a parameter; to make it one, give "
        "parameters={'x': its value}",
    ),
    # Calls.
    (lambda: vv.forced_response(system(), [0, 1], load=1), "nu = 0: must be greater than 0"),
    (
        lambda: vv.forced_response(system(), [1]),
        "load or base: must be given (0 is allowed): without them every motion is 0",
    ),
    (
        lambda: vv.forced_response(system(), [1], load={"X": 1}),
        "load: 'X' must be one of the 1 coordinates x",
    ),
    (
        lambda: respond(load="1 N"),
        "load = '1 N': must be numbers, got text (a text must depend on nu, as '0.002*nu^2')",
    ),
    (lambda: respond(tolerance=1), "tolerance = 1: must be in [1e-14, 0.1]"),
    (lambda: respond(harmonics="9"), "harmonics = '9': must be an integer or 'auto'"),
    (
        lambda: respond(method="HBM"),
        "method = 'HBM': must be one of 'linear', 'successive', 'newton', 'auto'; did you mean "
        "'newton'?",
    ),
    (
        lambda: respond(method="harmonic balance"),
        "method = 'harmonic balance': must be one of 'linear', 'successive', 'newton', 'auto'; did "
        "you mean 'newton'?",
    ),
    (
        lambda: vv.LoadTable(times=[0, 1], values=[0, 1], interpolation="spline"),
        "interpolation = 'spline': must be one of 'linear', 'cubic'; did you mean 'cubic'?",
    ),
    (
        lambda: vv.Event("x", direction="rising"),
        "direction = 'rising': must be one of 'any', 'up', 'down'; did you mean 'up'?",
    ),
    (
        lambda: vv.trace_response(system(), 1.0, load=1),
        "nu_range: must be two numbers, from and to, got shape ()",
    ),
    (
        lambda: vv.simulate(system(), 10, load=1),
        "nu: must be given with a load: its circular frequency (a constant load is load={0: ...})",
    ),
    (
        lambda: vv.simulate_ensemble(
            system(), initial=[0, 0], load=1, t_end=9, parameters={"load_scale": [1, 2]}
        ),
        "nu: must be given with a load: its circular frequency (a constant load is load={0: ...})",
    ),
    (
        lambda: vv.simulate(system(), 10, initial=[1]),
        "initial: must have shape (2,), got (1,): values of x, x_dot",
    ),
    (lambda: respond().amplitude("y"), "dof = 'y': must be one of 'x' (0)"),
    (
        lambda: respond(load=0.01, harmonics=5).amplitude("x", 2),
        "harmonic = 2: must be one of those kept (1, 3, 5)",
    ),
    (lambda: vv.run("nothing.nml"), "nothing.nml: cannot be read (No such file or directory)"),
]


@pytest.mark.parametrize(("call", "message"), PYTHON)
def test_a_call(call, message):
    with pytest.raises(vv.ViscovibError) as error:
        call()
    assert str(error.value) == message


def test_a_keyword():
    with pytest.raises(TypeError, match=r"did you mean nu\?"):
        vv.forced_response(system(), freq=1.0, load=1)
