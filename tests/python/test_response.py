"""Forced response: independent values, symmetry, laws, outcomes and bad input."""

import json
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pytest
import viscovib as vv
from tables import DATA

# Few harmonics are intended here; test_truncation.py tests the warning.
pytestmark = pytest.mark.filterwarnings("ignore:.*estimated relative error")

NU = np.linspace(0.3, 12.0, 60)


def test_linear_response_solves_the_dynamic_stiffness(mount):
    body = mount()
    r = vv.forced_response(body, NU, load={1: [0.3, 0.1j], 4: 0.2}, method="linear")
    assert list(r.harmonics) == [1, 4]
    for order, force in ((1, [0.3, 0.1j]), (4, [0.2, 0.0])):
        expected = np.linalg.solve(body.dynamic_stiffness(order * NU), np.array(force))
        got = np.stack([r.coefficient("x", order), r.coefficient("phi", order)], axis=1)
        assert got == pytest.approx(expected, rel=1e-12)


def test_load_of_order_k_is_the_response_at_k_nu(mount):
    body = mount()
    third = vv.forced_response(body, NU, load={3: 0.2}, method="linear")
    first = vv.forced_response(body, 3 * NU, load=0.2, method="linear")
    assert (third.coefficient("x", 3) == first.coefficient("x", 1)).all()


@pytest.mark.parametrize("geometry", ["cubic", "exact"])
def test_full_set_of_harmonics_agrees_with_half_wave(mount, geometry):
    """A negligible even load switches symmetry off: the odd harmonics must not change."""
    body = mount(geometry=geometry)
    options = {"nu": [0.8, 3.0, 6.0], "harmonics": 9, "tolerance": 1e-13}
    half = vv.forced_response(body, load=0.3, **options)
    full = vv.forced_response(body, load={1: 0.3, 2: 1e-30}, **options)
    assert list(half.harmonics) == [1, 3, 5, 7, 9]
    assert list(full.harmonics) == list(range(10))
    for k in half.harmonics:
        assert full.coefficient("phi", k) == pytest.approx(half.coefficient("phi", k), abs=1e-14)
    assert np.abs(full.coefficients[:, :, ::2]).max() < 1e-16


def test_mean_load_bends_the_relaxed_spring(mount):
    body = mount()
    relaxed = 1 - body.kernel.integral
    r = vv.forced_response(body, 1.0, load={0: 0.01j}, method="linear")
    # Statics: the moment l*P is balanced by the rotational spring only.
    assert r.coefficient("phi", 0)[0].imag == pytest.approx(0.5 * 0.01 / (2 * relaxed), rel=1e-13)


def test_base_motion_far_below_resonance_carries_the_body_along(mount):
    body = mount(kernel=None)
    r = vv.forced_response(body, [1e-4], base=0.3)
    assert r.amplitude("x")[0] == pytest.approx(0.3, rel=1e-6)
    assert r.amplitude("phi")[0] == pytest.approx(0.0, abs=1e-6)


def test_base_motion_is_inertia_force_on_relative_motion(mount):
    body, y = mount(), 0.02 + 0.01j
    moved = vv.forced_response(body, NU, base=y, method="linear")
    forces = np.array(
        [
            vv.forced_response(body, nu, load=nu**2 * y, method="linear").coefficient("x")[0]
            for nu in NU
        ]
    )
    assert moved.coefficient("x") == pytest.approx(forces + y, rel=1e-13)


def test_steady_values_of_independent_programs(mount):
    """Harmonic balance with 34 digits, checked in the time domain to 12 (data/README.md)."""
    reference = json.loads((DATA / "mount_memory_reference.json").read_text())
    for case in reference["harmonic_balance"]:
        with pytest.warns(vv.StabilityWarning) if case["A"] > 0.0779 else nullcontext():
            body = mount(amplitude=case["A"])
        linear = vv.forced_response(body, case["nu"], load=case["P"], method="linear")
        assert linear.amplitude("x")[0] == pytest.approx(case["linear"]["x1"], rel=1e-14)
        assert linear.amplitude("phi")[0] == pytest.approx(case["linear"]["phi1"], rel=1e-14)
        if (case["A"], case["nu"]) == (0.048, 1.5):
            continue  # successive approximations diverge there
        r = vv.forced_response(body, case["nu"], load=case["P"], harmonics=31, tolerance=1e-14)
        for dof in ("x", "phi"):
            for k, value in case[dof].items():
                assert r.amplitude(dof, int(k))[0] == pytest.approx(float(value), rel=2e-13)


def test_iteration_reports_how_it_ended(mount):
    with pytest.warns(vv.ConvergenceWarning, match="diverged"):
        r = vv.forced_response(mount(), np.linspace(1.0, 2.2, 40), load=0.5, method="successive")
    good = r.converged
    assert good.any()
    assert (~good).any()
    assert np.isnan(r.coefficients[~good]).all()
    assert np.isfinite(r.coefficients[good]).all()
    assert (r.rate[good] < 1).all()
    assert (r.rate[r.outcome == "diverged"] > 1).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_plain_call_finds_a_motion_at_every_frequency(seed):
    """Through resonance in both directions; each motion satisfies the equation of motion."""
    rng = np.random.default_rng([48, seed])
    damping, cubic, load = rng.uniform([0.02, 0.1, 0.1], [0.2, 1, 0.5])
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3", base_direction=[1]
    )
    nu = np.linspace(0.5, 2.5, 40)[:: rng.choice([-1, 1])]
    driven = {"load": {1: load}} if seed % 2 else {"base": {1: load, 3: 0.1 * load}}
    r = vv.forced_response(system, nu, **driven)
    assert r.converged.all()
    assert set(r.methods) == {"successive", "newton"}
    assert r.method == "auto"
    phase = 2 * np.pi * np.arange(256) / 256
    for i in range(nu.size):
        waves = np.exp(1j * r.harmonics * phase[:, np.newaxis])
        factors = [
            np.ones(r.harmonics.size),
            1j * nu[i] * r.harmonics,
            -((nu[i] * r.harmonics) ** 2),
        ]
        u, v, a = (np.imag(waves @ (f * r.coefficients[i, 0])) for f in factors)
        moved = driven.get("base", {})
        base = sum(np.imag(w * np.exp(1j * k * phase)) for k, w in moved.items())
        rate = sum(np.imag(1j * k * nu[i] * w * np.exp(1j * k * phase)) for k, w in moved.items())
        force = np.imag(driven.get("load", {1: 0})[1] * np.exp(1j * phase))
        left = a + damping * (v - rate) + (u - base) + cubic * (u - base) ** 3 - force
        assert np.abs(left).max() < 1e-7 * np.abs(a).max()
    alone = vv.forced_response(system, nu, **driven, method="newton")
    same = np.abs(alone.coefficients[:, 0, 0] - r.coefficients[:, 0, 0]) < 1e-8
    assert same[r.methods == "newton"].any()


def test_the_plan_chooses_newton_where_nothing_else_works(mount):
    friction = vv.Structure(
        mass=[1.0],
        stiffness=[1.0],
        damping=[0.1],
        elements=[vv.Jenkins(on="x1", stiffness=1, limit=0.1)],
    )
    assert vv.forced_response(friction, [0.5], load=[0.5], tolerance=1e-5).method == "newton"
    assert vv.forced_response(mount(), [0.5], load=0.1, stability=True).method == "newton"
    assert vv.forced_response(mount(), [0.5], load=0.1).method == "successive"
    assert set(vv.forced_response(mount(), [0.5], load=0.1, method="linear").methods) == {"linear"}


def test_a_lost_frequency_names_the_remedy_as_a_call(mount):
    with pytest.warns(vv.ConvergenceWarning, match=r"use forced_response\(..., method='auto'\)"):
        vv.forced_response(mount(), [1.5], load=5, method="successive")
    stuck = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="0.5*sign(x_dot)")
    with pytest.warns(vv.ConvergenceWarning, match=r"Newton's method .* use trace_response\("):
        vv.forced_response(stuck, [0.5], load=0.4)
    free = vv.PolynomialSystem(mass=1, stiffness=1)
    with pytest.warns(vv.ConvergenceWarning, match="linear response .* add damping to the system"):
        vv.forced_response(free, [1.0], load=1)


def test_corrections_shrink_at_the_reported_rate(mount):
    r = vv.forced_response(mount(), 1.0, load=0.3, tolerance=1e-12)
    history = r.corrections[0]
    assert history.size == r.iterations[0]
    assert history[-1] <= 1e-12 < history[-3]
    assert np.sqrt(history[-1] / history[-3]) == pytest.approx(r.rate[0], rel=1e-12)


def test_relaxation_finds_more_and_agrees(mount):
    nu = np.linspace(1.2, 2.0, 200)
    body = mount(amplitude=0.02)
    with pytest.warns(vv.ConvergenceWarning):
        plain = vv.forced_response(body, nu, load=0.1, method="successive")
    with pytest.warns(vv.ConvergenceWarning):
        relaxed = vv.forced_response(body, nu, load=0.1, method="successive", relaxation="auto")
    both = plain.converged
    assert relaxed.converged.sum() > both.sum()
    assert relaxed.coefficients[both] == pytest.approx(plain.coefficients[both], abs=1e-11)


def test_a_point_does_not_depend_on_its_company(mount):
    """Frequencies share vector registers; results must not depend on this."""
    body = mount(geometry="exact")
    together = vv.forced_response(body, NU, load=0.05)
    for i in (0, 1, 17, 59):
        alone = vv.forced_response(body, NU[i], load=0.05)
        assert (alone.coefficients[0] == together.coefficients[i]).all()
        assert alone.iterations[0] == together.iterations[i]


def test_nothing_nonlinear_runs_no_iteration(mount):
    body = mount(cubic_scale=0.0)
    r = vv.forced_response(body, NU, load=0.5)
    linear = vv.forced_response(body, NU, load=0.5, method="linear")
    assert r.method == "linear"
    assert not r.iterations.any()
    assert (r.coefficients == linear.coefficients).all()


def test_undamped_resonance_is_singular_not_a_number():
    body = vv.Mount(mass=1, inertia=1, offset=0, stiffness_x=4, stiffness_phi=9)
    with pytest.warns(vv.ConvergenceWarning, match="singular"):
        r = vv.forced_response(body, [1.0, 2.0], load=1.0, method="linear")
    assert list(r.outcome) == ["converged", "singular"]
    assert np.isnan(r.coefficients[1]).all()


def test_waveform_repeats_the_series(mount):
    r = vv.forced_response(mount(), [1.0, 3.0], load={1: 0.2, 2: 0.1, 0: 0.05j})
    _t, u = r.waveform(0, 64)
    series = vv.fourier_coefficients(u[:, 1], 9)
    for k, value in series.items():
        assert value == pytest.approx(r.coefficient("phi", k)[0], abs=1e-15)


def test_peak_is_refined_and_says_if_enclosed(mount):
    fine = vv.forced_response(mount(), np.linspace(1.3, 1.6, 3001), load=0.1, method="linear")
    coarse = vv.forced_response(mount(), np.linspace(1.3, 1.6, 101), load=0.1, method="linear")
    assert coarse.peak("x").nu == pytest.approx(fine.peak("x").nu, abs=1e-4)
    assert coarse.peak("x").amplitude == pytest.approx(fine.peak("x").amplitude, rel=1e-6)
    assert coarse.peak("x").enclosed
    assert not coarse.peak("x", band=(1.3, 1.4)).enclosed


def test_dataset_and_csv_hold_the_same_numbers(mount, tmp_path):
    r = vv.forced_response(mount(), NU[:5], load=0.1)
    data = r.to_dataset()
    assert (data.amplitude.sel(dof="phi", harmonic=3).values == r.amplitude("phi", 3)).all()
    r.to_csv(tmp_path / "table.csv")
    lines = (tmp_path / "table.csv").read_text().splitlines()
    planned = str(r.plan).splitlines()
    assert [line.removeprefix("# ") for line in lines[1 : len(planned) + 1]] == planned
    lines = [line for line in lines if not line.startswith("#")]
    table = np.genfromtxt(lines, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert (table["x_1_re"] == r.coefficient("x").real).all()
    with pytest.raises(vv.FileError, match="cannot be written"):
        r.to_csv(tmp_path / "nowhere" / "table.csv")
    (tmp_path / "folder").mkdir()
    with pytest.raises(vv.FileError, match="cannot be written"):
        r.to_csv(tmp_path / "folder")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "table.csv"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"nu": []}, "nu: must not be empty"),
        ({"nu": [1.0, 0.0]}, "nu = 0: must be greater than 0"),
        ({"nu": [1.0, -2.0]}, "nu = -2: must be greater than 0"),
        ({"nu": [1.0, np.nan]}, "nu[1] = nan: must be a finite number"),
        ({"nu": [[1.0]]}, "nu: must have 0 or 1 dimension(s)"),
        ({"nu": "fast"}, "nu = 'fast': must be numbers"),
        ({"nu": [1.0, [2.0, 3.0]]}, "nu = [1.0, [2.0, 3.0]]: must be an array of numbers"),
        ({"load": np.inf}, "load = inf: must be a finite number"),
        ({"load": [1.0, 2.0, 3.0]}, "load: must be a number or have shape (2,)"),
        ({"load": {0: 1.0}}, "load[0] has a real part"),
        ({"load": {-1: 1.0}}, "load order = -1"),
        ({"load": {1.5: 1.0}}, "load order = 1.5: must be an integer"),
        ({"load": {11: 1.0}, "harmonics": 9}, "harmonics = 9: must be at least 11"),
        ({"base": [1.0, 2.0]}, "base: has a motion for each coordinate, must be along one"),
        ({"harmonics": "many"}, "harmonics = 'many': must be an integer or 'auto'"),
        ({"method": "newtonian"}, "method = 'newtonian': must be one of"),
        ({"harmonics": 0}, "harmonics = 0: must be 1 to 399"),
        ({"harmonics": 9.5}, "harmonics = 9.5: must be an integer"),
        ({"tolerance": 0.0}, "tolerance = 0: must be in [1e-14, 0.1]"),
        ({"tolerance": np.nan}, "tolerance = nan: must be a finite number"),
        ({"max_iterations": 0}, "max_iterations = 0: must be 1 to 100000"),
        ({"relaxation": 0.0}, "relaxation = 0: must be in (0, 1], or 'auto'"),
        ({"relaxation": 1.5}, "relaxation = 1.5: must be in (0, 1], or 'auto'"),
    ],
)
def test_bad_arguments_are_named(mount, arguments, text):
    call = {"nu": [1.0], "load": 0.1} | arguments
    with pytest.raises(vv.InputError) as error:
        vv.forced_response(mount(), call.pop("nu"), **call)
    assert text in str(error.value)
    assert isinstance(error.value, ValueError)


def test_not_a_mount_is_named():
    with pytest.raises(vv.InputError, match="must be a Mount"):
        vv.forced_response("mount", [1.0])


def test_a_load_must_be_given_though_it_may_be_0(mount):
    """A missing load must not give converged motions of 0."""
    for follow in (lambda: vv.forced_response(mount(), [1.0]),
                   lambda: vv.plan_response(mount(), [1.0]),
                   lambda: vv.trace_response(mount(), (1, 2))):  # fmt: skip
        with pytest.raises(vv.InputError, match="load or base: must be given"):
            follow()
    r = vv.forced_response(mount(), [1.0], load=0)
    assert r.converged.all()
    assert (r.coefficients == 0).all()


@pytest.mark.parametrize("load", [1e150, 1e200, 1e307])
def test_what_leaves_the_range_of_numbers_is_an_overflow(mount, load):
    """The outcome must not depend on the treatment of NaN by the compiler."""
    with pytest.warns(vv.ConvergenceWarning, match="overflow"):
        r = vv.forced_response(mount(), [0.7, 1.5, 3.0], load=load, method="successive")
    assert list(r.outcome) == ["overflow"] * 3
    assert np.isnan(r.rate).all()


@pytest.mark.parametrize("load", [1e-300, 1e100, 1e300])
def test_absurd_loads_end_cleanly(mount, load):
    with np.errstate(all="ignore"):
        if load > 1:
            with pytest.warns(vv.ConvergenceWarning):
                r = vv.forced_response(mount(), [1.0, 7.0], load=load)
            assert not r.converged.any()
        else:
            r = vv.forced_response(mount(), [1.0, 7.0], load=load)
            assert r.amplitude("x")[0] == pytest.approx(
                load * vv.forced_response(mount(), 1.0, load=1.0, method="linear").amplitude("x")[0]
            )


def test_threads_run_at_once_and_agree(mount):
    body, nu = mount(geometry="exact"), np.linspace(0.3, 12.0, 2000)
    alone = vv.forced_response(body, nu, load=0.05).coefficients
    with ThreadPoolExecutor(4) as pool:
        for r in pool.map(lambda _: vv.forced_response(body, nu, load=0.05), range(16)):
            assert (r.coefficients == alone).all()


def test_many_frequencies_in_pieces(mount):
    nu = np.linspace(0.3, 12.0, 10_001)
    r = vv.forced_response(mount(), nu, load=0.05)
    some = vv.forced_response(mount(), nu[::1000], load=0.05)
    assert (r.coefficients[::1000] == some.coefficients).all()
    assert r.corrections.shape == (nu.size, r.iterations.max())


def test_a_hundred_harmonics(mount):
    r = vv.forced_response(mount(), 1.0, load={1: 0.1, 2: 0.01}, harmonics=199)
    few = vv.forced_response(mount(), 1.0, load={1: 0.1, 2: 0.01}, harmonics=20)
    assert r.coefficients.shape == (1, 2, 200)
    assert r.coefficients[:, :, :10] == pytest.approx(few.coefficients[:, :, :10], abs=1e-14)


def test_absurd_parameters_never_give_a_wrong_number():
    """Random extremes: every point has a named outcome, and converged points are finite."""
    rng = np.random.default_rng(11)
    sizes = [1e-270, 1e-150, 1e-30, 1e-8, 1.0, 1e8, 1e30, 1e150, 1e300]

    def pick(*more):
        return float(rng.choice([*more, *sizes]))

    seen = set()
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for _ in range(200):
            geometry = str(rng.choice(["exact", "cubic", "printed"]))
            kernel = vv.PronyKernel(weights=[pick(0.0)], rates=[pick()])
            body = vv.Mount(
                mass=pick(), inertia=pick(), offset=pick(0.0), stiffness_x=pick(),
                stiffness_phi=pick(), kernel=kernel, geometry=geometry,
            )  # fmt: skip
            load = {1: pick(0.0), 2: pick(0.0, 0.0)}
            if not np.isfinite(kernel.integral):
                del load[2]
            r = vv.forced_response(body, [pick(), pick()], load=load)
            assert np.isfinite(r.coefficients[r.converged]).all()
            assert np.isnan(r.coefficients[~r.converged]).all()
            seen.update(r.outcome)
    assert {"converged", "diverged", "overflow", "singular"} <= seen


@pytest.mark.parametrize(("method", "forces"), [("linear", None), ("newton", "x^3")])
@pytest.mark.parametrize("load", [0, {0: 0.3j}, {0: 0.3j, 1: 0.1}])
def test_rest_and_a_mean_alone_tell_their_error(method, forces, load):
    body = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=forces)
    r = vv.forced_response(body, [0.62, 0.7], load=load, method=method)
    assert r.converged.all()
    assert (r.error < 1e-9).all()
    assert (r.error == 0).all() or load != 0
    assert (r.to_dataset().error == r.error).all()


@pytest.mark.parametrize(
    ("elements", "method"), [([], "linear"), ([vv.Spring(on="x2", law="d^3")], "newton")]
)
def test_a_structure_under_no_load_is_at_rest(elements, method):
    """Its linear response has no harmonics."""
    pair = vv.Structure(
        mass=[1, 1], stiffness=[[2, -1], [-1, 2]], damping=[0.1, 0.1], elements=elements
    )
    r = vv.forced_response(pair, [0.7, 1.3], load=0, method=method)
    assert r.complete
    assert r.coefficients.shape == (2, 2, r.harmonics.size)
    assert r.to_dataset().sizes["nu"] == 2


@pytest.mark.parametrize("method", ["successive", "newton", "auto"])
def test_amplitudes_out_of_range_are_no_divergence(method):
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="3e-101*x^3")
    with pytest.warns(vv.ConvergenceWarning, match="choose other units"):
        found = vv.forced_response(system, [0.5, 0.8], load=1e49, method=method)
    assert found.outcome.tolist() == ["overflow"] * 2


@pytest.mark.parametrize("seed", range(3))
def test_iterates_are_those_of_the_formula(mount, seed):
    """D(k nu) X_k' = P_k + (1 - R(k nu)) N_k(X), equations (18), (19), by NumPy."""
    rng = np.random.default_rng([48, seed])
    body = mount(amplitude=rng.uniform(0.01, 0.05))
    nu, force = rng.uniform([2.2, 0.05], [3.5, 0.2])
    base = 0.02 if seed == 2 else 0.0
    driven = {"base": {1: base}} if base else {"load": {1: force}}
    r = vv.forced_response(body, [nu], **driven, harmonics=7)
    k = r.harmonics
    phase = 2 * np.pi * np.arange(128) / 128
    waves = np.exp(1j * k * phase[:, np.newaxis])
    c, arm = 10.0, 0.5
    inverse = [np.linalg.inv(body.dynamic_stiffness(order * nu)) for order in k]
    kept = [1 - body.kernel.transform(order * nu) for order in k]
    moved = np.zeros((2, k.size), dtype=complex)
    moved[0, 0] = base
    load = np.zeros((2, k.size), dtype=complex)
    load[0, 0] = 0.0 if base else force
    if base:
        load[:, 0] = nu**2 * base * np.array([body.mass, 0.0])
    x = np.stack([inverse[j] @ load[:, j] for j in range(k.size)], axis=1)
    assert r.iterates.shape == (r.iterations[0] + 1, 1, 2, k.size)
    for found in r.iterates[:, 0]:
        assert found == pytest.approx(x + moved, rel=1e-9, abs=1e-13)
        u, phi = np.imag(waves @ x.T).T
        forces = [-c * arm / 6 * phi**3, -c * arm / 2 * phi**2 * u + 2 / 3 * c * arm**2 * phi**3]
        n = np.array([2j * (f @ waves.conj()) / phase.size for f in forces])
        x = np.stack([inverse[j] @ (load[:, j] + kept[j] * n[:, j]) for j in range(k.size)], 1)
    assert r.iterates[-1] == pytest.approx(r.coefficients, rel=1e-12)


def test_iterates_of_other_methods(mount):
    linear = vv.forced_response(mount(), [2.5], load=0.1, method="linear")
    assert (linear.iterates == linear.coefficients).all()
    both = vv.forced_response(mount(), [1.5, 3.0], load=0.5)
    assert list(both.methods) == ["newton", "successive"]
    last = both.iterates[both.iterations[1], 1]
    assert last[:, :1] == pytest.approx(both.coefficients[1, :, :1], rel=1e-9)
