"""For a misspelt keyword the message suggests a similar name."""

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
        (lambda: system().dynamic_stiffness(n=1), "must be one of nu"),
        (lambda: vv.forced_response(system(), [1.0], load=1).peak("x", harmonc=1), "harmonic?"),
        (lambda: vv.PronyKernel(weights=[0.1], rates=[1]).sum_of_exponentials(1, tmin=1), "t_min?"),
    ],
)
def test_of_calls(call, text):
    with pytest.raises(TypeError, match="unexpected keyword argument") as reported:
        call()
    assert text in str(reported.value)


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
