"""Wrong arguments of every kind: an error of ours, in one line, at once."""

import numpy as np
import pytest
import viscovib as vv

START = (0.05, 0, 0.3, 0, -0.2, 0)
EMPTY = np.zeros((0, 3))
CUBE = np.zeros((2, 2, 2))
KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)


def body(**changes):
    given = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
    return vv.Mount(**(given | {"damping": [[0.2, -0.1], [-0.1, 0.09]]} | changes))


def pendulum(**changes):
    return vv.Pendulum(**({"e": 0.1, "w2": 0.4, "w3": 0.8, "m01": 0.005, "p2": 0.37} | changes))


def swing(t_end=5.0, **options):
    return vv.simulate(pendulum(), t_end, **({"initial": START} | options))


def many(**options):
    return vv.simulate_ensemble(pendulum(), **({"initial": START, "t_end": 5} | options))


def respond(**options):
    return vv.forced_response(body(), [1.0], **({"load": 0.1} | options))


def follow(**options):
    return vv.trace_response(body(), **({"nu_range": (0.5, 1), "load": 0.1} | options))


@pytest.mark.parametrize(
    ("work", "text"),
    [
        # Arrays where a word, a number or a yes is wanted.
        (lambda: respond(harmonics=EMPTY), "harmonics = array"),
        (lambda: respond(relaxation=EMPTY), "relaxation = array"),
        (lambda: respond(method=CUBE), "method = array"),
        (lambda: vv.forced_response(pendulum(), harmonics=EMPTY), "harmonics = array"),
        (lambda: vv.forced_response(CUBE, 1.0, load=1), "mount = array"),
        (lambda: follow(nu_range=EMPTY), "nu_range"),
        (lambda: follow(stability=EMPTY), "stability = array.*must be True or False"),
        (lambda: follow(stability="no"), "stability = 'no': must be True or False"),
        (lambda: swing(dt=EMPTY), "dt = array"),
        (lambda: swing(dt=0.5, estimate_error=EMPTY), "estimate_error = array"),
        (lambda: many(dt=0.1, lyapunov="no"), "lyapunov = 'no'"),
        (lambda: many(dt=0.1, statistics=EMPTY), "statistics = array"),
        (lambda: vv.sweep(lambda x: x, {"x": [1]}, vectorized=EMPTY), "vectorized = array"),
        (lambda: vv.sweep(lambda x: x, {"x": [1]}, chunk=EMPTY), "chunk = array"),
        (lambda: vv.PolynomialSystem(mass=1, stiffness=1, springs=None), "springs: must be"),
        # Other things than results, mappings or pairs.
        (lambda: vv.plot_trajectory("x"), "trajectory = 'x': must be a Trajectory"),
        (lambda: vv.plot_trajectory([None]), r"trajectory\[0\] = None: must be a Trajectory"),
        (lambda: vv.plot_trajectory([]), "trajectory: must not be empty"),
        (lambda: vv.plot_response(None), "response = None: must be a Response or a Driven"),
        (lambda: vv.plot_branch(body()), "branch = Mount.*: must be a Branch or a DrivenBranch"),
        (lambda: vv.plot_backbone("x"), "backbone = 'x': must be a Backbone"),
        (lambda: vv.plot_sections(None), "ensemble = None: must be an Ensemble"),
        (lambda: vv.plot_spectrum(None), "spectrum = None: must be a Spectrum"),
        (lambda: vv.plot_modulation(None), "motion = None: must be a ScalesMotion"),
        (lambda: vv.plot_scales_response(body()), "response = Mount.*: must be a ScalesResponse"),
        (lambda: vv.free_decay(None), "trajectory = None: must be a Trajectory"),
        (lambda: vv.name_frequencies([1], "x"), "bases = 'x': must be a mapping"),
        (lambda: vv.name_frequencies([1], EMPTY), "bases = array.*: must be a mapping"),
        (lambda: vv.name_frequencies([[1]], {"a": 1}), "frequencies: must have 0 or 1 dimension"),
        (lambda: many(dt=0.1, parameters="x"), "parameters = 'x': must be a mapping"),
        (lambda: many(dt=0.1, parameters=EMPTY), "parameters = array.*: must be a mapping"),
        (lambda: follow().peak("x", band=True), "band = True: must be two numbers"),
        (lambda: follow().peak("x", band=[[1, 2], [3]]), "band = .*: must be two numbers"),
        (lambda: follow().amplitude("x", []), r"harmonic = \[\]: must be one of those kept"),
        (lambda: respond().amplitude("x", []), r"harmonic = \[\]: must be one of those kept"),
        (lambda: respond().amplitude("x", "a\nb"), "harmonic = .*: must be one of those kept"),
        (lambda: pendulum().rhs([], START), "t: must be one number or have shape"),
        # Values whose text takes several lines.
        (lambda: body(mass=CUBE), "mass = array.*must be a real number"),
        (lambda: body(kernel=body()), "kernel = Mount.*must be a Kernel or None"),
        (lambda: vv.PolynomialSystem(mass=1, stiffness=1, forces=CUBE), "forces = array"),
        # Runs that nobody's memory holds, or that never end.
        (lambda: swing(1e9, dt=0.25), "would keep 4000000000 states, must be at most"),
        (lambda: swing(1e300), "t_end = 1e[+]300: takes .* steps.*, must be at most"),
        (lambda: swing(5, dt=1e-320), "must be at most 1e[+]12"),
        (lambda: many(dt=1e-320), "t_end / dt = .*must be 1 to"),
        (lambda: many(t_end=1e300), "t_end / dt = .*must be 1 to"),
        (lambda: vv.simulate(body(kernel=KERNEL), 1e9, dt=0.25), "would keep 4000000000 states"),
        (
            lambda: vv.simulate(body(kernel=KERNEL), 1e308, load=0.1, nu=1),
            "t_end = 1e[+]308: takes",
        ),
    ],
)
def test_wrong_arguments_are_told_in_a_line(work, text):
    with pytest.raises(vv.ViscovibError, match=text) as told:
        work()
    assert "\n" not in str(told.value)
