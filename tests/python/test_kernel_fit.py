"""Fits: recovered parameters, coverage of intervals, undetermined parameters."""

import json
import warnings
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
import scipy.stats
import viscovib as vv
from rubber_examples import KERNELS, MODULUS, made, truth
from viscovib.rubber.models import Model, ramped

DATA = Path(__file__).parents[2] / "data" / "rubber"
KINDS = ("rabotnov", "rzhanitsyn", "abel")


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_come_back(kind):
    fit = vv.fit_kernel(made(KERNELS[kind]), kind=kind)
    for name, value in truth(KERNELS[kind]).items():
        assert fit.parameters[name] == pytest.approx(value, rel=1e-8)
    assert type(fit.kernel) is type(KERNELS[kind])
    assert fit.residual[0] < 1e-10
    assert fit.weights == "model"


def test_a_fractional_zener_element_is_a_rabotnov_kernel():
    """M = (M_e + M_0 (i w tau)^a)/(1 + (i w tau)^a)."""
    tau, alpha, relaxed = 0.02, 0.55, 3e5
    nu = np.geomspace(1e-2, 1e5, 60)
    power = (1j * nu * tau) ** alpha
    stiff = (relaxed + MODULUS * power) / (1 + power)
    data = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=stiff.imag)
    fit = vv.fit_kernel(data, kind="fractional_zener")
    (element,) = fit.zener
    assert element["relaxed"] == pytest.approx(relaxed, rel=1e-9)
    assert element["tau"] == pytest.approx(tau, rel=1e-9)
    assert element["alpha"] == pytest.approx(alpha, rel=1e-9)
    assert fit.predict(nu) == pytest.approx(stiff, rel=1e-9)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("kind", ["rabotnov", "rzhanitsyn"])
def test_relaxation_and_ramp(kind):
    true, t = KERNELS[kind], np.geomspace(1e-3, 1e3, 30)
    step = vv.RelaxationData(times=t, modulus=MODULUS * true.relaxation(t))
    fit = vv.fit_kernel(step, kind=kind)
    assert [fit.parameters[n] for n in truth(true)] == pytest.approx(
        list(truth(true).values()), rel=1e-7
    )
    # The force after a ramp is the mean over ages, by an independent rule.
    ramp, late = 0.5, t + 0.5
    ages = np.concatenate([[0], np.geomspace(1e-10, 1, 4001)])
    force = []
    for one in late:
        age = one - ramp + ramp * ages
        middle = (age[1:] + age[:-1]) / 2
        force.append(float(np.sum(true.relaxation(middle) * np.diff(ages))))
    data = vv.RelaxationData(times=late, modulus=MODULUS * np.array(force), ramp=ramp)
    fit = vv.fit_kernel(data, kind=kind)
    assert fit.modulus == pytest.approx(MODULUS, rel=1e-4)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_a_ramp_taken_as_a_step_is_reported():
    true, late = KERNELS["rzhanitsyn"], np.geomspace(1e-3, 1e3, 50) + 1.0
    force = MODULUS * ramped(true, late, 1.0)
    with pytest.warns(vv.ConvergenceWarning, match="a ramp treated as a step"):
        fit = vv.fit_kernel(vv.RelaxationData(times=late, modulus=force), kind="rzhanitsyn")
    assert fit.modulus > 2 * MODULUS
    assert fit.residual[0] < 0.003


def test_creep():
    """1/(s (s^a + b - A)): creep of a Rabotnov material is the relaxation of another one."""
    t = np.geomspace(1e-3, 1e3, 40)
    passed = 1 - vv.RabotnovKernel(amplitude=2.0, alpha=0.5, beta=1.0).relaxation(t)
    fit = vv.fit_kernel(vv.CreepData(times=t, compliance=(1 + passed) / MODULUS))
    assert list(fit.parameters.values()) == pytest.approx([MODULUS, 2.0, 0.5, 3.0], rel=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_slopes_of_creep_are_those_of_differences(seed):
    from viscovib.rubber.measured import Measured
    from viscovib.rubber.models import Model

    rng = np.random.default_rng(seed)
    model = Model((("rabotnov",), ("rzhanitsyn",), ("rabotnov", "rzhanitsyn"))[seed % 3])
    k = len(model.parts)
    theta = model.join(2.0, rng.uniform(0.1, 0.9, k), 10 ** rng.uniform(-1, 2, k), np.full(k, 0.3))
    t = np.sort(10 ** rng.uniform(-2, 3, 700))
    data = vv.CreepData(times=t, compliance=model.compliance(t, theta))
    slopes = Measured.of(data, (1, 1)).slopes(model, theta)
    for j in range(theta.size):
        step = 1e-5 * np.eye(theta.size)[j]
        by = (model.compliance(t, theta + step) - model.compliance(t, theta - step)) / 2e-5
        assert slopes[:, j] == pytest.approx(by, abs=1e-8)


def test_creep_by_inversion_in_many_digits():
    model = Model(("rzhanitsyn",))
    theta = model.join(1.0, np.array([0.3]), np.array([20.0]), np.array([0.7]))
    p, a, tau = mp.mpf("0.7"), mp.mpf("0.3"), mp.mpf(20)
    for t in (0.1, 3.0, 200.0):
        exact = mp.invertlaplace(
            lambda s: 1 / (s * (1 - p * (1 + s * tau) ** -a)), t, method="talbot"
        )
        assert model.compliance(np.array([t]), theta)[0] == pytest.approx(float(exact), rel=1e-8)


def test_a_parameter_out_of_range_is_reported_and_not_returned():
    """The kernel decays four decades below the data."""
    data = made(KERNELS["rzhanitsyn"], 0.01, n=40, low=3e2, high=3e4)
    with pytest.warns(vv.ConvergenceWarning, match=r"do not constrain .*beta"):
        fit = vv.fit_kernel(data, kind="rzhanitsyn")
    assert "beta" in fit.unconstrained
    assert np.isnan(fit.parameters["beta"])
    assert "beta: not constrained" in repr(fit)


def test_profile_and_linear_interval_agree_where_the_fit_is_quadratic():
    fit = vv.fit_kernel(made(KERNELS["rabotnov"], 0.01, 3), kind="rabotnov")
    for name in fit.names:
        low, high = fit.interval[name]
        profile = fit.profile(name)
        assert profile.interval == pytest.approx((low, high), abs=0.1 * (high - low))
        assert (profile.rise >= -1e-6).all()


def test_what_range_constrains_what():
    fit = vv.fit_kernel(made(KERNELS["rzhanitsyn"], 0.01, 3), kind="rzhanitsyn")
    edges, growth = fit.constraints()
    assert growth.shape == (edges.size - 1, 4)
    assert (growth > 0.999).all()
    # beta = 0.05: its decade and the neighbouring decades determine it.
    best = int(growth[:, fit.names.index("beta")].argmax())
    assert 1e-3 <= edges[best] <= 0.1
    assert np.abs(np.diag(fit.correlation) - 1).max() < 1e-12


def test_a_given_modulus_is_kept():
    data = made(KERNELS["rabotnov"])
    fit = vv.fit_kernel(data, modulus=MODULUS)
    assert fit.modulus == MODULUS
    assert "modulus" not in fit.parameters
    assert fit.parameters["alpha"] == pytest.approx(0.5, rel=1e-9)
    with pytest.raises(vv.InputError, match="below the largest one measured"):
        vv.fit_kernel(data, modulus=1e6)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_integrals_stay_below_1_unless_allowed():
    data = made(vv.RzhanitsynKernel(amplitude=0.06, alpha=0.1, beta=1e-3), low=0.1)
    assert vv.fit_kernel(data, kind="rzhanitsyn").kernel.integral < 1
    free = vv.fit_kernel(data, kind="rzhanitsyn", allow_creep=True)
    assert free.kernel.integral > 1
    assert free.parameters["alpha"] == pytest.approx(0.1, rel=1e-7)


class TestProny:
    """Non-negative weights."""

    master = vv.read_dma(DATA / "pyvisco_freq_user_master.csv")

    @staticmethod
    def weighted(fit):
        return fit.residual[0] ** 2 + fit.residual[1] ** 2

    def test_the_best_there_is_of_data_that_contradict_themselves(self):
        """Minimum residuals of another program: 20.3 and 13.2 % with equal weights."""
        fit = vv.fit_kernel(self.master, kind="prony")
        assert self.weighted(fit) < 1.01 * (0.2036**2 + 0.1323**2)
        storage = vv.fit_kernel(self.master, kind="prony", loss_weight=0.0, terms=53)
        assert storage.residual[0] < 0.0143
        assert storage.residual[1] > 0.5

    def test_loss_alone_tells_no_modulus(self):
        with pytest.warns(vv.ConvergenceWarning, match="loss alone determines neither"):
            fit = vv.fit_kernel(self.master, kind="prony", storage_weight=0.0)
        assert fit.residual[1] < 0.03

    def test_two_zener_elements_are_as_close_as_they_can_be(self):
        fit = vv.fit_kernel(self.master, kind=["fractional_zener"] * 2)
        assert fit.residual == pytest.approx((0.2164, 0.1825), abs=0.002)
        assert fit.optima[0].cost <= min(one.cost for one in fit.optima)

    def test_terms_on_the_grid_come_back(self):
        grid = np.geomspace(1e-4, 1e2, 7)
        true = vv.PronyKernel(weights=0.1 / grid, rates=1 / grid)
        nu = np.geomspace(1e-2, 1e4, 60)
        stiff = MODULUS * (1 - true.transform(nu))
        data = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=stiff.imag)
        fit = vv.fit_kernel(data, kind="prony", terms=7)
        assert fit.times == pytest.approx(grid[::-1], rel=1e-12)
        assert fit.moduli == pytest.approx(0.1 * MODULUS, rel=1e-8)
        assert fit.relaxed == pytest.approx(0.3 * MODULUS, rel=1e-8)

    def test_noise_does_not_buy_terms(self):
        data = made(KERNELS["rabotnov"], 0.02)
        fit = vv.fit_kernel(data, kind="prony")
        assert fit.times.size < 20
        assert fit.residual[0] < 0.03
        low, high = fit.interval["modulus"]
        assert low < fit.modulus < high

    def test_the_l_curve_smooths_the_spectrum(self):
        data = made(KERNELS["rabotnov"], 0.02)
        rough = vv.fit_kernel(data, kind="prony", terms=40)
        smooth = vv.fit_kernel(data, kind="prony", terms=40, smooth="L-curve")
        bends = [np.abs(np.diff(fit.found[1:], 2)).sum() for fit in (rough, smooth)]
        assert bends[1] < 0.3 * bends[0]
        assert smooth.residual[0] < 1.5 * rough.residual[0] + 0.01

    def test_over_time(self):
        t = np.geomspace(1e-2, 1e2, 40)
        true = vv.PronyKernel(weights=[2.0, 0.03], rates=[10.0, 0.1])
        data = vv.RelaxationData(times=t, modulus=MODULUS * true.relaxation(t))
        fit = vv.fit_kernel(data, kind="prony")
        assert fit.residual[0] < 5e-3


class TestDoubts:
    """Data that no single kernel fits are refused, or cause a warning."""

    def test_a_misfit_names_prony(self):
        """Random materials with several transitions, fitted by one kernel, with noise of 1 %."""
        for seed in range(2):
            rng = np.random.default_rng(seed)
            nu = np.geomspace(1e-3, 1e5, 50)
            rates = 10 ** np.array([-2.0, 0.5, 4.0])
            weights = rates * np.array([0.3, 0.4, 0.29]) * rng.uniform(0.9, 1, 3)
            stiff = MODULUS * (1 - vv.PronyKernel(weights=weights, rates=rates).transform(nu))
            noise = 1 + 0.01 * rng.standard_normal((2, nu.size))
            data = vv.ModulusData(
                frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
            )
            with warnings.catch_warnings(record=True) as given:
                warnings.simplefilter("always")
                fit = vv.fit_kernel(data)
            assert "far above the scatter of the data: with kind='prony'" in str(
                [one.message for one in given]
            )
            assert max(fit.residual) > 0.1
            assert max(vv.fit_kernel(data, kind="prony").residual) < 0.1

    def test_several_temperatures_are_refused(self):
        raw = vv.read_dma(DATA / "pyvisco_freq_user_raw.csv")
        with pytest.raises(vv.InputError, match=r"has 21 sets at .* take a master curve"):
            vv.fit_kernel(raw)

    def test_rows_out_of_order_are_not_sets(self):
        data = made(KERNELS["rabotnov"])
        order = np.roll(np.arange(data.frequencies.size), 9)
        columns = {k: getattr(data, k)[order] for k in ("frequencies", "storage", "loss")}
        with pytest.warns(vv.ConvergenceWarning, match="is read as 2 sets.*sort its rows"):
            vv.fit_kernel(vv.ModulusData(**columns))

    def test_storage_and_loss_exchanged(self):
        data = made(KERNELS["rabotnov"])
        swapped = vv.ModulusData(frequencies=data.frequencies, storage=data.loss, loss=data.storage)
        with warnings.catch_warnings(record=True) as given:
            warnings.simplefilter("always")
            vv.fit_kernel(swapped)
        assert "storage and loss exchanged" in str([one.message for one in given])


class TestPropagate:
    """Propagation of the uncertainty of the fit."""

    def test_a_band_holds_what_the_delta_method_says(self):
        fit = vv.fit_kernel(made(KERNELS["rabotnov"], 0.02, 5), kind="rabotnov")
        band = vv.propagate(fit, lambda s: s.modulus, samples=2000)
        low, high = fit.interval["modulus"]
        assert (band.low, band.high) == pytest.approx((low, high), abs=0.08 * (high - low))
        assert band.nominal == fit.modulus
        assert band.missing == 0

    def test_samples_are_as_likely_as_the_data_make_them(self):
        """The sum of squares of samples is chi-squared distributed, and bands have their coverage.

        For windows with poorly determined parameters, and for integrals at their bound.
        """
        nu = np.geomspace(10, 1e3, 25)
        for seed, amplitude in enumerate((50.0, 50.499)):
            true = vv.RabotnovKernel(amplitude=amplitude, alpha=0.3, beta=50.5)
            stiff = MODULUS * (1 - true.transform(nu))
            noise = 1 + 0.02 * np.random.default_rng(seed).standard_normal((2, nu.size))
            data = vv.ModulusData(
                frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", vv.ConvergenceWarning)
                fit = vv.fit_kernel(data)

            assert fit.weights == "model"
            with warnings.catch_warnings(record=True) as given:
                warnings.simplefilter("always")
                band = vv.propagate(
                    fit,
                    lambda s: (s.modulus * (1 - s.kernel.transform(nu))).view(float),
                    samples=300,
                )
            warned = "ends of the band are uncertain: the data do not constrain" in str(given)
            assert warned == bool(fit.unconstrained)
            target = (np.asarray(data.storage) + 1j * np.asarray(data.loss)).view(float)
            off = np.vstack([band.nominal, band.answers]) - target
            squares = ((off / band.nominal) ** 2).sum(axis=1)
            rises = (squares[1:] / squares[0] - 1) * (2 * nu.size - 4)
            middle, high = scipy.stats.chi2(4).ppf([0.5, 0.95])
            assert np.median(rises) == pytest.approx(middle, rel=0.35)
            assert np.quantile(rises, 0.95) == pytest.approx(high, rel=0.4)
            assert 10 < band.effective < 300
            assert "of the parameters only" in repr(band)
            # The mean of 50 measured moduli with 2 % noise each.
            assert ((band.high - band.low) / band.nominal).max() < 0.05

    def test_missing_answers_are_counted(self):
        fit = vv.fit_kernel(made(KERNELS["rabotnov"], 0.02, 5))
        band = vv.propagate(
            fit, lambda s: [1.0, np.nan if s.modulus > fit.modulus else 2.0], samples=50
        )
        assert band.missing[0] == 0
        assert 10 < band.missing[1] < 40
        assert band.low[1] == band.high[1] == 2.0
        with pytest.raises(vv.InputError, match="must be one shape"):
            vv.propagate(fit, lambda s: np.zeros(2 if s.modulus > fit.modulus else 3), samples=50)
        with pytest.raises(vv.InputError, match="function = <built-in function len>: object of"):
            vv.propagate(fit, len, samples=50)
        with pytest.raises(
            vv.InputError, match="function: returned None, must return real numbers"
        ):
            vv.propagate(fit, lambda s: None, samples=5)
        assert "at most nan % wide" in repr(vv.propagate(fit, lambda s: np.nan, samples=5))

    def test_two_rows_constrain_nothing(self):
        """Without a NumPy warning about infinite covariances."""
        data = vv.ModulusData(frequencies=[1, 2], storage=[1, 1.1], loss=[0.1, 0.1])
        with pytest.warns(vv.ConvergenceWarning) as reported:
            fit = vv.fit_kernel(data, kind="rabotnov")
        assert "do not constrain" in str([one.message for one in reported])
        assert {one.category for one in reported} == {vv.ConvergenceWarning}
        assert np.isnan(fit.parameters["alpha"])


class TestPronyTerms:
    """Export to other programs."""

    kernel = KERNELS["rabotnov"]

    @pytest.mark.parametrize("tolerance", [0.1, 0.01, 1e-3])
    def test_the_error_is_what_it_says(self, tolerance):
        terms = vv.prony_terms(self.kernel, modulus=2e6, t_min=1e-4, t_max=1e2, tolerance=tolerance)
        nu = np.geomspace(1e-2, 1e4, 997)
        close = terms.modulus * (1 - terms.kernel.transform(nu))
        exact = 2e6 * (1 - self.kernel.transform(nu))
        worst = np.abs(close / exact - 1).max()
        assert worst <= 1.05 * terms.error
        assert terms.error <= tolerance
        assert (terms.moduli > 0).all()
        assert terms.relaxed > 0

    def test_texts_hold_the_terms(self):
        terms = vv.prony_terms(self.kernel, modulus=2e6, t_min=1e-4, t_max=1e2)
        shares = np.column_stack([terms.moduli / terms.modulus, terms.times])
        lines = terms.text("abaqus").split("\n")
        at = lines.index("*VISCOELASTIC, TIME=PRONY") + 1
        rows = np.array([line.split(",") for line in lines[at:] if line], dtype=float)
        assert rows[:, [0, 2]] == pytest.approx(shares, rel=1e-8)
        assert float(lines[at - 2].split(",")[0]) == pytest.approx(terms.modulus, rel=1e-8)
        ansys = [line for line in terms.text("ansys").split("\n") if line.startswith("TBDATA")]
        flat = np.concatenate([np.array(line.split(",")[2:], dtype=float) for line in ansys])
        assert flat == pytest.approx(shares.ravel(), rel=1e-8)
        assert f"TB,PRONY,1,1,{terms.times.size},SHEAR" in terms.text("ansys")
        dyna = terms.text("ls-dyna", poisson=0.45).split("\n")
        at = dyna.index("*END")
        cards = dyna[4:at]
        rows = np.array([[float(one[:10]), float(one[10:])] for one in cards])
        shear = np.concatenate([[terms.relaxed], terms.moduli]) / 2.9
        assert rows[:, 0] == pytest.approx(shear, rel=1e-3)
        assert rows[1:, 1] == pytest.approx(1 / terms.times, rel=1e-3)

    @pytest.mark.parametrize("quantity", ["E", "G"])
    @pytest.mark.parametrize("poisson", [0.3, 0.49])
    def test_programs_are_given_the_shear_modulus_that_was_measured(self, quantity, poisson):
        """The relaxation of each text is that of the data; for E divided by 2 (1 + poisson)."""
        t = np.geomspace(1e-3, 10, 40)
        modulus = 2e6 * self.kernel.relaxation(t)
        shear = modulus / (1 if quantity == "G" else 2 * (1 + poisson))
        data = vv.RelaxationData(times=t, modulus=modulus, quantity=quantity)
        terms = vv.prony_terms(vv.fit_kernel(data), t_min=1e-3, t_max=10, tolerance=5e-3)
        assert terms.quantity == quantity
        decays = np.exp(-t[:, np.newaxis] / terms.times)
        for program, key in (("abaqus", "MODULI=INSTANTANEOUS\n"), ("ansys", "MP,EX,1,")):
            after = terms.text(program, poisson=poisson).split(key)[1]
            young = float(after.split("\n")[0].split(",")[0])
            shares = terms.moduli / terms.modulus
            reported = young / (2 * (1 + poisson)) * (1 - (shares * (1 - decays)).sum(axis=1))
            assert reported == pytest.approx(shear, rel=0.02)
        cards = terms.text("ls-dyna", poisson=poisson).split("*END")[0].split("\n")[4:-1]
        moduli = np.array([float(card[:10]) for card in cards])
        assert moduli[0] + decays @ moduli[1:] == pytest.approx(shear, rel=0.02)

    def test_a_stiffness_is_no_material(self):
        terms = vv.prony_terms(self.kernel, modulus=2e5, t_min=1e-4, t_max=1e2, quantity="K")
        with pytest.raises(vv.InputError, match="of a stiffness"):
            terms.text("abaqus")

    def test_what_cannot_be_met_is_reported(self):
        with pytest.raises(vv.InputError, match="at most 17 for"):
            vv.prony_terms(self.kernel, modulus=2e6, t_min=1e-8, t_max=1e6, tolerance=1e-3).text(
                "ls-dyna"
            )
        with pytest.raises(vv.InputError, match="modulus: must be given with a kernel"):
            vv.prony_terms(self.kernel, t_min=1e-4, t_max=1e2)
        creeping = vv.AbelKernel(amplitude=0.3, alpha=0.5)
        with pytest.raises(vv.InputError, match="must be positive"):
            vv.prony_terms(creeping, modulus=1.0, t_min=1e-4, t_max=1e4)


class TestFiles:
    """Writing and reading of kernels and fits."""

    @pytest.mark.parametrize(
        "kernel",
        [
            *KERNELS.values(),
            vv.PronyKernel(weights=[0.1, 0.2], rates=[1.0, 3.0]),
            vv.TabulatedKernel(times=[0.0, 1.0], values=[0.3, 0.1], interpolation="exponential"),
            vv.SumKernel(parts=list(KERNELS.values())),
            vv.ThermalKernel(
                kernel=KERNELS["rabotnov"],
                shift=vv.ShiftTable(temperatures=[0, 20, 60], decades=[2.0, 0.0, -2.5]),
                temperature=37.0,
            ),
        ],
        ids=lambda kernel: type(kernel).__name__,
    )
    def test_kernels(self, kernel, tmp_path):
        vv.write_kernel(kernel, tmp_path / "k.json")
        back = vv.read_kernel(tmp_path / "k.json")
        mu = np.geomspace(1e-3, 1e3, 7)
        assert type(back) is type(kernel)
        assert (back.transform(mu) == kernel.transform(mu)).all()

    @pytest.mark.parametrize("kind", ["rabotnov", "prony", ["rabotnov", "rzhanitsyn"]])
    @pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
    def test_fits(self, kind, tmp_path):
        fit = vv.fit_kernel(
            made(KERNELS["rabotnov"], 0.02), kind=kind, shift=vv.WLF(reference=20, c1=9, c2=100)
        )
        fit.to_json(tmp_path / "f.json")
        back = vv.read_fit(tmp_path / "f.json")
        assert repr(back) == repr(fit)
        assert back.kernel.at(40).transform(2.0) == fit.kernel.at(40).transform(2.0)
        pair = [vv.propagate(one, lambda s: s.modulus, samples=5).answers for one in (fit, back)]
        assert pair[0] == pytest.approx(pair[1], rel=1e-6)
        assert vv.read_kernel(tmp_path / "f.json").transform(2.0) == fit.kernel.transform(2.0)
        saved = json.loads((tmp_path / "f.json").read_text())
        if "unknowns" in saved["fit"]:
            # Printing them would take a minute.
            saved["fit"]["unknowns"][0] = -1e308
            (tmp_path / "f.json").write_text(json.dumps(saved))
            with pytest.raises(vv.InputError, match=r"unknowns: 1e.308 .* must be at most 700"):
                vv.read_fit(tmp_path / "f.json")

    @pytest.mark.parametrize(
        ("text", "reported"),
        [
            ("{", "is not JSON"),
            ("[]", "is not a fitted kernel"),
            ('{"format": "viscovib kernel", "version": 2}', "version = 2: must be 1"),
            ('{"format": "viscovib kernel", "version": 1}', "lacks 'kernel'"),
            ('{"format": "viscovib kernel", "version": 1, "kernel": {"kind": "x"}}', "kind = 'x'"),
            ('{"format": "viscovib kernel", "version": 1, "kernel": {"kind": "abel"}}', "lacks"),
            ('{"format": "viscovib kernel", "version": 1, "kernel": {"kind": "abel", '
             '"amplitude": -1, "alpha": 0.5}}', "amplitude = -1"),
        ],
    )  # fmt: skip
    def test_bad_files(self, text, reported, tmp_path):
        path = tmp_path / "bad.json"
        path.write_text(text)
        with pytest.raises(vv.InputError, match=reported):
            vv.read_kernel(path)


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        ({"kind": "kelvin"}, "kind = 'kelvin'"),
        ({"kind": []}, "must be a kind"),
        ({"kind": ["prony", "abel"]}, "prony already includes any sum"),
        ({"storage_weight": 0.0, "loss_weight": 0.0}, "must not both be 0"),
        ({"modulus": -1.0}, "modulus = -1"),
        ({"kind": "prony", "terms": 0}, "terms = 0"),
        ({"kind": ["rabotnov"] * 4}, "must be at most 3"),
    ],
)
def test_bad_arguments(given, reported):
    with pytest.raises(vv.InputError, match=reported):
        vv.fit_kernel(made(KERNELS["rabotnov"]), **given)


@pytest.mark.parametrize("kind", ["rabotnov", "prony"])
def test_the_band_of_a_picture_is_that_of_the_samples(kind):
    """The half width is a quantile over kernels drawn from the likelihood."""
    fit = vv.fit_kernel(made(KERNELS["rabotnov"], 0.02), kind=kind)
    nu = np.exp(fit.measured.log_rates)

    def curves(sample):
        stiff = sample.modulus * (1 - sample.kernel.transform(nu))
        return np.concatenate([stiff.real, stiff.imag])

    band = vv.propagate(fit, curves, samples=400)
    ratio = fit._predicted_error() / ((band.high - band.low) / 2)
    assert 0.8 < np.median(ratio) < 1.25
    assert ((ratio > 0.5) & (ratio < 2)).mean() > 0.95


def test_too_few_numbers_are_reported():
    data = vv.ModulusData(frequencies=[1.0], storage=[2.0], loss=[0.1])
    with pytest.raises(vv.InputError, match="2 numbers do not determine 4 parameters"):
        vv.fit_kernel(data)


def test_pictures():
    import matplotlib.pyplot as plt

    fit = vv.fit_kernel(made(KERNELS["rabotnov"], 0.02))
    curve, residuals = fit.plot(x="hz")
    assert len(curve.lines) == 4
    assert residuals.get_xlabel() == "frequency (Hz)"
    np.testing.assert_allclose(
        curve.lines[0].get_xdata() * 2 * np.pi, np.exp(fit.measured.log_rates)
    )
    _, alone = plt.subplots()
    assert fit.plot(alone) == [alone]
    assert fit.profile("alpha").plot().get_xlabel() == "alpha"
    nu = np.linspace(1, 5, 7)
    band = vv.propagate(fit, lambda s: np.abs(s.kernel.transform(nu)), samples=20)
    assert len(band.plot(nu).lines) == 1
    plt.close("all")


@pytest.mark.parametrize("second", [2.0**20, 2.0**-20, 1e6, 3.7])
def test_terms_of_a_fit_do_not_depend_on_the_unit_of_time(second):
    """Six decades in seconds or milliseconds: rounding must not add a term per decade."""
    nu = np.geomspace(1e-3, 1e3, 30)
    noise = 1 + 0.01 * np.random.default_rng(3).standard_normal((2, nu.size))
    stiff = 1 - vv.PronyKernel(weights=[0.4], rates=[0.8]).transform(nu)
    transforms = []
    for unit in (1.0, second):
        data = vv.ModulusData(
            frequencies=nu * unit, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
        )
        fit = vv.fit_kernel(data, kind="prony")
        transforms.append(fit.kernel.transform(nu * unit))
    np.testing.assert_allclose(transforms[1], transforms[0], atol=1e-10)


NOISES = ("of each part", "of the modulus")


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("noise", NOISES)
def test_intervals_hold_the_truth_as_often_as_they_say(noise):
    """Different scatter of storage and loss: a common variance would cover 72 % only."""
    rng, inside = np.random.default_rng(8), []
    for _ in range(80):
        beta = 10 ** rng.uniform(-0.3, 0.9)
        kernel = vv.RabotnovKernel(
            amplitude=rng.uniform(0.4, 0.8) * beta, alpha=rng.uniform(0.4, 0.7), beta=beta
        )
        nu = np.geomspace(1e-3, 1e3, int(rng.choice([10, 20, 40])))
        k, scatter = 2e6 * (1 - kernel.transform(nu)), 0.01 * rng.standard_normal((2, nu.size))
        size = np.array([k.real, k.imag] if noise == NOISES[0] else [abs(k), abs(k)])
        storage, loss = np.array([k.real, k.imag]) + size * scatter
        if loss.min() <= 0:
            continue
        fit = vv.fit_kernel(vv.ModulusData(frequencies=nu, storage=storage, loss=loss))
        for name, true in truth(kernel).items():
            low, high = fit.interval[name]
            inside.append(low <= true <= high)
    assert 0.92 < np.mean(inside) < 0.99, np.mean(inside)


@pytest.mark.parametrize(
    "parts", [("rabotnov",), ("rzhanitsyn",), ("abel",), ("rabotnov", "abel"), ("rzhanitsyn",) * 2]
)
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("modulus", [None, 2e5])
def test_slopes_of_parameters_are_differences(parts, free, modulus):
    """Closed forms against central differences; one set of unknowns against many."""
    model = Model(parts, free, modulus, unit=3.0)
    for theta in np.random.default_rng(0).uniform(-3, 3, (5, model.size)):
        steps = 1e-5 * np.eye(model.size)
        pairs = [(model.turned(theta + h), model.turned(theta - h)) for h in steps]
        slopes = np.array([(b - a) / 2e-5 for b, a in pairs]).T
        np.testing.assert_allclose(model.turned_slopes(theta), slopes, atol=1e-8)
        for one, many in zip(model.split(theta), model.splits(theta[np.newaxis]), strict=True):
            np.testing.assert_allclose(one, np.ravel(many), rtol=1e-13)
