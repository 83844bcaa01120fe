"""A rigid body in space on mounts."""

import dataclasses
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import viscovib as vv
from referee.integration import solve_ivp
from scipy.spatial.transform import Rotation
from viscovib.plots.bodies import frequency_range
from viscovib.units import degree, hz, mm, newton_per_mm

DATA = json.loads((Path(__file__).parents[2] / "data" / "engine_on_mounts.json").read_text())
NAMES = ("x", "y", "z", "rx", "ry", "rz")


def engine(kernel=None, law=None, more=0.0, also=(), **options):
    """The engine of the table; ``more``: stiffness (N/mm) along the local z of mount 1."""
    mounts = []
    for i, given in enumerate(DATA["mounts"]):
        stiffness = np.array(given["stiffness"], dtype=float)
        stiffness[2] += more if i == 0 else 0
        mounts.append(
            vv.MountPoint(
                name=f"m{i + 1}",
                position=np.array(given["position_mm"]) * mm,
                stiffness=stiffness * newton_per_mm,
                angles=np.array(given["angles"]) * degree,
                kernel=kernel,
                law=(None, None, law),
            )
        )
    return vv.Body(
        mass=DATA["mass"], inertia=DATA["inertia"], mounts=[*mounts, *also], **options
    )  # fmt: skip


def random_body(rng, **options):
    """A body on three or four mounts at random positions with random orientations."""
    box = rng.uniform(0.2, 1, 3)
    mass = rng.uniform(1, 200)
    turn = scipy.linalg.qr(rng.normal(size=(3, 3)))[0]
    inertia = turn @ np.diag(mass / 12 * (np.sum(box**2) - box**2)) @ turn.T
    mounts = [
        vv.MountPoint(
            name=f"m{i}",
            position=rng.uniform(-0.5, 0.5, 3),
            stiffness=rng.uniform(1e4, 1e6, 3),
            angles=rng.uniform(-3, 3, 3),
            damping=rng.uniform(0, 50, 3),
            **options,
        )
        for i in range(rng.integers(3, 5))
    ]
    return vv.Body(mass=mass, inertia=inertia, mounts=mounts)


def test_engine_of_the_table():
    """Frequencies, kinetic energies and torque-roll axis of a published program, all digits."""
    np.testing.assert_allclose(engine().modes().hz, DATA["frequencies_hz"], atol=5e-8)
    stiffer = DATA["with_100_N_per_mm_more_along_local_z_of_mount_1"]
    modes = engine(more=100.0).modes()
    np.testing.assert_allclose(modes.hz, stiffer["frequencies_hz"], atol=6e-9)
    for name, shares in stiffer["kinetic_energy_percent"].items():
        np.testing.assert_allclose(modes.energy[NAMES.index(name)], shares, atol=1e-4)
    np.testing.assert_allclose(modes.energy.sum(axis=0), 100)
    axis = engine().torque_roll_axis(DATA["torque_roll_axis"]["torque_about"])
    np.testing.assert_allclose(axis, DATA["torque_roll_axis"]["direction"], atol=5e-8)
    assert engine().roll_share("y").sum() == pytest.approx(100)


def test_nonlinear_engine_with_memory():
    """Amplitudes and mount forces of an independent harmonic balance with 15 harmonics."""
    kernel = vv.RzhanitsynKernel(amplitude=0.6, alpha=0.4, beta=20)
    body = engine(kernel, "1e10*d^3")
    points = DATA["nonlinear_with_memory"]["points"]
    nu = np.array([point["hz"] for point in points]) * hz
    found = vv.forced_response(
        body, nu, load=body.load(torque=(0, 400, 0)), method="newton", harmonics=15
    )
    forces = body.mount_forces(found)
    for i, point in enumerate(points):
        first = np.abs(found.coefficients[i, :, 0])
        np.testing.assert_allclose(first, point["first"], rtol=1e-12)
        third = np.abs(found.coefficients[i, :, 1])
        np.testing.assert_allclose(third, point["third"], rtol=1e-9)
        size = np.abs(forces.force[i, ..., 0]).ravel()
        np.testing.assert_allclose(size, point["mount_force_first"], rtol=1e-12)
        # The work of the load is dissipated in the mounts.
        turning = 1j * nu[i] * found.coefficients[i, 4, 0]
        power = 0.5 * (400 * np.conj(turning)).real
        assert forces.lost_power[i].sum() == pytest.approx(power, rel=1e-11)


@pytest.mark.parametrize("above", [1.0, -1.0])
def test_preload_makes_a_pendulum(above):
    """A body hung on one point swings like a pendulum; above the point it falls over."""
    arm, mass, inertia = 0.4, 12.0, 0.7
    joint = vv.MountPoint(name="joint", position=(0, 0, above * arm), stiffness=(1e8, 1e8, 1e8))
    square = above * mass * 9.81 * arm / (inertia + mass * arm**2)

    def build():
        return vv.Body(mass=mass, inertia=(inertia,) * 3, mounts=[joint], gravity=9.81)

    if above < 0:
        with pytest.warns(vv.StabilityWarning, match="unstable"):
            body = build()
        with pytest.raises(vv.InputError, match=r"grows like exp\(4\.239"):
            body.modes()
        return
    omega = build().modes().omega
    np.testing.assert_allclose(omega[1:3], math.sqrt(square), rtol=1e-5)


def test_preload_remembers_nothing():
    """The gravity stiffness of a hanging body does not relax with its rubber."""
    kernel = vv.PronyKernel(weights=[5.0], rates=[10.0])
    joint = vv.MountPoint(name="joint", position=(0, 0, 0.4), stiffness=(1e9,) * 3, kernel=kernel)
    body = vv.Body(mass=12, inertia=(0.7,) * 3, mounts=[joint], gravity=9.81)
    square = 12 * 9.81 * 0.4 / (0.7 + 12 * 0.4**2)
    stiffness = body.dynamic_stiffness(math.sqrt(square))
    assert np.abs(scipy.linalg.eigvals(stiffness)).min() < 1e-4 * abs(stiffness[3, 3])


def test_fluid_mount():
    """Dynamic stiffness of a published fluid mount, and its body against the formula."""
    track = vv.FluidTrack(mass=62.8, damping=2666, stiffness=436950)
    mount = vv.MountPoint(
        name="fluid", position=(0, 0, 0), stiffness=(1e5, 1e5, 512950), damping=(0, 0, 198),
        track=track, rotational_stiffness=(1e3,) * 3,
    )  # fmt: skip
    frequencies = np.array([5.0, 12.0, 15.0, 14.9434])
    reported = mount.dynamic_stiffness(frequencies * hz)[:, 2]
    size = [478.823, 1042.292, 1399.470, 1399.555]
    np.testing.assert_allclose(np.abs(reported) / 1e3, size, atol=6e-4)
    angles = np.degrees(np.angle(reported))[:3]
    np.testing.assert_allclose(angles, [13.841, 53.241, 27.017], atol=6e-4)
    body = vv.Body(mass=300, inertia=(10, 10, 10), mounts=[mount])
    assert body.dof_names[6:] == ("fluid_y",)
    found = vv.forced_response(body, frequencies * hz, load=body.load((0, 0, 1)), method="linear")
    expected = 1 / (reported - 300 * (frequencies * hz) ** 2)
    np.testing.assert_allclose(found.coefficient("z"), expected, rtol=1e-11)
    force = body.mount_forces(found)
    np.testing.assert_allclose(force.force[:, 0, 2, 0], reported * expected, rtol=1e-11)
    assert force.amplitude("fluid")[0, 2] == pytest.approx(abs(reported[0] * expected[0]))


def test_modes_on_soft_rubber_far_below_its_instantaneous_stiffness():
    """Each direction separately: m s^2 + k (1 - R(s)) = 0 with 30 digits, three double roots."""
    mp = pytest.importorskip("mpmath")
    a, alpha, beta, k = 999.0, 0.35, 1000.0, 4e9
    foot = vv.MountPoint(
        name="foot", position=(0, 0, 0), stiffness=(k, k, 2 * k), rotational_stiffness=(k, k, k),
        kernel=vv.RabotnovKernel(amplitude=a, alpha=alpha, beta=beta),
    )  # fmt: skip
    body = vv.Body(mass=100, inertia=(90, 90, 50), mounts=[foot])
    modes = body.modes()
    true = []
    for stiff, inertia in ((k, 100), (k, 100), (2 * k, 100), (k, 90), (k, 90), (k, 50)):
        start = 1j * modes.omega[0]
        s = complex(mp.findroot(
            lambda s, c=stiff / inertia: s**2 / c + 1 - a / (s**alpha + beta), start
        ))  # fmt: skip
        true.append(s)
    true = np.array(sorted(true, key=lambda s: s.imag))
    np.testing.assert_allclose(modes.omega, true.imag, rtol=1e-9)
    np.testing.assert_allclose(modes.damping_ratio, -true.real / np.abs(true), rtol=1e-9)
    assert np.linalg.matrix_rank(modes.shapes, 1e-6) == 6
    assert modes.omega[-1] < 0.2 * body.modes(stiffness="instantaneous").omega[0]
    at = body.modes(stiffness=modes.omega[2]).omega[2]
    assert at == pytest.approx(modes.omega[2], rel=0.1)
    # Plots and pages show these frequencies.
    assert 2 * np.pi * frequency_range(body)[[0, -1]] == pytest.approx(
        [modes.omega[0] / 3, 4 * modes.omega[-1]]
    )


def test_scatter_on_rubber():
    """First-order perturbation of the damped modes, against individually built bodies."""
    kernel = vv.RabotnovKernel(amplitude=40.0, alpha=0.5, beta=50.0)
    body = engine(kernel)
    for spread, most in ((0.0, 1e-12), (0.1, 0.004)):
        frequencies, _ = body.scatter(5, spread, seed=4)
        factors = np.random.default_rng(4).uniform(1 - spread, 1 + spread, (5, 9))
        for found, factor in zip(frequencies, factors, strict=True):
            mounts = [
                dataclasses.replace(
                    m, stiffness=np.asarray(m.stiffness) * factor[3 * j : 3 * j + 3]
                )
                for j, m in enumerate(body.mounts)
            ]
            own = vv.Body(mass=body.body_mass, inertia=body.inertia, mounts=mounts).modes()
            np.testing.assert_allclose(found, own.hz, rtol=most)


GOOD = {"name": "m", "position": (0.1, 0, 0), "stiffness": (1e5, 1e5, 1e5)}


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        ({"name": "left mount"}, "name = 'left mount': must be letters"),
        ({"position": (1, 2)}, r"m: position: must have shape \(3,\)"),
        ({"stiffness": (1, -2, 3)}, "m: stiffness = -2: must not be negative"),
        ({"stiffness": (0, 0, 0)}, "must not be 0 in every direction"),
        ({"axes": np.diag([1, 1, 2])}, "m: axes: must be a rotation"),
        ({"axes": np.diag([1, 1, -1])}, "m: axes: must be a rotation"),
        ({"angles": (0, 0, math.nan)}, "m: angles"),
        ({"kernel": "rubber"}, "m: kernel = 'rubber': must be a Kernel, None or three"),
        ({"law": "d^3 + q"}, r"m: law\[0\] = 'd\^3 \+ q': 'q' is neither"),
        ({"law": "q*d^3", "parameters": {"q": "soft"}}, r"parameters\['q'\] = 'soft'"),
        ({"law": "x^3"}, r"m: law\[0\].*unknown|x"),
        ({"track": 3}, "m: track = 3: must be a FluidTrack"),
    ],
)
def test_wrong_mounts(given, reported):
    """One-line messages that name the mount."""
    with pytest.raises(vv.InputError, match=reported):
        vv.MountPoint(**{**GOOD, **given})


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        ({"mass": 0}, "mass = 0: must be greater than 0"),
        ({"inertia": (1, 1, 3)}, "larger than the sum of the other two"),
        ({"inertia": (1, 1, -1)}, "principal moments"),
        ({"inertia": [[1, 0.2, 0], [0, 1, 0], [0, 0, 1]]}, "inertia: must be symmetric"),
        ({"mounts": [vv.MountPoint(**GOOD)] * 2}, "the name 'm' is given twice"),
        ({"geometry": "finite"}, "geometry = 'finite': must be one of"),
        ({"base_direction": "w"}, "base_direction"),
        ({"gravity": (0, 0)}, r"gravity: must have shape \(3,\)"),
    ],
)
def test_wrong_bodies(given, reported):
    """One-line messages."""
    with pytest.raises(vv.InputError, match=reported):
        vv.Body(**{"mass": 1, "inertia": (1, 1, 1), "mounts": [vv.MountPoint(**GOOD)], **given})


@pytest.mark.parametrize(
    ("kernel", "reported"),
    [
        (vv.AbelKernel(amplitude=0.1, alpha=0.5), "a kernel has no finite integral"),
        (
            vv.PronyKernel(weights=[2.0], rates=[1.0]),
            "integral of a kernel is 2, must be below",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_no_sag(kernel, reported):
    """Rubber with unbounded creep carries no weight."""
    mount = vv.MountPoint(**GOOD, kernel=kernel, rotational_stiffness=(1, 1, 1))
    with pytest.raises(vv.InputError, match=reported):
        vv.Body(mass=1, inertia=(1, 1, 1), mounts=[mount], gravity=9.81)


def test_softening_mount_gives_way():
    """A law with a maximum below the weight has no static equilibrium."""
    mount = vv.MountPoint(**GOOD, law="-1e12*d^3", rotational_stiffness=(1, 1, 1))
    with pytest.raises(vv.InputError, match=r"collapse under 0\.1\d* %"):
        vv.Body(mass=1000, inertia=(1, 1, 1), mounts=[mount], gravity=9.81)


def test_millimetres_as_metres():
    """A warning for positions far outside the body."""
    far = vv.MountPoint(name="m", position=(463.0, 0, 0), stiffness=(1e5, 1e5, 1e5))
    with pytest.warns(vv.StabilityWarning, match=r"units\.mm"):
        vv.Body(mass=100, inertia=(5, 5, 5), mounts=[far])


def test_free_body_is_reported():
    """Free modes have the frequency 0 and are named."""
    mount = vv.MountPoint(name="m", position=(0, 0, 0), stiffness=(1e5, 0, 0))
    modes = vv.Body(mass=10, inertia=(1, 1, 1), mounts=[mount]).modes()
    assert (modes.omega == 0).sum() == 5
    assert "5 of them rigid-body modes" in repr(modes)
    assert np.isnan(modes.loss_factor[0])


def test_report(tmp_path):
    """One page with every part, as HTML and as PDF; other file extensions are refused."""
    track = vv.FluidTrack(mass=62.8, damping=2666, stiffness=436950)
    foot = vv.MountPoint(
        name="f", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
        rotational_stiffness=(1, 2, 3), track=track,
    )  # fmt: skip
    kernel = vv.PronyKernel(weights=[2.0], rates=[10.0])
    body = engine(kernel, "1e10*d^3", also=[foot], gravity=9.81)
    vv.report(body, tmp_path / "engine.html", title="Engine <1>", torque_about="y")
    page = (tmp_path / "engine.html").read_text()
    assert "Engine &lt;1&gt;" in page
    assert page.count("data:image/png") == 4
    for word in ("m1", "Sag", "Kinetic energies", "torque-roll axis", f"{body.modes().hz[0]:.4f}"):
        assert word in page
    # Laws with their axis, kernels with their parameters.
    assert "z: 1e+10 d^3" in page
    assert "2 exp(-10 t)" in page
    assert "1, 2, 3 N m/rad" in page
    assert "fluid track along z" in page
    assert "62.8 kg, 2666 N s/m, 436950 N/m" in page
    vv.report(body, tmp_path / "engine.pdf")
    assert (tmp_path / "engine.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(vv.InputError, match=r"must end in \.html or \.pdf"):
        vv.report(body, tmp_path / "engine.doc")


def test_report_of_rubber(tmp_path):
    """Damped roots, kernels with their temperature, the scatter band and engine orders."""
    inner = vv.RabotnovKernel(amplitude=0.6, alpha=0.5, beta=2)
    law = vv.WLF(reference=20.0, c1=8.86, c2=101.6)
    rubber = vv.ThermalKernel(kernel=inner, shift=law, temperature=40)
    body = engine(rubber)
    vv.report(
        body, tmp_path / "engine.html", variants=[engine(rubber.at(t)) for t in (30, 50)],
        orders={0.5: body.load(torque=(0, 10, 0)), 2: body.load(torque=(0, 50, 0))},
        rpm=np.linspace(300, 2000, 50),
    )  # fmt: skip
    page = (tmp_path / "engine.html").read_text()
    assert page.count("data:image/png") == 5
    assert "rotational stiffness" not in page
    shift = 10 ** (-8.86 * 20 / (101.6 + 20))
    for text in (
        "A t^(alpha-1) E_alpha,alpha(-beta t^alpha), A = 0.6, alpha = 0.5, beta = 2",
        f"40 deg C, WLF(reference=20.0, c1=8.86, c2=101.6), a_T = {shift:.5g}",
        "Rabotnov at 40 deg C",
        "Damped roots",
        *(f"{s.real:.5g}" for s in body.characteristic_roots().oscillatory),
        "band of 2 variants",
        "Engine orders: displacement along z",
    ):
        assert text in page
    with pytest.raises(vv.InputError, match="orders, rpm: must be given together"):
        vv.report(body, tmp_path / "engine.html", orders={2: body.load(torque=(0, 1, 0))})


def test_pictures_of_mount_forces():
    """A panel per mount with the amplitudes along its axes, over Hz by default."""
    body = engine()
    nu = np.linspace(20, 200, 12)
    forces = body.mount_forces(vv.forced_response(body, nu, load=body.load((0, 0, 10))))
    axes = forces.plot()
    assert len(axes) == len(forces.names)
    for ax, name in zip(axes, forces.names, strict=True):
        assert name in ax.get_ylabel()
        for line in ax.lines:
            np.testing.assert_allclose(line.get_xdata(), nu / (2 * np.pi))
            sizes = forces.amplitude(name)[:, "xyz".index(line.get_label())]
            np.testing.assert_array_equal(line.get_ydata(), sizes)
    assert forces.plot(x="rad/s", y="db")[-1].get_xlabel() == "circular frequency (rad/s)"


def test_pictures(tmp_path):
    """Axes are returned; a mode is labelled with its frequency."""
    body = engine()
    axis = vv.plot_body(body, mode=3, torque_about="y")
    assert axis.get_title().startswith("mode 3: 12.47 Hz")
    assert vv.plot_energy(body.modes()).get_xlabel() == "natural frequency (Hz)"
    assert vv.plot_transmissibility(body).get_xscale() == "log"
    with pytest.raises(vv.InputError, match="three-dimensional"):
        vv.plot_body(body, vv.plot_energy(body.modes()))
    body.modes().to_csv(tmp_path / "modes.csv")
    assert "energy_rz" in (tmp_path / "modes.csv").read_text()


def test_snubbers():
    """A mount between stops: its law in the deflection, about the sag, and its forces."""
    law = "1e4*d + 3e5*0.001*log(cosh(d/0.001))*tanh(d/0.001)"
    common = {"position": (0, 0, 0), "stiffness": (1e5,) * 3, "rotational_stiffness": (1e3,) * 3}
    foot = vv.MountPoint(name="foot", **common, damping=50, law=(None, None, law))
    body = vv.Body(mass=50, inertia=(1, 1, 1), mounts=[foot], gravity=9.81)

    def force(d):
        return 1e5 * d + 1e4 * d + 3e2 * np.log(np.cosh(d / 1e-3)) * np.tanh(d / 1e-3)

    down = -body.sag().displacement[2]
    assert force(down) == pytest.approx(50 * 9.81, rel=1e-12)
    h = 1e-6
    tangent = (force(down + h) - force(down - h)) / (2 * h)
    expected = math.sqrt(tangent / 50)
    assert np.abs(body.modes().omega - expected).min() < 1e-6 * expected
    nu = 0.9 * expected
    found = vv.forced_response(body, [nu], load=body.load((0, 0, 60)), method="newton")
    reported = body.mount_forces(found).force[0, 0, 2]
    theta = 2 * np.pi * np.arange(4096) / 4096
    waves = np.exp(1j * np.outer(found.harmonics, theta))
    z = (found.coefficients[0, 2] @ waves).imag
    # About the loaded position, where the mount is compressed.
    sampled = force(z - down) - force(-down)
    weights = np.where(found.harmonics == 0, 1j, 2j) / 4096
    elastic = (sampled @ waves.conj().T) * weights
    damped = 1j * found.harmonics * nu * 50 * found.coefficients[0, 2]
    np.testing.assert_allclose(reported, elastic + damped, atol=1e-6 * np.abs(reported).max())
    left = -((found.harmonics * nu) ** 2) * 50 * found.coefficients[0, 2] + reported
    np.testing.assert_allclose(left, 60.0 * (found.harmonics == 1), atol=1e-6)


def test_preloads(tmp_path):
    """Laws with a force at d = 0: motions from rest, against SciPy from the loaded position."""
    rng = np.random.default_rng(2)
    numbers = {"a": -20.0, "b": 150.0, "e6": 0.01}
    laws = {
        "a + b*d + 1e4*d^3": lambda d, v: -20 + 150 * d + 1e4 * d**3,
        "a*exp(-d) + 1e3*max(d - e6, 0)": lambda d, v: -20 * np.exp(-d) + 1e3 * max(d - 0.01, 0),
        "a*cos(d) + 0.5*v": lambda d, v: -20 * np.cos(d) + 0.5 * v,
    }
    mounts = [
        vv.MountPoint(
            name=f"m{i}", position=(0, 0, 0), stiffness=rng.uniform(500, 2000, 3), damping=3.0,
            angles=rng.uniform(-1, 1, 3), law=rng.permutation(list(laws)).tolist(),
            parameters=numbers, rotational_stiffness=(10, 20, 30),
        )
        for i in range(2)
    ]  # fmt: skip
    for gravity in (None, 9.81):
        body = vv.Body(mass=2, inertia=(1, 1, 1), mounts=mounts, gravity=gravity)
        rest = body.sag().displacement[:3]

        def rates(t, y, gravity=gravity):
            force = np.array([10.0, 0, 20]) * np.sin(3 * t) - [0, 0, 2 * (gravity or 0)]
            for mount in mounts:
                d, v = mount.rotation.T @ y[:3], mount.rotation.T @ y[3:]
                own = [laws[text](x, w) for text, x, w in zip(mount.law, d, v, strict=True)]
                force = force - mount.rotation @ (mount.stiffness * d + 3 * v + own)
            return np.r_[y[3:], force / 2]

        start = np.r_[rest, 0, 0, 0]
        assert np.abs(rates(0.0, start)).max() < 1e-11
        reported = solve_ivp(rates, (0, 2), start, "DOP853", rtol=1e-12, atol=1e-14)
        run = vv.simulate(body, 2, load=body.load((10, 0, 20)), nu=3, tolerance=1e-10)
        np.testing.assert_allclose(run.state[-1, 0:6:2] + rest, reported.y[:3, -1], atol=1e-11)


@pytest.mark.parametrize("geometry", ["small", "exact"])
def test_preloads_of_scenes(tmp_path, geometry):
    """Modes of the driver about the same static equilibrium, with balanced forces."""
    mounts = "".join(
        f"&mount_point name = 'm{i}', position = {p}, stiffness = 2e3 3e3 4e3, angles = 0.1 {i} 0,"
        " law_x = 'a + 1e4*d^3', law_z = 'a*exp(-d) + 1e5*d^2' /\n"
        for i, p in enumerate(["0.3 0 0.1", "-0.2 0.2 0", "-0.1 -0.3 -0.1"])
    )
    path = tmp_path / "scene.nml"
    path.write_text(
        f"&body mass = 2, inertia = 0.1 0.12 0.15, geometry = '{geometry}' /\n"
        + mounts + "&parameters a = 25 /\n&modes /\n"
    )  # fmt: skip
    scene = vv.Scene.read(path)
    body = scene.body()
    vv.run(scene).to_csv(tmp_path / "modes.csv")
    rows = [row for row in (tmp_path / "modes.csv").read_text().splitlines() if row[0].isdigit()]
    omega = [float(row.split(",")[1]) for row in rows]
    np.testing.assert_allclose(omega, body.modes().omega, rtol=1e-12)
    sag = body.sag()
    assert np.abs(sag.displacement).max() > 1e-3
    turn = np.eye(3)
    if geometry == "exact":
        turn = Rotation.from_rotvec(sag.displacement[3:6]).as_matrix()
    push = [mount.rotation @ f for mount, f in zip(body.mounts, sag.forces, strict=True)]
    arms = [turn @ np.asarray(mount.position) for mount in body.mounts]
    np.testing.assert_allclose(np.sum(push, axis=0), 0, atol=1e-8)
    np.testing.assert_allclose(np.sum(np.cross(arms, push), axis=0), 0, atol=1e-8)


def test_a_mount_made_anew_is_the_same():
    """The linear part of its law is added to its stiffness only once."""
    mount = vv.MountPoint(name="m", position=(0, 0, 0), stiffness=(1, 2, 3), law="5*d + d^3")
    other = dataclasses.replace(mount, damping=1.0)
    np.testing.assert_array_equal(other.static_stiffness, [6, 7, 8])
    np.testing.assert_array_equal(other.static_stiffness, mount.static_stiffness)


def test_a_mode_moves(tmp_path):
    """The box of the animation moves with the mode shape; files are animations."""
    from PIL import Image

    body = engine()
    film = body.animate_mode(5, tmp_path / "mode.gif", frames=4)
    with Image.open(tmp_path / "mode.gif") as written:
        assert written.n_frames == 4
    axis = film._fig.axes[0]
    boxes = []
    for frame in range(4):
        film._func(frame)
        boxes.append(np.array([line.get_data_3d() for line in axis.lines[-15:-3]]))
    np.testing.assert_allclose(boxes[0], boxes[2], atol=1e-12)
    assert "mode 5" in axis.get_title()
    u = body.modes().shapes[:, 4]
    moved = boxes[1] - boxes[0]
    # u + theta x p at the ends of all edges, up to a common factor.
    arms = boxes[0] - body.center[:, np.newaxis]
    true = u[:3, np.newaxis] + np.cross(u[3:], arms, axisb=1, axisc=1)
    factor = np.abs(moved).max() / np.abs(true).max()
    np.testing.assert_allclose(moved, factor * true, atol=1e-12)
    with pytest.raises(vv.InputError, match="mode = 7: must be"):
        body.animate_mode(7)
    with pytest.raises(vv.InputError, match=r"must end in \.gif"):
        body.animate_mode(1, tmp_path / "mode.png")


@pytest.mark.parametrize("seed", range(3))
def test_moments_of_mounts(seed):
    """Moment balance with mounts of rotational stiffness, and total dissipated power."""
    rng = np.random.default_rng(100 + seed)
    kernel = vv.PronyKernel(weights=[0.2, 0.3], rates=[5.0, 300.0])
    plain = random_body(rng, kernel=kernel, law=("2e10*d^3 + 1e7*d^2", None, "-1e9*d^3"))
    mounts = []
    for mount in plain.mounts:
        held = rng.uniform(50, 500, 3) * (rng.random(3) < 0.7)
        mounts.append(dataclasses.replace(mount, rotational_stiffness=tuple(held)))
    body = vv.Body(mass=plain.body_mass, inertia=plain.inertia, mounts=mounts)
    load = body.load(rng.normal(size=3) * 50, rng.normal(size=3) * 5, at=(0.1, -0.2, 0.3))
    nu = body.modes().omega[:3] * 1.02
    found = vv.forced_response(body, nu, load=load, method="newton")
    reported = body.mount_forces(found)
    assert np.abs(reported.moment).max() > 0
    for i in np.flatnonzero(found.converged):
        for k, order in enumerate(found.harmonics):
            left = -((order * nu[i]) ** 2) * body.mass @ found.coefficients[i, :, k]
            left = left - load * (order == 1)
            for j, mount in enumerate(body.mounts):
                force = mount.rotation @ reported.force[i, j, :, k]
                left[:3] += force
                left[3:] += np.cross(np.asarray(mount.position), force)
                left[3:] += mount.rotation @ reported.moment[i, j, :, k]
            assert np.abs(left).max() < 1e-8 * np.abs(load).max()
        rates = 1j * nu[i] * found.coefficients[i, :, np.flatnonzero(found.harmonics == 1)[0]]
        power = 0.5 * (load * rates.conj()).real.sum()
        lost = reported.lost_power[i].sum() + reported.lost_in_turning[i].sum()
        assert lost == pytest.approx(power, rel=1e-8)
    assert found.converged.any()


def engineers_mount(**given):
    return vv.MountPoint(**({"name": "m", "position": (0, 0, 0), "stiffness": (1, 1, 2e5)} | given))


def test_a_mount_in_other_units_is_the_same_mount():
    law, gap = "3*d^3 + 0.2*v*abs(v)", 4.0
    one = engineers_mount(
        position=(100, 200, -50), stiffness=(350, 370, 453), damping=(0.1, 0.2, 0.3),
        rotational_stiffness=(1e3, 0, 0), law=(None, None, law), gap=(None, None, gap),
        gap_stiffness=2000, units="N, mm",
    )  # fmt: skip
    assert np.asarray(one.position) == pytest.approx((0.1, 0.2, -0.05))
    assert np.asarray(one.stiffness) == pytest.approx((350e3, 370e3, 453e3))
    assert np.asarray(one.damping) == pytest.approx((100, 200, 300))
    assert np.asarray(one.rotational_stiffness) == pytest.approx((1, 0, 0))
    # Forces in N over deflections in mm.
    d = np.array([-9.0, -4.5, -1.0, 2.0, 4.0, 7.0])
    v = np.array([3.0, -2.0, 1.0, 0.5, -4.0, 2.0])
    stop = 2000 * (np.maximum(d - gap, 0) + np.minimum(d + gap, 0))
    force = one.laws[2](np.column_stack([d, v]) * 1e-3)[0]
    assert force == pytest.approx(3 * d**3 + 0.2 * v * abs(v) + stop, rel=1e-12)
    again = replace(one, damping=(1, 1, 1))
    assert again.laws[2].text == one.laws[2].text
    assert np.asarray(again.stiffness) == pytest.approx(np.asarray(one.stiffness))


@pytest.mark.parametrize("seed", range(3))
def test_a_table_is_interpolated(seed):
    rng = np.random.default_rng([48, seed])
    d = np.sort(rng.uniform(-5, 5, 12)) * 1e-3
    table = np.column_stack([d, np.cumsum(rng.uniform(0, 100, 12))])
    table[:, 1] -= np.interp(0, d, table[:, 1])
    mount = engineers_mount(stiffness=(1, 1, 0), law=(None, None, table))
    at = rng.uniform(d[0], d[-1], 40)
    force = mount.laws[2](np.column_stack([at, 0 * at]))[0]
    assert force == pytest.approx(np.interp(at, d, table[:, 1]), abs=1e-8)
    beyond = table[-1, 1] + 1e-3 * np.diff(table[-2:, 1])[0] / np.diff(d[-2:])[0]
    there = np.array([[d[-1] + 1e-3, 0.0]])
    assert mount.laws[2](there)[0] == pytest.approx(beyond, rel=1e-9)


def test_a_function_is_a_law():
    mount = engineers_mount(law=(None, None, lambda d, v: 1e5 * np.tanh(d / 1e-3) + 3 * v))
    at = np.array([[1e-3, 0.2], [-2e-3, 0.1]])
    exact = 1e5 * np.tanh(at[:, 0] / 1e-3) + 3 * at[:, 1]
    assert mount.laws[2](at)[0] == pytest.approx(exact, rel=1e-13)
    with pytest.raises(vv.InputError, match="has no form as a text"):
        engineers_mount(law=lambda d: d**3 * np.prod(np.ones(2)) + 0 * np.sum(d))


@pytest.mark.parametrize("eta", [0.02, 0.1, 0.4])
def test_a_loss_factor_is_that_of_a_complex_stiffness(eta):
    """Complex stiffness at the centre; its frequency dependence by Kramers-Kronig."""
    k, mass, low, high = 2e5, 20.0, 20.0, 2000.0
    mount = engineers_mount(stiffness=(k, k, k), loss_factor=eta, loss_band=(low, high))
    nu = np.geomspace(low, high, 60)
    stiffness = mount.dynamic_stiffness(nu)[:, 2]
    assert stiffness.imag / stiffness.real == pytest.approx(np.full(60, eta), rel=0.01)
    center = np.sqrt(low * high)
    at = mount.dynamic_stiffness(center)[2]
    assert at.real == pytest.approx(k, rel=1e-12)
    slope = np.gradient(np.log(stiffness.real), np.log(nu))[15:45]
    assert slope == pytest.approx(np.full(30, 2 / np.pi * np.arctan(eta)), rel=0.1)
    body = vv.Body(mass=mass, inertia=(1, 1, 1), mounts=[mount])
    found = vv.forced_response(body, [center], load=body.load((0, 0, 5)), method="linear")
    exact = 5 / abs(k * (1 + 1j * eta) - mass * center**2)
    assert found.amplitude("z")[0] == pytest.approx(exact, rel=0.01 * eta)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"loss_factor": 0.1}, "no causal equivalent; or give kernel= or damping="),
        ({"loss_factor": -0.1, "loss_band": (1, 2)}, "loss_factor = -0.1: must not be negative"),
        ({"loss_factor": 0.1, "loss_band": (2, 1)}, "loss_band: must be two numbers"),
        ({"gap": 0.01}, "gap = 0.01: needs gap_stiffness"),
        ({"gap": -1, "gap_stiffness": 1}, "gap = -1, gap_stiffness = 1: must not be negative"),
        ({"units": "mm"}, "units = 'mm': must be a force, N or kN, and a length"),
        ({"law": [[0, 0], [0, 1]]}, "deflections must increase"),
        ({"law": 3}, "law = 3: must be a str, a function, a table"),
    ],
)
def test_what_a_mount_lacks(given, text):
    with pytest.raises(vv.InputError) as error:
        engineers_mount(**given)
    assert text in str(error.value)


def test_a_free_body_keeps_its_momentum():
    body = vv.Body(mass=2.0, inertia=(1.0, 2.0, 2.5), mounts=[])
    assert body.modes().omega == pytest.approx(np.zeros(6), abs=1e-9)
    run = vv.simulate(body, 3.0, initial=[0, 1, 0, 2, 0, 3, 0, 0.1, 0, 0.2, 0, 0.3])
    assert run.state[-1, ::2] == pytest.approx([3, 6, 9, 0.3, 0.6, 0.9], rel=1e-9)
    r = vv.forced_response(body, [3.0], load=body.load((0, 0, 4)))
    assert r.amplitude("z")[0] == pytest.approx(4 / (2 * 9), rel=1e-12)
    with pytest.raises(vv.InputError, match="because a free body"):
        vv.Body(mass=2.0, inertia=(1.0, 2.0, 2.5), mounts=[], gravity=9.81)


def test_modes_with_a_long_relaxation_table():
    """The transform of a table to t = 1e5 s has no finite value at decaying motions."""
    times = np.concatenate([[0], np.logspace(-3, 5, 60)])
    kernel = vv.TabulatedKernel(times=times, values=0.005 * np.exp(-times / 1e4) / (0.01 + times))
    foot = vv.MountPoint(
        name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
        rotational_stiffness=(1e3, 1e3, 1e3), kernel=kernel,
    )  # fmt: skip
    body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot], gravity=None)
    with pytest.raises(vv.InputError, match=r"long .* \(pass kernel.sum_of_exponentials\(t_min="):
        body.modes()
    assert body.modes(stiffness="instantaneous").omega.size == 6
