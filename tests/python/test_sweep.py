"""Sweeps: every point equals a single call, results have coordinates, failures are named."""

import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
import xarray as xr
from viscovib.scene.units import unit_of

SCENES = Path(__file__).parents[2] / "data" / "scenes"
PAPER = SCENES / "mount_paper.nml"
MOTION = SCENES / "mount_motion.nml"


def sweep(*arguments, **options):
    return vv.sweep(*arguments, progress=False, **options)


def test_every_kind_of_result_stands_at_its_point():
    def what(a, b, c):
        return {
            "sum": a + 10 * b,
            "whole": int(b),
            "wave": np.array([a, b]) * 1j,
            "name": f"{c}{b:g}",
            "true": a > 1,
        }

    grid = {"a": [1.0, 2.0, 3.0], "b": np.arange(4), "c": ["p", "q"]}
    for chunk in (1, 3, 5, 8, 100, "auto"):
        data = sweep(what, grid, chunk=chunk, n_threads=2)
        assert data["sum"].dims == ("a", "b", "c")
        for i, a in enumerate(grid["a"]):
            for j, b in enumerate(grid["b"]):
                for k, c in enumerate(grid["c"]):
                    point = data.isel(a=i, b=j, c=k)
                    assert point["sum"] == a + 10 * b
                    assert point["whole"] == b
                    assert (point["wave"].values == np.array([a, b]) * 1j).all()
                    assert point["name"].item() == f"{c}{b:g}"
                    assert point["true"] == (a > 1)
        assert (data.a.values == grid["a"]).all()
        assert data.attrs["swept"].endswith("what")


def test_numbers_arrays_and_datasets_as_results():
    assert (sweep(lambda x: x**2, {"x": [1, 2, 3]}).result.values == [1, 4, 9]).all()

    def table(x):
        return xr.Dataset(
            {"y": ("t", x * np.arange(3), {"units": "m"})}, coords={"t": [0.0, 0.5, 1.0]},
            attrs={"how": "well", "steps": int(x)},
        )  # fmt: skip

    data = sweep(table, {"x": [1.0, 2.0]})
    assert data.y.dims == ("x", "t")
    assert data.y.attrs == {"units": "m"}
    assert (data.y.sel(x=2, t=0.5) == 2).all()
    assert data.steps.values.tolist() == [1, 2]
    assert (data.how == "well").all()
    array = sweep(lambda x: xr.DataArray([x], dims="k", name="z"), {"x": [1.0, 2.0]})
    assert array.z.dims == ("x", "k")


def test_a_scene_over_a_grid_is_the_scene_with_its_keys_changed():
    grid = {"mount.stiffness_x": [8.0, 12.0], "load.amplitude": [0.05, 0.1, 0.15]}
    data = sweep(PAPER, grid)
    assert data.amplitude.dims == (*grid, "nu", "dof", "harmonic")
    assert data["mount.stiffness_x"].attrs["units"] == "N/m"
    assert data["load.amplitude"].attrs["units"] == "N"
    scene = vv.Scene.read(PAPER)
    for i, c in enumerate(grid["mount.stiffness_x"]):
        for j, p in enumerate(grid["load.amplitude"]):
            kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
            mount = vv.Mount(
                mass=1, inertia=0.1, offset=0.5, stiffness_x=c, stiffness_phi=2, kernel=kernel
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                alone = vv.forced_response(mount, scene.nu(), load=p, method="successive")
            there = data.coefficients[i, j].values
            # If harmonics are automatic, those up to 9.
            assert np.array_equal(there, alone.coefficients[:, :, :5], equal_nan=True)
            assert (data.outcome[i, j].values == alone.outcome).all()


@pytest.mark.parametrize(
    ("system", "key", "unit"),
    [
        ("mount", "transient.t_end", "s"), ("mount", "transient.nu", "rad/s"),
        ("mount", "transient.initial(4)", "rad/s"), ("mount", "transient.initial(1)", "m"),
        ("mount", "load.amplitude", "N"), ("mount", "mount.inertia", "kg m^2"),
        ("mount", "mount.cubic_scale", ""), ("mount", "kernel.beta", "1/s"),
        ("pendulum", "transient.t_end", "1/omega_1"), ("pendulum", "spectrum.discard", "1/omega_1"),
        ("pendulum", "pendulum.p1", "omega_1"), ("pendulum", "transient.initial(1)", "L"),
        ("pendulum", "pendulum.f0", ""), ("system", "transient.t_end", "s"),
        ("system", "load.amplitude", "N"), ("system", "transient.initial(2)", "m/s"),
        ("angle", "load.amplitude", "N m"), ("other", "load.amplitude", ""),
        ("angle", "backbone.to", "rad"), ("other", "response.nu_to", "rad/s"),
        ("angle", "system.stiffness(4)", "N m"), ("angle", "system.stiffness(2)", "N"),
        ("pendulum", "ensemble.t_end", "1/omega_1"), ("pendulum", "ensemble.discard", ""),
        ("pendulum", "ensemble.from", "omega_1"),
        ("pendulum", "ensemble.initial(4)", "rad omega_1"),
        ("pendulum", "multiple_scales.from", "omega_1"), ("pendulum", "branch.to", ""),
        ("mount", "ensemble.discard", "s"), ("mount", "branch.from", "kg"),
        ("mount", "multiple_scales.to", "rad/s"), ("mount", "response.atol", ""),
        ("beam", "load.amplitude", "N"), ("beam", "load(2).amplitude", "N m"),
        ("beam", "load(2).phase", "rad"), ("beam", "element.stiffness", "N/m"),
        ("beam", "element.damping", "N s/m"), ("beam", "element(2).stiffness", "N m"),
        ("beam", "element(3).stiffness", ""), ("beam", "structure.mass(1)", "kg"),
        ("beam", "structure.stiffness(2)", "N"), ("beam", "structure.damping(4)", "N m s"),
        ("beam", "structure.modal_damping", ""), ("beam", "transient.initial(4)", "rad/s"),
        ("beam", "parameters.k3", ""), ("file", "load.amplitude", "N"),
        ("file", "element.stiffness", "N/m"), ("file", "layer.stiffness(1)", "N/m"),
        ("body", "mount_point(1).stiffness(2)", "N/m"), ("body", "load.amplitude", "N m"),
    ],
)  # fmt: skip
def test_units_are_those_of_the_system(system, key, unit):
    """For a mount in SI, for a pendulum without units, for other systems as declared."""
    groups = {
        "mount": {"mount": {"mass": 1.0}, "load": [{"on": "x"}]},
        "pendulum": {"pendulum": {"e": 0.1}},
        "system": {"system": {"coordinates": ["a", "b"]}, "load": [{"on": "b"}]},
        "angle": {
            "system": {"coordinates": ["a", "b"], "units": ["m", "rad"], "stiffness": 4 * [1.0]},
            "load": [{"on": "b"}],
            "backbone": {"dof": "b"},
        },
        "other": {"system": {"coordinates": "q", "units": "V"}, "load": [{}]},
        "beam": {
            "structure": {
                "mass": [1.0, 0.1], "stiffness": [2.0, 1.0, 1.0, 3.0], "damping": 4 * [0.0],
                "coordinates": ["x1", "x2"], "units": ["m", "rad"],
            },
            "load": [{"on": "x1"}, {"on": "x2"}],
            "element": [{"on": "x1"}, {"on": "x2"}, {"on": ["x1", "x2"]}],
        },
        "file": {
            "structure": {
                "mass": "m.mtx", "stiffness": "k.mtx", "coordinates": ["x3", "x15"],
                "units": ["m", "m"],
            },
            "load": [{"on": "x15"}],
            "element": [{"on": ["x3", "x15"]}], "layer": [{"stiffness": [1.0]}],
        },
        "body": {
            "body": {"mass": 1.0}, "load": [{"on": "ry"}],
            "mount_point": [{"name": "a", "track": [0, 0, 0]}],
        },
    }[system]  # fmt: skip
    if system == "pendulum":
        groups |= {"ensemble": {"vary": "p1", "n_periods": 9}, "branch": {"parameter": "f0"}}
    if system == "mount":
        groups |= {"branch": {"vary": "mass"}}
    if "mount" in groups:
        groups = groups | {"kernel": [{"kind": "rzhanitsyn"}]}
    assert unit_of(groups, key) == unit


def test_motions_over_a_grid_have_units_and_means_over_time():
    data = sweep(MOTION, {"mount.mass": [1.0, 1.1]}, extract="summary")
    assert data.max_x.attrs["units"] == "m"
    assert data.rms_phi.attrs["units"] == "rad"
    run = vv.run(vv.Scene.read(MOTION).override({"mount.mass": 1.1})).value
    late = run.t >= 0.5 * run.t_reached
    fine = np.linspace(run.t[late][0], run.t[-1], 20001)
    x = np.interp(fine, run.t, run.coordinate("x"))
    expected = np.sqrt(np.trapezoid(x**2, fine) / (fine[-1] - fine[0]))
    assert float(data.rms_x[1]) == pytest.approx(expected, rel=1e-2)


def test_numbers_of_every_type_are_taken():
    """Also if a later point has another type than the first."""
    kinds = (float, int, np.float64, np.float32, np.int64, np.array, np.float16, np.uint8, bool)

    def what(a):
        return {"x": kinds[a](a), "word": str(a) if a % 2 else np.str_(a)}

    data = sweep(what, {"a": range(len(kinds))}, chunk=len(kinds), n_threads=1)
    assert data.x.dtype == np.float64
    assert data.x.values.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 1]
    assert data.word.values.tolist() == [str(a) for a in range(len(kinds))]
    with pytest.raises(vv.SweepError, match="at a = 2: InputError: its 'x' is of another kind"):
        sweep(lambda a: {"x": 1j if a == 2 else a}, {"a": [1, 2]}, chunk=2)
    with pytest.raises(vv.SweepError, match="at a = 2: OverflowError"):
        sweep(lambda a: 10**400 if a == 2 else a, {"a": [1, 2]}, chunk=2)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_a_few_numbers_of_each_result():
    grid = {"mount.geometry": ["exact", "printed"], "response.harmonics": np.array([5.0, 9.0])}
    few = sweep(PAPER, grid, extract="summary")
    one = vv.run(
        vv.Scene.read(PAPER).override({"mount.geometry": "printed", "response.harmonics": 9})
    ).response
    at = few.isel({"mount.geometry": 1, "response.harmonics": 1})
    assert at.peak_x == one.peak("x").amplitude
    assert at.nu_peak_phi == one.peak("phi").nu
    own = sweep(PAPER, grid, extract=lambda r: r.response.peak("phi"))
    assert (own.amplitude.values == few.peak_phi.values).all()
    branch = sweep(SCENES / "mount_branch.nml", {"load.amplitude": [0.01, 0.5]}, extract="summary")
    assert branch.folds.values.tolist() == [0, 2]
    grid = {"pendulum.f0": [0, 0.005], "transient.initial(3)": [0.1], "spectrum.discard": [50.0]}
    motion = sweep(SCENES / "pendulum_paper.nml", grid, extract="summary")
    assert (motion.outcome == "completed").all()
    run = vv.run(
        vv.Scene.read(SCENES / "pendulum_paper.nml").override({"transient.initial(3)": 0.1})
    )
    late = run.trajectory.coordinate("phi")[run.trajectory.t >= 1000]
    assert motion.max_phi.values[1, 0, 0] == np.abs(late).max()


def test_many_points_in_one_call():
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c2=0.01)

    def swing(phi, psi):
        states = np.zeros((phi.size, 6))
        states[:, 2], states[:, 4] = phi, psi
        return vv.simulate_ensemble(body, initial=states, t_end=5, dt=0.25, n_threads=1)

    grid = {"phi": np.linspace(-0.5, 0.5, 9), "psi": np.linspace(0, 0.3, 5)}
    data = sweep(swing, grid, vectorized=True, chunk=7)
    assert data.state.dims == ("phi", "psi", "quantity")
    for i, j in ((0, 0), (3, 4), (8, 2)):
        start = (0, 0, grid["phi"][i], 0, grid["psi"][j], 0)
        alone = vv.simulate_ensemble(body, initial=start, t_end=5, dt=0.25)
        assert (data.state[i, j].values == alone.state[0]).all()
    assert (data.state.sel(quantity="phi").shape) == (9, 5)


def test_a_point_that_fails_is_named_or_kept():
    def brittle(a, b):
        if a == 2 and b > 4:
            raise ValueError(f"broken at {a}\nmore")
        return {"y": a * b, "n": int(b), "word": "good"}

    grid = {"a": [1, 2, 3], "b": [4.0, 5.0]}
    text = r"at a = 2, b = 5.0: ValueError: broken at 2$"
    with pytest.raises(vv.SweepError, match=text) as reported:
        sweep(brittle, grid)
    assert reported.value.point == {"a": 2, "b": 5.0}
    assert isinstance(reported.value.__cause__, ValueError)
    for chunk in (1, 4, 6):
        data = sweep(brittle, grid, errors="keep", chunk=chunk)
        bad = data.point_outcome == "failed"
        assert bad.values.tolist() == [[False, False], [False, True], [False, False]]
        assert (data.point_outcome.where(~bad, "completed") == "completed").all()
        assert data.point_error.values[1, 1] == "ValueError: broken at 2"
        assert np.isnan(data.y.values[1, 1])
        assert np.isnan(data.n.values[1, 1])
        assert data.word.values[1, 1] == ""
        assert data.y.values[2, 1] == 15


def test_failures_may_come_first_or_be_all_there_is():
    def late(x):
        if x < 5:
            raise RuntimeError("too early")
        return x

    data = sweep(late, {"x": np.arange(8)}, errors="keep", chunk=2)
    assert np.isnan(data.result[:5]).all()
    assert data.result[5:].values.tolist() == [5, 6, 7]
    nothing = sweep(late, {"x": np.arange(3)}, errors="keep")
    assert (nothing.point_outcome == "failed").all()
    assert list(nothing.data_vars) == ["point_outcome", "point_error"]


def test_a_failure_among_many_points_in_one_call_is_found():
    def root(x):
        if (x < 0).any():
            raise ValueError("negative")
        return np.sqrt(x)

    grid = {"x": np.array([4.0, 1.0, -1.0, 9.0])}
    with pytest.raises(vv.SweepError, match=r"at x = -1.0: ValueError: negative"):
        sweep(root, grid, vectorized=True)
    data = sweep(root, grid, vectorized=True, errors="keep")
    assert np.array_equal(data.result.values, [2, 1, np.nan, 3], equal_nan=True)
    with pytest.raises(vv.SweepError, match=r"must be \(1, \.\.\.\)"):
        sweep(lambda x: 1.0, grid, vectorized=True)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((3, {"x": [1]}), {}, "function_or_scene = 3: must be a function, a scene"),
        ((abs, {}), {}, "grid = {}: must be a mapping"),
        ((abs, {"x": []}), {}, "at least one value"),
        ((abs, {"x": 3}), {}, "got shape"),
        ((abs, {"x": [1.0, np.nan]}), {}, "finite"),
        ((abs, {"x": [object()]}), {}, "real numbers or words"),
        ((lambda x: x, {"y": [1]}), {}, "does not fit the arguments of .*unexpected|missing"),
        ((lambda x: x,), {}, "grid: must be given"),
        ((lambda x: x, {"x": [1]}), {"errors": "ignore"}, "errors = 'ignore'"),
        ((lambda x: x, {"x": [1]}), {"chunk": 0}, "chunk = 0"),
        ((lambda x: x, {"x": [1]}), {"chunk": "big"}, "chunk = 'big'"),
        ((lambda x: x, {"x": [1]}), {"n_threads": 0}, "n_threads = 0"),
        ((lambda x: x, {"x": [1]}), {"retries": -1}, "retries = -1"),
        ((lambda x: x, {"x": [1]}), {"client": 7}, "client = 7: must be"),
        ((lambda x: x, {"x": [1]}), {"extract": "summary"}, "extract: is for scenes"),
        ((lambda x: x, {"x": [1]}), {"checkpoint": 3}, "checkpoint = 3"),
        ((PAPER, {"mount.stiff": [1]}), {}, "&mount has no stiff here"),
        ((PAPER, {"mount.damping": [1]}), {}, "a list of 4"),
        ((PAPER, {"kernel(2).beta": [1]}), {}, "&kernel 1 times"),
        ((PAPER, {"load(0).amplitude": [1]}), {}, "counted from 1"),
        ((PAPER,), {}, "has no &sweep group"),
        ((PAPER, {"mount.mass": [1]}), {"extract": "some"}, "extract = 'some'"),
    ],
)
def test_wrong_input_is_reported_in_a_line(arguments, options, message):
    with pytest.raises(vv.InputError, match=message) as reported:
        sweep(*arguments, **options)
    assert "\n" not in str(reported.value)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: np.zeros(x), r"at x = 2: InputError: its 'result' has shape \(2,\)"),
        (lambda x: {"y": x} if x > 1 else {"z": x}, "the result has y, other points have z"),
        (lambda x: 1j if x > 1 else 1.0, "of another kind"),
        (lambda x: None, "must be numbers, words, arrays or a dict"),
        (lambda x: {}, "is empty"),
        (lambda x: {"x": 1}, "'x' is a parameter of the grid"),
        (lambda x: {"a/b": 1}, "'a/b' is not a name"),
        (lambda x: {"point_error": 1}, "a name that the sweep uses"),
        (lambda x: xr.Dataset(coords={"t": [x]}, data_vars={"y": ("t", [x])}), "coordinate 't'"),
    ],
)
def test_results_that_do_not_fit_are_reported(function, message):
    with pytest.raises(vv.ViscovibError, match=message):
        sweep(function, {"x": [1, 2, 3]}, n_threads=1)


@pytest.mark.parametrize("chunk", [1, 7, "auto"])
def test_the_first_point_sets_the_shape(chunk):
    with pytest.raises(vv.SweepError, match=r"has shape \(1,\), at other points \(2,\)"):
        sweep(
            lambda x: np.zeros(2 if x == 0 else 1), {"x": np.arange(50)}, chunk=chunk, n_threads=1
        )


def test_a_wrong_value_in_a_scene_is_reported_with_its_point():
    with pytest.raises(vv.SweepError, match=r"at mount.mass = -1.0: InputError: mass = -1: must"):
        sweep(PAPER, {"mount.mass": [1.0, -1.0]})


def test_progress_is_shown_unless_it_is_not_wanted(capsys, tmp_path):
    grid = {"x": np.arange(50)}
    vv.sweep(lambda x: x, grid, checkpoint=tmp_path / "c")
    assert "/50 [" in capsys.readouterr().err
    vv.sweep(lambda x: x, grid, progress=False)
    assert capsys.readouterr().err == ""


def test_threads_work_at_once():
    together = threading.Barrier(3, timeout=10)

    def meet(x):
        together.wait()
        return x

    assert sweep(meet, {"x": np.arange(6)}, n_threads=3, chunk=1).result.values.tolist() == [
        0, 1, 2, 3, 4, 5,
    ]  # fmt: skip


def test_no_more_chunks_are_under_way_than_agreed():
    begun, lock = [], threading.Lock()

    def note(x):
        with lock:
            begun.append(x)
        time.sleep(0.002)
        if x == 0:
            raise RuntimeError("stop")
        return x

    with pytest.raises(vv.SweepError):
        sweep(note, {"x": np.arange(1000)}, n_threads=2, chunk=1)
    time.sleep(0.1)
    assert len(begun) < 10
