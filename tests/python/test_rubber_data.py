"""Tables of measurements: values read, and refused input with its location."""

import time
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from rubber_examples import KERNELS, made

DATA = Path(__file__).parents[2] / "data" / "rubber"


def table(tmp_path, text, name="table.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_published_tables():
    master = vv.read_dma(DATA / "pyvisco_freq_user_master.csv")
    assert (master.frequencies.size, master.quantity) == (206, "E")
    assert master.frequencies[[0, -1]] == pytest.approx(2 * np.pi * np.array([1e-12, 1e14]))
    assert master.storage[[0, -1]] == pytest.approx([88.79651575665739e6, 9580.5e6], rel=1e-4)
    raw = vv.read_dma(DATA / "pyvisco_freq_user_raw.csv")
    sets = raw.sets()
    assert [one.frequencies.size for one in sets] == [10] * 21
    assert sets[0].temperature.mean() == pytest.approx(-49.9, abs=0.1)
    # The table over time contains the storage modulus at t = 1/f.
    relaxing = vv.read_relaxation(DATA / "pyvisco_time_user_raw.csv")
    for one, other in zip(sets, relaxing.sets(), strict=True):
        assert other.modulus[::-1] == pytest.approx(one.storage, rel=1e-12)
        assert 2 * np.pi / other.times[::-1] == pytest.approx(one.frequencies, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "storage", "loss", "nu"),
    [
        ("f;E';E''\nHz;GPa;MPa\n1,5;2,25;30\n2;2,5;40\n", [2.25e9, 2.5e9], [3e7, 4e7], 3 * np.pi),
        ("omega [rad/s]\tG' (kPa)\ttan delta [-]\n2\t100\t0.5\n4\t110\t0.25\n", [1e5, 1.1e5],
         [5e4, 2.75e4], 2.0),
        ("freq,|E*|,angle\nHz,Pa,deg\n1,2,60\n2,2,30\n", [1, 3**0.5], [3**0.5, 1], 2 * np.pi),
        ("# a remark\n\nfrequency, E_stor, E_loss\n1/s, N/mm2, N/mm2\n3, 5, 1\n4, 6, 1\n",
         [5e6, 6e6], [1e6, 1e6], 6 * np.pi),
    ],
)  # fmt: skip
def test_units_commas_and_parts(tmp_path, text, storage, loss, nu):
    data = vv.read_dma(table(tmp_path, text))
    assert data.storage == pytest.approx(storage)
    assert data.loss == pytest.approx(loss)
    assert data.frequencies[0] == pytest.approx(nu)


@pytest.mark.parametrize("unit", ["1/s", "s-1", "s^-1", "rad/s", "Hz"])
@pytest.mark.parametrize(
    ("name", "angular"),
    [("omega", True), ("ω", True), ("Angular Frequency", True), ("w", True), ("f", False),
     ("circular frequency", True), ("Frequency", False), ("Ω", True)],
)  # fmt: skip
def test_what_a_frequency_counts_is_reported_by_its_unit_or_name(tmp_path, unit, name, angular):
    data = vv.read_dma(table(tmp_path, f"{name} ({unit}),E' (Pa),E'' (Pa)\n3,5,1\n4,6,1\n"))
    radians = unit == "rad/s" or (angular and unit != "Hz")
    assert data.frequencies == pytest.approx(np.array([3, 4]) * (1 if radians else 2 * np.pi))


def test_a_frequency_that_may_count_both_is_refused(tmp_path):
    path = table(tmp_path, "nu,E',E''\n1/s,Pa,Pa\n3,5,1\n")
    with pytest.raises(vv.InputError, match="column 'nu': 1/s may be Hz or rad/s"):
        vv.read_dma(path)


def test_temperatures_and_sets(tmp_path):
    text = "f,E',E'',T\nHz,MPa,MPa,K\n1,2,1,273.15\n2,3,1,273.15\n1,1,1,293.15\n2,2,1,293.15\n"
    data = vv.read_dma(table(tmp_path, text))
    assert data.temperature == pytest.approx([0, 0, 20, 20])
    assert data.set.tolist() == [0, 0, 1, 1]


def test_stiffness_of_a_mount(tmp_path):
    text = "f [Hz];K* [N/mm];phase [deg];amplitude [mm]\n1;200;30;0,5\n2;220;30;0,5\n"
    data = vv.read_dynamic_stiffness(table(tmp_path, text))
    assert data.quantity == "K"
    assert data.storage == pytest.approx(np.array([2e5, 2.2e5]) * 3**0.5 / 2)
    assert data.amplitude == pytest.approx([5e-4, 5e-4])


def test_creep(tmp_path):
    data = vv.read_creep(table(tmp_path, "t,J\nmin,1/MPa\n1,2\n2,3\n"))
    assert (data.quantity, data.times.tolist()) == ("G", [60.0, 120.0])
    assert data.compliance == pytest.approx([2e-6, 3e-6])


def test_other_names(tmp_path):
    path = table(tmp_path, "A,B,C\nHz,MPa,MPa\n1,2,1\n2,3,1\n")
    data = vv.read_dma(path, columns={"frequency": "A", "storage": "B", "loss": "C"}, quantity="G")
    assert (data.quantity, data.storage[1]) == ("G", 3e6)
    with pytest.raises(vv.InputError, match="no column 'D', must be one of 'A', 'B', 'C'"):
        vv.read_dma(path, columns={"frequency": "D"})


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("", "is empty"),
        ("1,2,3\n4,5,6\n", "is a row of numbers"),
        ("f,E',E''\nHz,MPa,MPa\n", "no row of numbers"),
        ("f,E',E''\n1,2,3\n", "column 'f': has no unit, must be one of hz"),
        ("f,E',E''\nHz,MPa,psi\n1,2,3\n", "column \"E''\": unit 'psi' is not known"),
        ("f,E',E''\nHz,mPa,mPa\n1,2,3\n", "is millipascal"),
        ("f,E',E''\nHz,MPa,MPa\n1,2,3\n2,nan,3\n", r"csv:4: column \"E'\": 'nan' is not a finite"),
        ("f,E',E''\nHz,MPa,MPa\n1,2,3\n\n2,,3\n", r"csv:5: column \"E'\": is empty"),
        ("f,E',E''\nHz,MPa,MPa\n1,2,3\n2,x,3\n", r"csv:4: column \"E'\": 'x' is not a finite"),
        ("f,E',E''\nHz,MPa,MPa\n1,2,3\n2,-2,3\n", r"csv:4: column \"E'\": -2e\+06"),
        ("f,E',E''\nHz,MPa,MPa\n1,2,3\n2,2,-3\n", r"csv:4: column \"E''\": -3e\+06"),
        ("f,E',E''\nHz,MPa,MPa\n0,2,3\n", "column 'f': 0 .*greater than 0"),
        ("f,E',E''\nHz,MPa,MPa\n1,2,3\n1,2,3\n", "is given twice in set 0"),
        ("f,E',E'',set\nHz,MPa,MPa,-\n1,2,3,7\n3,2,3,7\n2,2,3,7\n", "turns back in set 7"),
        ("f,E'\nHz,MPa\n1,2\n", "has storage, must have storage and loss"),
        ("E',E''\nMPa,MPa\n1,2\n", "has no column of frequency"),
        ("f,storage,loss\nHz,MPa,MPa\n1,2,3\n", "quantity must be given"),
        ("f,E',G',E''\nHz,MPa,MPa,MPa\n1,2,3,1\n", "both contain storage"),
    ],
)  # fmt: skip
def test_bad_tables_are_reported_with_their_place(tmp_path, text, reported):
    with pytest.raises(vv.InputError, match=reported):
        vv.read_dma(table(tmp_path, text))


def test_a_temperature_without_a_unit_is_reported(tmp_path):
    """Without the unit the sets of all temperatures would be merged."""
    text = "T,f (Hz),E' (Pa),E'' (Pa)\n20,1,3,1\n40,1,2,1\n"
    with pytest.raises(vv.InputError, match="column 'T': has no unit, must be one of c, "):
        vv.read_dma(table(tmp_path, text))
    period = vv.read_dma(table(tmp_path, text.replace("T,", "T (s),").replace("40,1,", "40,2,")))
    assert period.temperature is None
    for text, reported in (
        ("T,t (s),E (Pa)\n20,1,3\n20,2,2\n", "column 'T': has no unit, must be one of c, "),
        ("T (°C),t,E (Pa)\n20,1,3\n20,2,2\n", "column 't': has no unit, must be one of s, "),
        ("t,E (Pa)\n1,3\n2,2\n", "column 't': has no unit, must be one of s, "),
    ):
        with pytest.raises(vv.InputError, match=reported):
            vv.read_relaxation(table(tmp_path, text))


@pytest.mark.parametrize("unit", ["{}", "[{}]", "({})", " [ {} ] "])
def test_milli_is_not_mega(tmp_path, unit):
    """For any spelling of a unit, in its own line or after the name."""
    wanted = {"mHz": 2e-3 * np.pi, "MHz": 2e6 * np.pi}
    for name, size in wanted.items():
        of = unit.format(name)
        texts = [f"f,E',E''\n{of},MPa,MPa\n1,2,3\n"]
        if of != name:
            texts.append(f"f {of},E' (MPa),E'' (MPa)\n1,2,3\n")
        for text in texts:
            data = vv.read_dma(table(tmp_path, text))
            np.testing.assert_allclose(data.frequencies, size, rtol=1e-14)
    for text, reported in (
        (f"f,E',E''\n{unit.format('mhz')},Pa,Pa\n1,2,3\n", "not known, must be .* mHz, MHz, rad/s"),
        (f"f,E',E''\nHz,{unit.format('mPa')},Pa\n1,2,3\n", "is millipascal; write MPa"),
    ):
        with pytest.raises(vv.InputError, match=reported):
            vv.read_dma(table(tmp_path, text))


def test_bad_arrays_are_reported():
    good = {"frequencies": [1.0, 2.0], "storage": [2.0, 3.0], "loss": [1.0, 1.0]}
    for change, reported in (
        ({"storage": [2.0, -3.0]}, r"storage\[1\] = -3"),
        ({"loss": [1.0, float("nan")]}, r"loss\[1\] = nan"),
        ({"loss": [1.0]}, "loss has 1 numbers"),
        ({"frequencies": [1.0, 1.0]}, "is given twice"),
        ({"quantity": "D"}, "quantity"),
        ({"temperature": -300}, r"temperature\[0\] = -300: must be above -273.15 degrees Celsius"),
    ):
        with pytest.raises(vv.InputError, match=reported):
            vv.ModulusData(**(good | change))
    with pytest.raises(vv.InputError, match="before the end of the ramp"):
        vv.RelaxationData(times=[1.0, 2.0], modulus=[2.0, 1.0], ramp=1.5)
    with pytest.raises(vv.FileError, match="cannot be read"):
        vv.read_dma("nowhere.csv")


def test_young_to_shear_only_by_a_ratio_that_is_said():
    data = vv.ModulusData(frequencies=[1.0], storage=[3.0], loss=[0.3])
    shear = data.to_shear(poisson=0.5)
    assert (shear.quantity, shear.storage[0], shear.loss[0]) == ("G", 1.0, pytest.approx(0.1))
    assert shear.to_young(poisson=0.5).storage[0] == pytest.approx(3.0)
    with pytest.raises(vv.InputError, match="must be 'E' to become G"):
        shear.to_shear(poisson=0.5)


class TestKramersKronig:
    """Consistency of loss and storage moduli."""

    @pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
    @pytest.mark.parametrize("kind", ["rabotnov", "rzhanitsyn"])
    def test_a_material_is_consistent(self, kind, noise):
        found = vv.kramers_kronig(made(KERNELS[kind], noise))
        assert found.consistent
        assert found.together[1] < noise + 0.02

    def test_scaled_loss_is_not(self):
        data = made(KERNELS["rabotnov"])
        wrong = vv.ModulusData(
            frequencies=data.frequencies, storage=data.storage, loss=1.7 * data.loss
        )
        found = vv.kramers_kronig(wrong)
        assert not found.consistent
        assert np.median(found.ratio) == pytest.approx(1.7, rel=0.03)

    def test_loss_that_is_too_large_in_a_part_of_the_range_is_not(self):
        """By 30 % above 10 Hz, which a compromise would hide; the same data without it are."""
        for seed in range(12):
            rng = np.random.default_rng(seed)
            rates = np.exp(rng.uniform(1, 7, 6))
            weights = rates * rng.dirichlet(np.ones(6)) * rng.uniform(0.6, 0.95)
            nu = np.geomspace(0.6, 6e4, 61)
            stiff = 2e6 * (1 - vv.PronyKernel(weights=weights, rates=rates).transform(nu))
            noise = 1 + 0.005 * rng.standard_normal((2, nu.size))
            storage, loss = stiff.real * noise[0], stiff.imag * noise[1]
            good = vv.ModulusData(frequencies=nu, storage=storage, loss=loss)
            assert vv.kramers_kronig(good).consistent
            high = nu > 2 * np.pi * 10
            loss = np.where(high, 1.3 * loss, loss)
            found = vv.kramers_kronig(vv.ModulusData(frequencies=nu, storage=storage, loss=loss))
            assert not found.consistent
            assert found.wrong

    def test_weak_rubber_leaves_doubt(self):
        """Storage varies by a tenth only, like typical errors: the summary states the doubt."""
        nu = np.geomspace(1e-2, 1e4, 40)
        hats = vv.RabotnovKernel(amplitude=1, alpha=0.5, beta=2).transform(nu)
        stiff = 1e6 * (1 - 0.1 * hats / np.abs(hats).max())
        for factor in (1.0, 1.5):
            data = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=factor * stiff.imag)
            found = vv.kramers_kronig(data)
            assert ("determines little" in found.summary()) is (factor > 1)
            assert 0.08 < found.storage_varies < 0.11

    def test_swapped_columns_are_reported(self):
        """The storage modulus would decrease, which is impossible."""
        data = made(KERNELS["rabotnov"])
        swapped = vv.ModulusData(frequencies=data.frequencies, storage=data.loss, loss=data.storage)
        found = vv.kramers_kronig(swapped)
        assert not found.consistent
        assert found.ratio.max() > 100

    def test_the_published_master_curve_contradicts_itself(self):
        """Residuals of another program: 20.3, 13.2 % together, E' alone 1.4 %, E'' alone 2.6 %."""
        found = vv.kramers_kronig(vv.read_dma(DATA / "pyvisco_freq_user_master.csv"))
        assert not found.consistent
        assert found.together == pytest.approx((0.203, 0.132), abs=0.002)
        assert found.storage_alone == pytest.approx(0.014, abs=0.001)
        assert found.loss_alone == pytest.approx(0.028, abs=0.003)
        slow = found.frequencies < 2 * np.pi * 1e-2
        assert found.ratio[slow].min() > 1.3
        assert found.ratio.max() > 8
        low, high, least, most = found.wrong[0]
        assert low < 1e-10
        assert 0.5 < high < 30
        assert least > 1.2
        assert most > 8
        assert "contradict" in found.summary()

    def test_its_raw_sets_do_not(self):
        for one in vv.read_dma(DATA / "pyvisco_freq_user_raw.csv").sets():
            found = vv.kramers_kronig(one)
            assert found.consistent
            assert max(found.together) < 0.03

    def test_several_sets_are_refused(self):
        with pytest.raises(vv.InputError, match="has 21 sets"):
            vv.read_dma(DATA / "pyvisco_freq_user_raw.csv").kramers_kronig()


def test_pictures():
    import matplotlib.pyplot as plt

    raw = vv.read_dma(DATA / "pyvisco_freq_user_raw.csv")
    upper, lower = raw.plot(x="hz")
    assert lower.get_xlabel() == "frequency (Hz)"
    first = raw.sets()[0].frequencies
    np.testing.assert_allclose(2 * np.pi * upper.lines[0].get_xdata(), first)
    bar = upper.figure.axes[-1]  # from the coldest to the warmest set
    assert bar.get_ylabel() == "temperature (deg C)"
    means = [np.mean(one.temperature) for one in raw.sets()]
    np.testing.assert_allclose(bar.get_ylim(), (min(means), max(means)))
    for draw in (vv.plot_cole_cole, vv.plot_van_gurp):
        assert len(draw(raw).lines) == 21
    assert vv.kramers_kronig(made(KERNELS["rabotnov"])).plot().get_xlabel()
    plt.close("all")


def test_decimal_commas_between_commas_are_refused(tmp_path):
    """They must not be read as 1, 5 and 2: a row has no more cells than there are names."""
    text = "f,E',E''\nHz,MPa,MPa\n1,5,2,25,1,3\n2,5,3,25,1,5\n"
    with pytest.raises(vv.InputError, match=r"csv:3: has 6 cells below 3 names of columns"):
        vv.read_dma(table(tmp_path, text))
    # Empty cells do not count.
    same = vv.read_dma(table(tmp_path, "f;E';E''\nHz;MPa;MPa\n1;2;1;;\n2;3;1;\n"))
    assert same.storage == pytest.approx([2e6, 3e6])


@pytest.mark.parametrize("cell", ["1_0", "\uff11", "0x1", "1e", "1,2,3", "inf", "nan", "1 2"])
def test_what_is_no_number_in_a_table(tmp_path, cell):
    text = f"f;E';E''\nHz;MPa;MPa\n1;2;1\n{cell};3;1\n"
    with pytest.raises(vv.InputError, match=r"csv:4: column 'f': .* is not a finite number"):
        vv.read_dma(table(tmp_path, text))


def test_brackets_without_end_take_no_time(tmp_path):
    before = time.process_time()
    with pytest.raises(vv.InputError):
        vv.read_dma(table(tmp_path, f"f;{'tanh(' * 100_000};E''\nHz;MPa;MPa\n1;2;1\n"))
    assert time.process_time() - before < 5
