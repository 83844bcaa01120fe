"""Campbell diagrams against closed forms, references and eigenvalues by SciPy."""

import json
from itertools import pairwise

import numpy as np
import pytest
import viscovib as vv
from scipy.optimize import brentq
from test_rotors import DATA, Rotor, laval, overhung


def state_matrix(rotor, speed):
    damping, stiffness = rotor.matrices(speed)
    inverse, n = np.linalg.inv(rotor.mass), rotor.n
    upper = np.hstack([np.zeros((n, n)), np.eye(n)])
    return np.vstack([upper, np.hstack([-inverse @ stiffness, -inverse @ damping])])


@pytest.mark.parametrize("seed", range(6))
def test_critical_speeds_and_the_threshold_by_other_searches(seed):
    rotor = Rotor(100 + seed, 1 + seed % 5)
    speeds = np.linspace(0, 4, 401)
    orders = [0.5, 1, 2]
    found = vv.campbell(rotor.system(), speeds, orders=orders)

    def counted(speed, order):
        values = np.linalg.eigvals(state_matrix(rotor, speed)).imag
        return int((values > order * speed + 1e-12).sum())

    for order in orders:
        own = np.sort(found.critical_speeds[found.critical_orders == order])
        # Between two of them the number of higher frequencies is constant; it changes at each.
        for speed in own:
            below, above = counted(speed * (1 - 1e-7), order), counted(speed * (1 + 1e-7), order)
            assert abs(below - above) == 1
        for low, high in pairwise(speeds[1:]):
            inside = ((own > low) & (own <= high)).sum()
            change = counted(high, order) - counted(low, order)
            assert (inside - change) % 2 == 0

    def growth(speed):
        return np.linalg.eigvals(state_matrix(rotor, speed)).real.max()

    unstable = np.array([growth(speed) for speed in speeds]) > 1e-10
    if not unstable.any():
        assert np.isnan(found.threshold)
        return
    k = int(np.argmax(unstable))
    if k == 0:
        assert found.threshold == speeds[0]
    else:
        assert found.threshold == pytest.approx(brentq(growth, speeds[k - 1], speeds[k]), abs=1e-9)


def test_a_gyroscopic_disc_in_closed_form():
    """w^2 -+ g Omega w - k = 0: w = +-g Omega/2 + sqrt((g Omega/2)^2 + k)."""
    k, g = 4.0, 0.5
    disc = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[k, k], gyroscopic=[[0, g], [-g, 0]], names=["a", "b"]
    )
    speeds = np.linspace(0, 5, 26)
    found = vv.campbell(disc, speeds, plane=("a", "b"))
    root = np.sqrt((g * speeds / 2) ** 2 + k)
    assert found.frequencies[:, 0] == pytest.approx(root - g * speeds / 2, rel=1e-13)
    assert found.frequencies[:, 1] == pytest.approx(root + g * speeds / 2, rel=1e-13)
    assert found.whirl[1:] == pytest.approx(np.tile([-1.0, 1.0], (25, 1)), abs=1e-9)
    assert np.isnan(found.whirl[0]).all()
    wanted = [np.sqrt(k / (1 + g)), np.sqrt(k / (1 - g))]
    assert found.critical_speeds == pytest.approx(wanted, rel=1e-12)
    assert found.critical_modes.tolist() == [0, 1]
    assert np.isnan(found.threshold)
    # The other way round.
    turned = vv.campbell(disc, speeds, plane=("b", "a")).whirl
    assert turned[1:] == pytest.approx(-found.whirl[1:])


def test_an_overhung_rotor_has_the_reference_values():
    """Reference: closed form and eigenvalues, 15 digits."""
    reference = {one["name"]: one for one in json.loads(DATA.read_text())}
    value = reference["gyroscopic_overhung_rotor"]["value"]
    found = vv.campbell(overhung(damped=False), np.linspace(0, 40, 41), plane=("x", "y"))
    at_20 = np.sort(found.frequencies[20])
    assert at_20 == pytest.approx(value["whirl_frequencies_at_20"], rel=1e-12)
    direction = found.whirl[20, found.critical_modes]
    forward = found.critical_speeds[direction > 0]
    backward = found.critical_speeds[direction < 0]
    assert forward == pytest.approx([float(x) for x in value["forward_critical"]], rel=1e-13)
    assert backward == pytest.approx([float(x) for x in value["backward_critical"]], rel=1e-13)


def test_modes_keep_their_lines_where_frequencies_cross():
    """Two uncoupled discs: the forward line of one crosses the lines of the other."""
    g = np.kron(np.diag([1.0, 0.1]), [[0, 1], [-1, 0]])
    discs = vv.PolynomialSystem(mass=[1] * 4, stiffness=[1, 1, 9, 9], gyroscopic=g)
    for n in (9, 33, 301):
        speeds = np.linspace(0, 6, n)
        found = vv.campbell(discs, speeds)
        wanted = []
        for k, f in ((1, 1.0), (9, 0.1)):
            root = np.sqrt((f * speeds / 2) ** 2 + k)
            wanted += [root - f * speeds / 2, root + f * speeds / 2]
        for line in wanted:
            off = np.abs(found.frequencies - line[:, np.newaxis]).max(axis=0)
            assert off.min() < 1e-10


def test_memory_by_exponentials_is_included():
    rotor = Rotor(5, 3, memory=True)
    speeds = np.linspace(0, 6, 25)
    found = vv.campbell(rotor.system(), speeds)
    for i, speed in enumerate(speeds):
        roots = rotor.system().at_speed(speed).characteristic_roots()
        own = found.roots[i][np.isfinite(found.roots[i])]
        assert np.sort(own.imag) == pytest.approx(roots.oscillatory.imag, rel=1e-8)
        assert found.growth[i] == pytest.approx(roots.growth_rate, abs=1e-9) or (
            # Real roots to the left are not all listed by the characteristic roots.
            found.growth[i] > roots.growth_rate
        )
    at = rotor.system().at_speed
    assert at(found.threshold - 1e-5).characteristic_roots().n_unstable == 0
    assert at(found.threshold + 1e-5).characteristic_roots().n_unstable > 0


def test_an_overdamped_mode_has_no_frequency():
    system = vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 4], damping=[3, 0.1])
    found = vv.campbell(system, [0.0, 1.0])
    assert found.frequencies.shape == (2, 1)
    stiff = vv.PolynomialSystem(mass=1, stiffness=1, damping=2.5, centrifugal=1)
    found = vv.campbell(stiff, np.linspace(0, 3, 31))
    oscillates = 1 + found.speeds**2 > 1.25**2
    assert np.array_equal(np.isfinite(found.frequencies[:, 0]), oscillates)


def test_a_rotor_without_stiffness_is_not_unstable_by_rounding():
    """Rigid modes have double eigenvalues 0, which rounding splits."""
    chain = [[1, -1, 0], [-1, 2, -1], [0, -1, 1]]
    found = vv.campbell(
        vv.PolynomialSystem(mass=[1, 2, 1], stiffness=chain, centrifugal=np.zeros((3, 3))), [0, 1]
    )
    assert np.isnan(found.threshold)
    assert found.frequencies.shape == (2, 2)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("speed_to=0", "speed_to = 0: must be greater than speed_from = 0"),
        ("speed_to=1 speed_count=1", "speed_count = 1: must be "),
        ("speed_to=1 orders=0", r"orders .*= 0: must be greater than 0"),
        ("speed_to=1 plane='x' 'z'", "plane: must be two of the coordinates"),
    ],
)
def test_wrong_keys(tmp_path, keys, message):
    path = tmp_path / "rotor.nml"
    count = "" if "speed_count" in keys else "speed_count=5"
    path.write_text(
        "&system coordinates='x' 'y' mass=1 1 stiffness=1 1 circulatory=0 1 -1 0 /\n"
        f"&campbell speed_from=0 {count} {keys} /\n"
    )
    with pytest.raises(vv.InputError, match=message):
        vv.run(path)


KERNEL = vv.RzhanitsynKernel(amplitude=0.05, alpha=0.1, beta=0.05)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"system": vv.Mount(mass=1, inertia=1, offset=1, stiffness_x=1, stiffness_phi=1)},
         "system = .*: must be a PolynomialSystem"),
        ({"system": laval(0.1, 0.1, speed=2)}, "speed: must not be given for campbell"),
        ({"system": vv.PolynomialSystem(mass=1, stiffness=1, kernel=KERNEL)},
         "kernel: must be a sum of exponentials for complex modes"),
        ({"speeds": [0, 2, 1]}, r"speeds\[2\] = 1 after 2: must be strictly increasing"),
        ({"speeds": [-1, 2]}, r"speeds\[0\] = -1: must not be negative"),
        ({"speeds": []}, "speeds: 0 values, must be 1 to"),
        ({"speeds": [0, np.inf]}, r"speeds\[1\] = inf: must be a finite number"),
        ({"orders": [1, 0]}, r"orders = \[1, 0\]: must be numbers greater than 0"),
        ({"plane": ("x", "z")}, r"plane = .*: must be two of the coordinates x, y"),
        ({"plane": "xy"}, "plane = 'xy': must be two of the coordinates x, y"),
        ({"plane": ("x", "x")}, "plane = .*: must be two of the coordinates x, y"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_named(given, message):
    system = given.pop("system", laval(0.1, 0.1))
    speeds = given.pop("speeds", [0, 1])
    with pytest.raises(vv.InputError, match=message):
        vv.campbell(system, speeds, **given)


def test_the_picture_shows_lines_orders_and_critical_speeds():
    import matplotlib

    matplotlib.use("Agg")
    found = vv.campbell(laval(0.1, 0.1), np.linspace(0, 3, 31), orders=[1, 2], plane=("x", "y"))
    ax = found.plot()
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["forward", "backward", "critical speed", "unstable"]
    styles = {line.get_label(): line.get_linestyle() for line in ax.lines}
    assert styles["forward"] == "-"
    assert styles["backward"] != "-"
    assert len(ax.patches) == 1
