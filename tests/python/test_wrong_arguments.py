"""Wrong arguments of every kind: an InputError in one line, immediately."""

from pathlib import Path

import numpy as np
import pytest
import viscovib as vv

START = (0.05, 0, 0.3, 0, -0.2, 0)
EMPTY = np.zeros((0, 3))
CUBE = np.zeros((2, 2, 2))
KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
CUBIC = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3", names=("x",))
MASKED = np.ma.masked_array([1.0, 2.0], mask=[False, True])
SCENES = Path(__file__).parents[2] / "data" / "scenes"


def scene():
    return vv.Scene.read(SCENES / "mount_paper.nml")


def physical(**changes):
    given = {"m": 1, "I_A": 0.2, "E": 0.1, "L0": 0.5, "k1": 100} | changes
    return vv.Pendulum.from_physical(**given)


def terms(**changes):
    kernel = vv.AbelKernel(amplitude=0.1, alpha=0.3)
    return vv.prony_terms(kernel, **({"t_min": 1e-3, "t_max": 10, "tolerance": 0.05} | changes))


NESTED = []
NESTED.append(NESTED)


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


def cubic(**options):
    return vv.simulate(CUBIC, 5.0, **options)


def engine(**options):
    foot = vv.MountPoint(name="foot", position=(0, 0, 0), stiffness=(1, 1, 1))
    return vv.Body(mass=1, inertia=(1, 1, 1), mounts=[foot], **options)


def two_masses(mass):
    return vv.PolynomialSystem(mass=mass, stiffness=np.eye(2))


def named(unread, **options):
    """A system with a parameter that occurs in no force."""
    given = {"k": 1.0, unread: 1.0}
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="k*x^3", parameters=given)
    if "parameters" in options:
        return vv.simulate_ensemble(system, initial=[1, 0], t_end=5, **options)
    return vv.trace_response(system, load=0.1, **options)


def joined(**options):
    """A structure whose joint has a parameter that does not occur in its law."""
    joint = vv.Spring(on="x1", law="k*d^3", parameters={"k": 1.0, "c": 1.0})
    chain = vv.Structure(mass=[1, 1], stiffness=np.diag([1.0, 2.0]), elements=[joint])
    return vv.trace_response(chain, nu=0.5, vary_range=(0, 1), load={"x1": 0.1}, **options)


@pytest.mark.parametrize(
    ("work", "text"),
    [
        # Arrays where a word, a number or a truth value is expected.
        (lambda: respond(harmonics=EMPTY), "harmonics = array"),
        (lambda: respond(relaxation=EMPTY), "relaxation = array"),
        (lambda: respond(method=CUBE), "method = array"),
        (lambda: vv.forced_response(pendulum(), harmonics=EMPTY), "harmonics = array"),
        (lambda: vv.forced_response(CUBE, 1.0, load=1), "system = array"),
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
        # Types and values of numbers and arrays.
        (lambda: swing(dt="Auto"), "dt = 'Auto': must be a real number or 'auto'"),
        (lambda: many(dt="Auto"), "dt = 'Auto': must be a real number or 'auto'"),
        (lambda: many(lyapunov="largest"), "lyapunov = 'largest': must be True, False or 'all'"),
        (lambda: many(n_periods=3, t_end=None), "must name the load .* as sections=1"),
        (
            lambda: cubic(initial=[1]),
            r"initial: must have shape \(2,\), got \(1,\): values of x, x_d",
        ),
        (
            lambda: cubic(initial={"x": 1}),
            r"initial = {'x': 1}: must be 2 numbers, values of x, x_dot",
        ),
        (lambda: cubic(initial=[1, 0], method="RK45"), "'gauss16', .*'rk4', .*'gauss6'"),
        (lambda: cubic(initial=[1, 0], events=["y"]), r"'y' is neither a variable \(x, x_dot, t\)"),
        (lambda: vv.AbelKernel(amplitude=np.complex128(1), alpha=0.3), "must be a real number"),
        (lambda: swing(np.array(5 + 0j)), "must be a real number"),
        (lambda: vv.spectrum(swing(dt=0.5), coordinates=np.float16(1.5)), "coordinates = .*names"),
        (lambda: vv.spectrum(swing(dt=0.5), coordinates=[1]), r"coordinates = \[1\]: .*names"),
        (lambda: terms(modulus=5e-324), "modulus = 4.94066e-324: must be in "),
        (lambda: terms(modulus=1e308), r"modulus = 1e\+308: must be"),
        (lambda: vv.animate(swing(dt=0.5), fps=1e-320), "fps = 9.99989e-321: must be"),
        (lambda: vv.Spring(on="x", law="a" * 19000), r"law = 'a+\.\.\.': 'a+\.\.\.' is neither"),
        (lambda: vv.Spring(on="x", law=NESTED), "law = "),
        (lambda: vv.PolynomialSystem(mass=1, stiffness=1, forces="x+" + "9" * 5000), "forces"),
        (lambda: respond(load="0.1"), "load = '0.1': must be numbers, got text"),
        (lambda: respond(load=[None, 1]), "must be numbers, got None"),
        (lambda: respond(load=np.sin), "must be numbers, got a ufunc"),
        (lambda: respond(load=[10**400, 1]), "must be finite numbers"),
        (lambda: respond(load=np.nan), r"load = nan: must be"),
        (lambda: engine(gravity=-9.81), "gravity = -9.81: must not be negative as a number"),
        (lambda: vv.PolynomialSystem(mass=-1), "positive definite, has too small a diagonal -1 in"),
        (lambda: two_masses([[1, 2], [3, 4]]), "has 2 in row 1, column 2 and 3 in row 2, column 1"),
        (lambda: two_masses([[1, 2], [2, 1]]), "has too small a diagonal 1 in row 2"),
        # Numbers that are not used.
        (
            lambda: named("gap", vary="gap", vary_range=(0, 1), nu=1.0),
            "a parameter of its forces, k$",
        ),
        (lambda: named("c", parameters={"c": [1, 2]}), "'c' does not vary .*memory_scale, k$"),
        (lambda: joined(vary="elements[0].c"), "must be one of stiffness, k of this element"),
        # Objects other than results, mappings or pairs.
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
        # Values whose text has several lines.
        (lambda: body(mass=CUBE), "mass = array.*must be a real number"),
        (lambda: body(kernel=body()), "kernel = Mount.*must be a Kernel or None"),
        (lambda: vv.PolynomialSystem(mass=1, stiffness=1, forces=CUBE), "forces = array"),
        # Runs that exceed any memory, or never end.
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
        # Keyword arguments, also of functions with several forms.
        (
            lambda: vv.backbone(CUBIC, mode=0, energy_range=(0.1, 1)),
            "backbone: energy_range: is not an argument for a mount, a polynomial system or a str",
        ),
        (
            lambda: vv.forced_response(pendulum(), 1, load=body()),
            "load: is not an argument for a pend",
        ),
        (lambda: vv.trace_response(body(), (1, 2), f0=1), "trace_response: f0: is not an argument"),
        (
            lambda: vv.forced_response(body()),
            "nu: must be given for a mount or a polynomial system",
        ),
        (
            lambda: vv.backbone(CUBIC, 0),
            "amplitude_range: must be given for all systems except a p",
        ),
        (
            lambda: vv.backbone(1, 0),
            "system = 1: must be a Mount or a PolynomialSystem or a Structure or a Pend",
        ),
        (lambda: scene().override(1), "values = 1: must be a mapping"),
        (lambda: vv.run(scene()).to_csv("x.csv", 1), "which = 1: must be 0 to 0"),
        (lambda: vv.run(scene()).to_csv(1), "path = 1: must be a path"),
        (lambda: swing(dt=0.5).to_csv(""), "path = '': is not a path of a file"),
        (lambda: swing(dt=0.5).to_csv("a\0b"), "path = 'a.*b': is not a path of a file"),
        (lambda: swing(dt=0.5).to_csv("x", coordinates=5), "coordinates = 5: must be a list or tu"),
        (lambda: swing(dt=0.5).to_dataset(physical=EMPTY), "physical = array"),
        (lambda: swing(dt=0.5, progress=EMPTY), "progress = array"),
        (lambda: many(dt=0.5, progress="no"), "progress = 'no'"),
        (lambda: swing(dt=0.5, keep="tail", tail="x"), "tail = 'x'"),
        (lambda: vv.simulate(CUBIC, 1e308), "t_end = 1e[+]308: takes"),
        (lambda: many(t_end=1e308, sections=2, dt=0.1), "t_end / dt = .*must be 1 to"),
        (lambda: physical(Omega1="e"), "Omega1 = 'e': must be a real number"),
        (lambda: physical(m=0), "m = 0: must be greater than 0"),
        (lambda: physical(k2=1e308, k1=1e-300), "too far apart"),
        (lambda: vv.plot_branch(follow(), harmonic={"x": 1}), "harmonic: has no order for 'phi'"),
        (lambda: vv.plot_branch(follow(), 5), "ax = 5: must be Axes"),
        (lambda: vv.plot_response(respond(), labels=0.5), "labels = 0.5: must be a list or tuple"),
        (lambda: vv.plot_response(respond(), y=EMPTY), "y = array"),
        (
            lambda: vv.plot_response([respond(), respond()], labels=["a"]),
            "labels: 1 given, must be 2",
        ),
        (lambda: vv.spectrum([1, 2], 1, names=5), "names = 5: must be a list or tuple"),
        (lambda: vv.sweep(lambda x: x, {"x": [1]}, progress=CUBE), "progress = array"),
        # Masked values do not count as values.
        (lambda: respond(load=MASKED), r"load: 1 of 2 masked, must be without a mask"),
        (lambda: vv.forced_response(body(), MASKED, load=1), "nu: 1 of 2 masked"),
        (lambda: vv.spectrum([[MASKED, MASKED]], 1), r"signal\[0\]\[0\]: 1 of 2 masked"),
        (lambda: body(mass=np.ma.masked), "mass: 1 of 1 masked"),
        (lambda: vv.LoadTable(times=[0, 1], values=MASKED), "values: 1 of 2 masked"),
        (lambda: vv.sweep(lambda x: x, {"x": MASKED}), r"grid\['x'\]: 1 of 2 masked"),
        (lambda: KERNEL.transform([1, np.ma.masked]), r"mu\[1\]: 1 of 1 masked"),
        (
            lambda: KERNEL.sum_of_exponentials(t_min=1e-3, t_max=1e300),
            "t_max = 1e[+]300: must be in",
        ),
        # A range needs no memory, but the array would.
        (lambda: vv.spectrum(range(10**30), 1), "signal: has 10{30} entries, must have at most"),
        (lambda: pendulum().rhs(0, np.zeros((0, 6))), r"state: has no states, its shape is \(0, 6"),
        # Values that are not finite numbers.
        (
            lambda: vv.PronyKernel(weights=[1], rates=[2]).laplace([0, -2]),
            r"s\[1\] = -2.*not a finite",
        ),
        (lambda: vv.AbelKernel(amplitude=1, alpha=0.5).laplace(0), "s = 0.*: the transform is no"),
        (lambda: body().dynamic_stiffness([1, 1e308]), r"nu\[1\] = 1e[+]308: the dynamic stiffn"),
        (lambda: CUBIC.dynamic_stiffness(1e200), "nu = 1e[+]200: the dynamic stiffness is no"),
        (lambda: pendulum().rhs(0, [0, 1e199, 0, 1e199, 0, 1e199]), "state: the acceleration"),
        (lambda: pendulum().energy([START, [0, 1e199, 0, 0, 0, 0]]), r"state\[1\]: the energy of"),
        (
            lambda: pendulum(f0=0.1, p1=10).rhs(1e308, START),
            "t = 1e[+]308: the phases of the loads",
        ),
        (lambda: CUBIC.energy([1e200, 0]), "state: the energy of a state of size 1e[+]200"),
    ],
)
def test_wrong_arguments_are_reported_in_a_line(work, text):
    with pytest.raises(vv.ViscovibError, match=text) as reported:
        work()
    assert "\n" not in str(reported.value)
    assert len(str(reported.value)) < 1000


def test_a_mask_that_hides_nothing_is_no_mask():
    signal = np.ma.masked_array([1.0, 2.0, 1.0], mask=False)
    assert (vv.spectrum(signal, 1).coefficients == vv.spectrum(signal.data, 1).coefficients).all()


def test_what_a_function_of_a_sweep_masks_has_no_value():
    data = vv.sweep(
        lambda x: np.ma.masked_array([x, 2 * x], mask=[False, x > 1]), {"x": [1.0, 3.0]},
        progress=False,
    )  # fmt: skip
    assert np.array_equal(data.result.values, [[1, 2], [3, np.nan]], equal_nan=True)
