"""Signatures of the functions of steady motions, for editors, `help()` and mypy."""

import inspect
import re
import typing
import warnings
from dataclasses import replace

import documented_calls
import pytest
import viscovib as vv

SHARED = (vv.forced_response, vv.trace_response, vv.backbone)
FUNCTIONS = (*SHARED, vv.plan_response, vv.simulate, vv.simulate_ensemble)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_signature_is_real(function):
    arguments = inspect.signature(function).parameters
    assert next(iter(arguments)) == "system"
    kinds = {one.kind for one in arguments.values()}
    assert kinds <= {inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY}
    assert all(one.annotation is not one.empty for one in arguments.values())
    text = inspect.getdoc(function)
    assert text.count("Parameters\n----------") == 1
    reported = set()
    for line in re.findall(r"^(\w[\w, ]*?)(?: : .*)?$", text.split("----------")[1], re.MULTILINE):
        reported |= set(line.split(", "))
    assert set(arguments) - reported == set()


def options(form):
    """Names and types in ``**curve`` of an overload."""
    behind = [
        kind
        for kind in typing.get_type_hints(form).values()
        if typing.get_origin(kind) is typing.Unpack
    ]
    return typing.get_type_hints(typing.get_args(behind[0])[0]) if behind else {}


@pytest.mark.parametrize("function", SHARED)
def test_forms_have_the_arguments_and_defaults_of_the_whole(function):
    whole = inspect.signature(function).parameters
    types = {name: one.annotation for name, one in whole.items()} | typing.get_type_hints(function)
    reported = set()
    assert len(typing.get_overloads(function)) == 2
    for form in typing.get_overloads(function):
        for name, one in inspect.signature(form).parameters.items():
            if one.kind is not one.VAR_KEYWORD:
                # An overload may require an argument, but never has another default.
                assert one.default in (inspect.Parameter.empty, whole[name].default), name
                reported.add(name)
        for name, kind in options(form).items():
            assert kind == types[name], name
            reported.add(name)
    assert reported == set(whole)


@pytest.mark.parametrize(
    "call",
    [
        documented_calls.responses, documented_calls.branches, documented_calls.backbones,
        documented_calls.motions,
    ],
)  # fmt: skip
def test_documented_calls_run(call):
    call()


def test_what_a_kind_of_system_lacks_is_refused_by_name():
    for call in documented_calls.REFUSED:
        with pytest.raises(vv.InputError, match=r"is not an argument for a|must be given for a"):
            call()


@pytest.mark.parametrize(("function", "first"), [
    (vv.forced_response, {"nu": 1.0, "load": 0.1}),
    (vv.trace_response, {"nu_range": (1, 2), "load": 1}),
    (vv.backbone, {"mode": 0, "amplitude_range": (0.1, 0.11)}),
])  # fmt: skip
def test_any_value_of_an_argument_that_is_lacking_is_refused(function, first):
    """For each kind of system each argument of the other kind, with values of any type."""
    forms = typing.get_overloads(function)
    taken = [inspect.signature(form).parameters for form in forms]
    for system, own, other in (
        (documented_calls.DUFFING, taken[0], taken[1]),
        (documented_calls.SWUNG, taken[1], taken[0]),
    ):
        given = {name: value for name, value in first.items() if name in own}
        for name in set(other) - set(own):
            for value in (0.123, [1, 2], (1.0, 2.0), "x"):
                with pytest.raises(vv.InputError, match=f"{name}: is not an argument for a"):
                    function(system, **given, **{name: value})
            default = inspect.signature(function).parameters[name].default
            if function is vv.backbone:
                function(documented_calls.DUFFING, **first, **{name: default})


def test_a_name_that_nobody_knows_is_an_error_of_the_function_called():
    with pytest.raises(TypeError, match=r"^BoucWen\(\) got .* 'exponnt': did you mean exponent"):
        vv.BoucWen(on="x1", exponnt=2)
    with pytest.raises(TypeError, match=r"forced_response\(\) got an unexpected .* 'mount'"):
        vv.forced_response(mount=documented_calls.MOUNT, nu=1, load=1)


STRETCHED = replace(documented_calls.SWUNG, m01=0.0, f0=0.1, p1=0.8)
WARNING = [
    lambda: vv.forced_response(documented_calls.DUFFING, 1.0, load=1, method="successive"),
    lambda: vv.forced_response(documented_calls.DUFFING, 1.0, load=1, method="newton", harmonics=1),
    lambda: vv.trace_response(documented_calls.DUFFING, (0.5, 0.6), load=1, harmonics=1),
    lambda: vv.forced_response(STRETCHED, f0=[0.01, 40.0], harmonics=9),
    lambda: vv.trace_response(documented_calls.SWUNG, m01=(0.05, 0.06), harmonics=2),
    lambda: vv.backbone(documented_calls.SWUNG, 0, (0.4, 0.5), harmonics=2),
    lambda: vv.fit_shift_law([0.0, 20.0, 40.0], [0.0, -4.0, -4.5], reference=0, law="arrhenius"),
    lambda: vv.dominant_frequencies(_kept_too_rarely(), count=1),
]


def _kept_too_rarely():
    return vv.simulate(vv.PolynomialSystem(mass=1, stiffness=1), 200, initial=[1, 0], dt=5.0)


@pytest.mark.parametrize("call", WARNING)
def test_warnings_name_the_line_that_calls(call):
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter("always")
        call()
    assert reported
    assert {one.filename for one in reported} == {__file__}


@pytest.mark.parametrize("module", ["viscovib_study", "study"])
def test_warnings_name_the_line_of_a_module_with_a_like_name(module):
    """Also through a cached property."""
    code = (
        "import functools, viscovib as vv\n"
        "class Study:\n"
        "    @functools.cached_property\n"
        "    def response(self):\n"
        "        return vv.forced_response(SYSTEM, 1.0, load=1, method='newton', harmonics=1)\n"
        "Study().response\n"
    )
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter("always")
        exec(
            compile(code, "/of the user.py", "exec"),
            {"__name__": module, "SYSTEM": documented_calls.DUFFING},
        )
    assert {(one.filename, one.lineno) for one in reported} == {("/of the user.py", 5)}
