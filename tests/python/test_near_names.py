"""A misspelt keyword is told the name that is near."""

import inspect
import pickle

import matplotlib as mpl
import pytest
import viscovib as vv

mpl.use("Agg")
PUBLIC = [vv.__dict__.get(name) or getattr(vv, name) for name in vv.__all__ if name[0] != "_"]


def system():
    return vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda: vv.forced_response(system(), [1.0], load=1, harmonic=3),
            "did you mean harmonics?",
        ),
        (lambda: vv.simulate(system(), 1, initail=[0, 0]), "did you mean initial?"),
        (lambda: vv.PolynomialSystem(mass=1, stifness=1), "did you mean stiffness?"),
        (lambda: vv.PronyKernel(weigths=[0.1], rates=[1]), "did you mean weights?"),
        (lambda: vv.MultipleScales(system(), laod=1), "did you mean load?"),
        (lambda: vv.spectrum([1.0, 2.0], 0.1, qqq=1), "must be one of "),
    ],
)
def test_of_calls(call, text):
    with pytest.raises(TypeError, match="unexpected keyword argument") as told:
        call()
    assert text in str(told.value)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda word: vv.forced_response(system(), [1.0], load=1, method=word),
            ("newtn", "newton"),
        ),
        (
            lambda word: vv.forced_response(system(), [1.0], load=1, method=word),
            ("Newton", "newton"),
        ),
        (
            lambda word: vv.forced_response(system(), [1.0], load=1, method=word),
            ("harmonic balance", "newton"),
        ),
        (lambda word: vv.simulate(system(), 1, initial=[1, 0], keep=word), ("al", "all")),
        (lambda word: vv.spectrum([1.0, 2.0], 0.1, window=word), ("hanning", "hann")),
        (lambda word: vv.simulate(system(), 1, initial=[1, 0]).coordinate(word), ("X", "x")),
    ],
)
def test_of_words(call, text):
    wrong, meant = text
    with pytest.raises(vv.InputError, match=rf"= '{wrong}': must be one of .*mean '{meant}'\?$"):
        call(wrong)


def test_of_arguments_without_a_name():
    with pytest.raises(TypeError, match=r"give amplitude=, alpha=, beta= by name$"):
        vv.RzhanitsynKernel(0.1, 0.2, 0.3)


def test_of_pictures():
    response = vv.forced_response(system(), [0.5, 1.0], load=0.1)
    response.plot(harmonic=1)
    with pytest.raises(
        vv.InputError, match=r"plot: harmonics: is not an option .* did you mean harmonic\?"
    ):
        response.plot(harmonics=1)


def test_of_all_that_is_called():
    seen = 0
    for value in PUBLIC:
        if not callable(value) or (isinstance(value, type) and issubclass(value, Exception)):
            continue
        try:
            parameters = inspect.signature(value).parameters.values()
        except ValueError:
            continue
        named = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY and len(p.name) > 3]
        if not named or any(p.kind is p.VAR_KEYWORD for p in parameters):
            continue
        wrong = named[0][:-1] + "_"
        with pytest.raises(TypeError, match=f"did you mean {named[0]}"):
            value(**{wrong: 1})
        seen += 1
    assert seen > 20


def test_functions_stay_what_they_are():
    assert pickle.loads(pickle.dumps(vv.forced_response)) is vv.forced_response
    assert "harmonics" in inspect.signature(vv.forced_response).parameters
    with pytest.raises(TypeError, match="missing"):
        vv.simulate()


def test_of_the_package():
    with pytest.raises(AttributeError, match=r"'forced_respons': did you mean forced_response\?"):
        _ = vv.forced_respons
    with pytest.raises(AttributeError, match=r"no attribute 'zzzzzz'$"):
        _ = vv.zzzzzz


MOUNT = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}


def respond(**options):
    return vv.forced_response(system(), [1.0], **({"load": 1} | options))


def of_forces(text):
    return vv.PolynomialSystem(mass=1, stiffness=1, forces=text)


def point(**given):
    return vv.MountPoint(**({"name": "a", "position": (0, 0, 0), "stiffness": (1, 1, 1)} | given))


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: vv.Mount(**(MOUNT | {"mass": "1 kg"})), "mass = '1 kg': must be a real number"),
        (lambda: vv.Mount(**(MOUNT | {"mass": -1})), "mass = -1: must be greater than 0"),
        (lambda: vv.Mount(**MOUNT, kernel=0.1), "kernel = 0.1: must be a Kernel or None"),
        (lambda: vv.Mount(**MOUNT, geometry="exakt"), "did you mean 'exact'?"),
        (lambda: vv.RzhanitsynKernel(amplitude=1, alpha=2, beta=1), "alpha = 2: must be in (0, 1]"),
        (lambda: of_forces("x^3 + y"), "'y' is neither a variable (x, x_dot) nor a parameter"),
        (lambda: of_forces("2*(x^3"), "its end is found where ) should be"),
        (lambda: of_forces("2x^3"), "every product has its *"),
        (lambda: of_forces("sgn(x_dot)"), "'sgn' is not a known function"),
        (lambda: of_forces("0.1*xdot"), "did you mean x_dot?"),
        (lambda: respond(harmonics="9"), "harmonics = '9': must be an integer or 'auto'"),
        (lambda: respond(tolerance=1), "tolerance = 1: must be in [1e-14, 0.1]"),
        (lambda: respond(method="HBM"), "did you mean 'newton'?"),
        (lambda: vv.forced_response(system(), [0, 1], load=1), "nu = 0: must be greater than 0"),
        (lambda: vv.forced_response(system(), [1]), "load or base: must be given"),
        (lambda: vv.forced_response(system(), [1], load="1 N"), "load = '1 N': must be numbers"),
        (lambda: vv.forced_response(system(), [1], load={"X": 1}), "one of the 1 coordinates x"),
        (lambda: vv.forced_response(system(), [1], load={1.5: 1}), "must be an integer"),
        (lambda: vv.forced_response(MOUNT, [1], load=1), "must be a Mount or a PolynomialSystem"),
        (lambda: vv.trace_response(system(), 1.0, load=1), "nu_range: must be two numbers"),
        (lambda: vv.simulate(system(), 10, initial=[1]), "initial: must have shape (2,)"),
        (lambda: vv.simulate(system(), 1, initial=[1, 0], dt=5), "not exceed t_end = 1"),
        (lambda: respond().amplitude("y"), "dof = 'y': must be one of 'x' (0)"),
        (lambda: vv.Spring(on="x1", law="x^3"), "did you mean d?"),
        (lambda: point(position=(0, 0)), "a: position: must have shape (3,), got (2,)"),
        (lambda: point(stiffness=1e5), "a: stiffness: must have shape (3,), got ()"),
        (lambda: point(name="front left"), "name = 'front left': must be letters, digits and _"),
        (lambda: vv.run("nothing.nml"), "nothing.nml: cannot be read"),
        (lambda: vv.read_dma("nothing.csv"), "nothing.csv: cannot be read"),
    ],
)
def test_of_values(call, text):
    """The thing, its value, and what is allowed, in one line."""
    with pytest.raises(vv.ViscovibError) as told:
        call()
    assert text in str(told.value)
    assert "\n" not in str(told.value)
