"""Results as values: printing, comparison, pickling, copies, plots and files."""

import ast
import copy
import functools
import pickle
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
import xarray as xr
from scipy.integrate import quad

MOUNT = vv.Mount(
    mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
    kernel=vv.PronyKernel(weights=[0.1], rates=[1.0]),
)  # fmt: skip
DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3 + 0.3*x^2")
BODY = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.05, c2=0.05, c3=0.05, f0=0.01, p1=0.9)


def _driven_motion():
    return vv.simulate(BODY, 10, initial=[0.1, 0, 0.1, 0, 0, 0])


def _free_motion():
    return vv.simulate(DUFFING, 60, dt=0.2, initial=[0.1, 0])


def _estimated():
    return vv.simulate(DUFFING, 5, dt=0.1, initial=[0.1, 0], estimate_error=True)


MOTION = """&pendulum e=0.1 w2=0.4 w3=0.8 /
&transient initial=0.05 0 0.3 0 0 0 t_end=5 dt=0.1 /
"""

RESULTS = {
    "response": lambda: vv.forced_response(MOUNT, [1, 1.5, 3], load=0.1),
    "judged response": lambda: vv.forced_response(
        MOUNT, [1, 2, 3], load=0.1, method="newton", stability=True
    ),
    "branch": lambda: vv.trace_response(DUFFING, (0.5, 2), load=0.3),
    "pendulum response": lambda: vv.forced_response(BODY, p1=[0.8, 0.9]),
    "pendulum branch": lambda: vv.trace_response(BODY, p1=(0.8, 1.0)),
    "backbone": lambda: vv.backbone(DUFFING, mode=0, amplitude_range=(0.01, 0.3)),
    "motion": _driven_motion,
    "motion with an estimate": _estimated,
    "motion with memory": lambda: vv.simulate(MOUNT, 5, dt=0.1, initial=[0.1, 0, 0, 0]),
    "ensemble": lambda: vv.simulate_ensemble(BODY, initial=np.full((3, 6), 0.01), t_end=5, dt=0.1),
    "ensemble with an estimate": lambda: vv.simulate_ensemble(DUFFING, initial=[[0.1, 0]], t_end=5),
    "spectrum": lambda: vv.spectrum(_driven_motion()),
    "campbell diagram": lambda: vv.campbell(
        vv.PolynomialSystem(mass=[1, 1], stiffness=[4, 4], gyroscopic=[[0, 0.5], [-0.5, 0]]),
        [0, 1, 2, 3],
        plane=("x1", "x2"),
    ),
    "shock response spectrum": lambda: vv.shock_response_spectrum(
        np.sin(np.arange(9)), [0.1, 0.2], dt=1
    ),
    "lines": lambda: vv.dominant_frequencies(_driven_motion(), count=2, coordinate="z"),
    "steady motions": lambda: vv.MultipleScales(BODY, tolerance=0.05).response("p1", [0.9, 1.0]),
}
RUBBER = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
FOOT = vv.MountPoint(
    name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5), kernel=RUBBER,
    rotational_stiffness=(1e3, 1e3, 1e3),
)  # fmt: skip
ENGINE = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[FOOT], gravity=9.81)
CHAIN = vv.Structure(
    mass=np.eye(3), stiffness=[[2, -1, 0], [-1, 2, -1], [0, -1, 1]], damping=0.02 * np.eye(3),
    elements=[vv.Spring(on={"x3": 1}, stiffness=1.0, law="d^3")],
)  # fmt: skip


def _modulus():
    nu = np.geomspace(1e-2, 1e4, 30)
    noise = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, 30))
    stiff = 2e6 * (1 - RUBBER.transform(nu))
    return vv.ModulusData(frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1])


def _sets():
    nu, warm = np.geomspace(1, 1e3, 10), [0.0, 10.0, 20.0]
    law = vv.WLF(reference=20.0, c1=8.86, c2=101.6)
    rubber = vv.ThermalKernel(kernel=RUBBER, shift=law)
    stiff = np.concatenate([2e6 * (1 - rubber.at(t).transform(nu)) for t in warm])
    return vv.ModulusData(
        frequencies=np.tile(nu, 3), storage=stiff.real, loss=stiff.imag,
        temperature=np.repeat(warm, 10),
    )  # fmt: skip


#: Three loads, two of them with close frequencies, so that amplitudes beat.
BEATING = vv.Pendulum(
    e=0.0102, w2=0.366, w3=0.988, alpha=0.573, c1=0.0258, c2=0.00555, c3=0.00837,
    f0=0.0046, m01=0.00058, m02=0.0017, p1=1.01, p2=1.0086, p3=0.3595,
)  # fmt: skip


def _forces():
    moved = vv.forced_response(ENGINE, [1, 2], load=ENGINE.load((0, 0, 10)), method="linear")
    return ENGINE.mount_forces(moved)


def _shaken():
    return vv.simulate(ENGINE, 0.05, dt=0.005, initial=[1e-3, 0] * 6)


RESULTS |= {
    "motion that repeats": lambda: vv.steady_motion(DUFFING, 0.7, load=0.1),
    "branch of motions": lambda: vv.trace_motion(DUFFING, (0.7, 0.8), load=0.1, max_step=0.2),
    "structure response": lambda: vv.forced_response(CHAIN, [0.4, 0.6], load={1: [0, 0, 0.1]}),
    "structure branch": lambda: vv.trace_response(CHAIN, (0.3, 0.5), load={1: [0, 0, 0.1]}),
    "structure motion": lambda: vv.simulate(CHAIN, 5, dt=0.1, load={1: [0, 0, 0.1]}, nu=0.4),
    "body response": lambda: vv.forced_response(ENGINE, [10, 20], load=ENGINE.load((0, 0, 10))),
    "body modes": ENGINE.modes,
    "mount forces": _forces,
    "mount forces in time": lambda: _shaken().mount_forces(),
    "motion of a point": lambda: _shaken().motion_of("foot"),
    "floor force": lambda: _shaken().floor_force(),
    "support reactions": lambda: vv.simulate(
        vv.Structure(mass=[1, 0], stiffness=[[4, -4], [-4, 4]], supports=["x2"]),
        1,
        initial=[0.5, 0],
    ).support_reactions(),
    "element forces": lambda: RESULTS["structure motion"]().element_forces(),
    "modulation": lambda: vv.MultipleScales(BODY).modulation([0, 1, 2], [0.1, 0, 0.1, 0, 0, 0]),
    "scales motion": lambda: vv.MultipleScales(BODY).motion([0, 1, 2], [0.1, 0, 0.1, 0, 0, 0]),
    "beating motion": lambda: vv.MultipleScales(BEATING).response("p1", [1.01]).beating(0),
    "basins": lambda: vv.basins(
        vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3"),
        {"x": [0.5, -0.5], "x_dot": [0.1, 0.2]},
        t_end=20,
        dt=0.1,
    ),
    "master curve": lambda: vv.master_curve(_sets(), reference=20.0),
    "kramers kronig": lambda: vv.kramers_kronig(_modulus()),
    "fit": lambda: vv.fit_kernel(_modulus()),
    "prony fit": lambda: vv.fit_kernel(_modulus(), kind="prony", terms=8),
}
#: Parts of results, without their own plots and tables.
PARTS = {
    "characteristic roots": DUFFING.characteristic_roots,
    "free decay": lambda: vv.free_decay(_free_motion()),
    "sag": ENGINE.sag,
    "peak of a motion": lambda: _estimated().peak("x"),
    "peaks of motions": lambda: vv.LocatedPeaks("x", *np.eye(3)),
    "profile": lambda: vv.fit_kernel(_modulus()).profile("alpha"),
    "optimum": lambda: vv.fit_kernel(_modulus()).optima[0],
    "band": lambda: vv.propagate(vv.fit_kernel(_modulus()), lambda s: s.modulus, samples=20),
    "shift fit": lambda: vv.master_curve(_sets(), reference=20.0).fit_law(),
    "terms": lambda: vv.prony_terms(
        vv.fit_kernel(_modulus(), kind="prony", terms=8), t_min=1e-3, t_max=1e3
    ),
    "data": _modulus,
}
DRAWN = set(RESULTS) - {
    "basins", "ensemble", "ensemble with an estimate", "lines", "body modes",
    "mount forces in time", "motion of a point", "floor force", "element forces",
    "support reactions",
    "mount forces", "modulation", "scales motion", "beating motion", "master curve",
    "kramers kronig", "fit", "prony fit",
}  # fmt: skip
#: Public classes that are arguments or containers; all other classes are results.
NOT_FOUND = [
    "AbelKernel", "Arrhenius", "Body", "BoucWen", "Chirp", "Coupling", "CreepData", "CubicSystem",
    "Dahl", "DriveTorque", "Event", "Explorer", "ExponentialSum", "FluidDamper", "FluidTrack",
    "Gap", "HalfSine", "Haversine", "Iwan", "Jenkins", "Kernel", "KernelFit", "LoadTable",
    "Maxwell", "ModalModel", "Monomial", "Mount", "MountPoint", "MultipleScales", "Past",
    "Pendulum", "PeriodicMotions", "PistonEngine", "Plan", "PolynomialSystem", "PronyKernel",
    "PythonLaw", "RabotnovKernel", "RelaxationData", "Result", "RunUp", "RzhanitsynKernel",
    "Sample", "Sawtooth", "Scene",
    "ShiftLaw", "ShiftTable", "Spring", "Springs", "Step", "Stop", "StribeckFriction",
    "Structure", "SumKernel", "TabulatedKernel", "ThermalKernel", "Trapezoid", "WLF",
]  # fmt: skip
#: Tested elsewhere: results of curves, of scenes, of amplitudes.
ELSEWHERE = [
    "AmplitudeFit", "BackbonePoint", "BranchPoint", "Crossing", "NormalCoordinates",
    "Peak", "ProgressiveLaw",
    "Resonance", "SceneResult", "TableResult",
]  # fmt: skip


@functools.cache
def made(name):
    """Return a result, cached for all tests, because some take a second."""
    return RESULTS[name]()


def test_every_public_class_that_holds_what_was_found_is_judged():
    classes = {
        name for name in vv.__all__
        if isinstance(getattr(vv, name), type) and not issubclass(getattr(vv, name), BaseException)
        and not issubclass(getattr(vv, name), Warning)
    }  # fmt: skip
    judged = {type(make()).__name__ for make in PARTS.values()}
    judged |= {base.__name__ for name in RESULTS for base in type(made(name)).__mro__}
    unknown = classes - judged - set(NOT_FOUND) - set(ELSEWHERE)
    assert unknown == set(), "name them in RESULTS or PARTS, or in NOT_FOUND if calls take them"
    assert set(NOT_FOUND) - classes == set()


@pytest.mark.parametrize("name", PARTS)
def test_parts_are_values(name):
    part, again = PARTS[name](), PARTS[name]()
    assert part == again
    assert hash(part) == hash(again)
    for other in (pickle.loads(pickle.dumps(part)), copy.copy(part), copy.deepcopy(part)):
        assert other == part
        assert repr(other) == repr(part)
    assert part != "something else"
    assert len(repr(part)) < 700


@pytest.mark.parametrize("name", RESULTS)
def test_its_table_is_written(name, tmp_path):
    result = made(name)
    assert isinstance(result.kind, str)
    result.to_csv(tmp_path / "table.csv")
    lines = (tmp_path / "table.csv").read_text().splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    assert len(rows) > 1
    assert len({line.count(",") - 2 * line.count('"') for line in rows[1:]}) == 1


@pytest.fixture(scope="module", params=RESULTS)
def named_result(request):
    return request.param, made(request.param)


def test_it_is_a_value(named_result):
    name, result = named_result
    again = RESULTS[name]()
    assert result == again
    assert hash(result) == hash(again)
    for other in (pickle.loads(pickle.dumps(result)), copy.copy(result), copy.deepcopy(result)):
        assert other == result
        assert repr(other) == repr(result)
    assert result != "something else"


def test_it_prints_in_a_few_lines(named_result):
    _, result = named_result
    text = repr(result)
    assert text.startswith(f"<{type(result).__name__}: ")
    assert len(text.splitlines()) <= (9 if result.kind == "modes" else 6)
    assert len(text) < 700
    assert result.summary().splitlines()[0] in text
    assert result.complete or result.kind in ("lines", "basins")


def test_it_is_drawn(named_result):
    name, result = named_result
    text = result._repr_html_()
    assert ("<svg" in text) == (name in DRAWN)
    if name in DRAWN:
        import matplotlib.pyplot as plt

        assert result.plot() is not None
        plt.close("all")


def test_netcdf_holds_everything(named_result, tmp_path):
    _, result = named_result
    path = tmp_path / "result.nc"
    result.to_netcdf(path)
    with xr.open_dataset(path, engine="scipy") as read:
        for key, array in result.to_dataset().data_vars.items():
            if np.iscomplexobj(array):
                parts = read[f"{key}_re"].values + 1j * read[f"{key}_im"].values
                np.testing.assert_array_equal(parts, array.values)
            elif array.dtype.kind in "biuf":
                np.testing.assert_array_equal(read[key].values, array.values)
            else:
                assert read[key].values.astype(str).tolist() == array.values.astype(str).tolist()


def test_what_is_saved_says_how_sure_it_is(named_result):
    """The Dataset also contains the error and the outcome of a result."""
    _, result = named_result
    reported = (
        "outcome", "error", "truncation", "error_estimate", "coordinate_errors", "growth_error",
        "folds", "iterations",
    )  # fmt: skip
    data = result.to_dataset()
    for name in reported:
        value = getattr(result, name, None)
        if value is None or callable(value):
            continue
        assert name in data or name in data.attrs, name
        np.testing.assert_array_equal(data[name] if name in data else data.attrs[name], value)


@pytest.mark.parametrize("name", ["branch", "driven branch"])
def test_what_is_saved_tells_where_stability_changes(name):
    if name == "branch":
        hard = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
        branch = vv.trace_response(hard, (0.8, 2.5), load=0.3)
    else:
        body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.01, c2=0.01, c3=0.01, f0=0.02, p1=0.9)
        branch = vv.trace_response(body, p1=(0.7, 0.9))
    data = branch.to_dataset()
    assert branch.crossings
    for key in ("kind", "before", "sure"):
        saved = data[f"crossing_{key}"].values.tolist()
        assert saved == [getattr(crossing, key) for crossing in branch.crossings]
    places = [np.nan if one.parameter is None else one.parameter for one in branch.crossings]
    np.testing.assert_array_equal(data["crossing_parameter"], places)


def test_a_difference_is_seen():
    one, other = (vv.forced_response(MOUNT, [1, 1.5], load=load) for load in (0.1, 0.1 + 1e-12))
    assert one != other


def test_corrections_survive_pickling():
    response = RESULTS["response"]()
    np.testing.assert_array_equal(
        pickle.loads(pickle.dumps(response)).corrections, response.corrections
    )


def test_motions_of_scenes_pickle(tmp_path):
    path = tmp_path / "motion.nml"
    path.write_text(MOTION)
    result = vv.run(path)
    assert pickle.loads(pickle.dumps(result)).value == result.value


def test_peak_to_peak_finds_the_highest_of_many_summits():
    """Random harmonics, against samples with an error of at most 3e-8."""

    class Motions(vv.PeriodicMotions):
        dof_names = ("x",)

        def __init__(self, orders, coefficients):
            self.row = np.ones(len(coefficients)), orders, coefficients

        def _motions(self):
            return self.row

    rng = np.random.default_rng(7)
    angles = np.linspace(0, 2 * np.pi, 60_001)
    for _ in range(40):
        orders = np.unique(rng.integers(0, 16, 6))
        parts = rng.normal(size=(2, 20, 1, orders.size))
        x = (parts[0] + 1j * parts[1]) * 10.0 ** rng.uniform(-3, 0, orders.size)
        x[:, :, orders == 0] = 1j * x[:, :, orders == 0].imag
        u = (x[:, 0] @ np.exp(1j * np.outer(orders, angles))).imag
        wide = u.max(axis=1) - u.min(axis=1)
        found = Motions(orders, x).peak_to_peak("x")
        assert found == pytest.approx(wide, rel=1e-6)
        assert (found >= wide * (1 - 1e-12)).all()


@pytest.mark.parametrize("name", ["judged response", "branch", "pendulum branch", "backbone"])
def test_what_follows_from_the_harmonics(name):
    """Against integrals and samples of the waveform."""
    result = RESULTS[name]()
    dof = result.dof_names[-1]
    d = len(result.dof_names) - 1
    i = len(result.coefficients) // 2
    orders = result.harmonics
    nu = float(result.nu[i])
    own = result.coefficients[i, d]

    def u(t, times=0):
        return float((own * (1j * orders * nu) ** times * np.exp(1j * orders * nu * t)).sum().imag)

    period = 2 * np.pi / nu
    mean_square = quad(lambda t: u(t) ** 2, 0, period, epsabs=0, epsrel=1e-12, limit=400)[0]
    assert result.rms(dof)[i] == pytest.approx(np.sqrt(mean_square / period), rel=1e-9)
    t, waves = result.waveform(i, 100_000)
    assert waves[1234, d] == pytest.approx(u(t[1234]), abs=1e-14)
    wide = waves[:, d].max() - waves[:, d].min()
    assert result.peak_to_peak(dof)[i] == pytest.approx(wide, rel=1e-8)
    k = int(orders[orders > 0][0])
    assert result.velocity(dof, k)[i] == 1j * k * nu * own[list(orders).index(k)]
    assert result.acceleration(dof, k)[i] == pytest.approx(
        -((k * nu) ** 2) * own[list(orders).index(k)], rel=1e-15
    )
    assert result.phase(dof, k)[i] == np.angle(own[list(orders).index(k)])


#: Allowed `isinstance` checks: several kinds of argument, scene results or sweep Datasets.
_ASKED = {
    "analyses/shooting.py: SteadyMotion",
    "analyses/shock_spectra.py: Trajectory",
    "analyses/signals.py: Trajectory",
    "analyses/starts.py: Trajectory",
    "rubber/amplitude_fit.py: ParametricFit",
    "rubber/kernel_fit.py: MasterCurve",
    "rubber/terms.py: KernelFit",
    "scene/job.py: Result",
}


def test_results_are_not_asked_what_they_are():
    """Other modules use attributes: no other `isinstance` in the package names a result."""
    assert all(getattr(vv, name) is not None for name in dir(vv))  # loads them
    names, pending = set(), [vv.Result]
    while pending:
        kind = pending.pop()
        names.add(kind.__name__)
        pending += kind.__subclasses__()
    assert {"Response", "DrivenBranch", "TableResult", "StructureTrajectory"} <= names
    package = Path(vv.__file__).parent
    found = set()
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
                asked = {one.id for one in ast.walk(node.args[1]) if isinstance(one, ast.Name)}
                found |= {f"{path.relative_to(package)}: {name}" for name in asked & names}
    assert found == _ASKED


def test_motions_without_an_estimate_say_so():
    system = vv.PolynomialSystem(mass=1, stiffness=1, forces="x^3")
    found = vv.simulate(system, 5, initial=[1, 0])
    given = vv.simulate(system, 5, initial=[1, 0], dt=0.1)
    many = vv.simulate_ensemble(system, initial=[[1, 0]], t_end=5, dt=0.1)
    assert "estimated error" in found.summary()
    for run in (given, vv.simulate(system, 10, resume=found), many):
        assert run.error is None
        assert "error not estimated" in repr(run)
        assert "estimate of the error" in str(run.plan)


#: Multiple scales have no units: their systems may be in any units.
UNITLESS = {"beating motion", "modulation", "scales motion", "steady motions"}


@pytest.mark.parametrize("name", sorted(set(RESULTS) - UNITLESS))
def test_coordinates_in_datasets_have_units(name):
    """Every Dataset with coordinates as an axis has their units along it."""
    data = made(name).to_dataset()
    if "dof" in data.dims:
        assert data["unit"].dims == ("dof",)
    if "run" in data.dims:
        assert data["unit_of_quantity"].dims == ("quantity",)
