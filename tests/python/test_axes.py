"""Axes of plots: units, gaps in lines, and omitted coordinates."""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
import viscovib as vv
from viscovib.plots.axes import jumps_of

SCENES = Path(__file__).parents[2] / "data" / "scenes"


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def response():
    mount = vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
        damping=[[0.2, 0], [0, 0.05]],
    )  # fmt: skip
    return vv.forced_response(mount, np.linspace(0.5, 12, 300), base=1e-3)


def test_hertz_decibels_and_phases(response):
    x, _ = vv.plot_response(response, x="hz", y="db", reference=1e-3)
    assert np.array_equal(x.lines[0].get_xdata(), response.nu / (2 * np.pi))
    want = 20 * np.log10(response.amplitude("x") / 1e-3)
    np.testing.assert_allclose(x.lines[0].get_ydata(), want, rtol=1e-12)
    assert x.get_ylabel() == "$|x_{1}|$ (dB re 0.001 m)"
    assert x.figure.axes[-1].get_xlabel() == "frequency of the load (Hz)"
    (line, *_) = vv.plot_response(response, y="phase")[0].lines
    shown = line.get_ydata()
    shown = shown[np.isfinite(shown)]
    np.testing.assert_allclose(shown, np.degrees(response.phase("x")))
    for wrong in ({"x": "Hz"}, {"y": "dB"}, {"reference": 0}):
        with pytest.raises(vv.InputError, match=f"{next(iter(wrong))} = .*: must be"):
            vv.plot_response(response, **wrong)


def test_other_plots_know_the_same_arguments():
    branch = vv.run(SCENES / "mount_branch.nml").value
    x, _ = vv.plot_branch(branch, x="hz", y="db")
    folds = next(line for line in x.lines if line.get_label() == "fold")
    np.testing.assert_allclose(folds.get_xdata(), branch.folds / (2 * np.pi))
    np.testing.assert_allclose(
        folds.get_ydata(), 20 * np.log10(abs(branch.fold_coefficients[:, 0, 0]))
    )
    b = vv.run(SCENES / "mount_backbone.nml").value
    line = vv.plot_backbone(b, x="hz", y="log")[1].lines[0]
    assert np.array_equal(line.get_xdata(), b.nu / (2 * np.pi))
    t = 0.01 * np.arange(4096)
    s = vv.spectrum(np.sin(12 * t), 0.01)
    ax = vv.plot_spectrum(s, x="hz", y="db", bases={"p": 12.0})
    assert ax.lines[0].get_xdata()[np.nanargmax(ax.lines[0].get_ydata())] == pytest.approx(
        12 / (2 * np.pi), abs=0.03
    )
    with pytest.raises(vv.InputError, match="y = 'phase'"):
        vv.plot_spectrum(s, y="phase")
    scales = vv.run(SCENES / "mount_scales.nml").value
    line = vv.plot_scales_response(scales, x="hz", y="db")[0].lines[0]
    assert np.array_equal(line.get_xdata(), scales.at / (2 * np.pi))


def test_no_line_crosses_a_jump():
    r = vv.run(SCENES / "mount_resonance.nml").value
    (place,) = np.flatnonzero(jumps_of(r.coefficients))
    assert r.nu[place] == pytest.approx(1.8, abs=0.02)
    (line,) = vv.plot_response(r)[0].lines
    assert np.isnan(line.get_ydata()[place + 1])
    assert np.isfinite(line.get_ydata()).sum() == r.nu.size


def test_no_smooth_curve_is_torn():
    # Linear responses never jump, even with light damping and on a coarse grid.
    draw = np.random.default_rng(5)
    for _ in range(200):
        n = int(draw.integers(1, 4))
        root = draw.normal(size=(n, n))
        system = vv.PolynomialSystem(
            mass=np.eye(n), stiffness=root @ root.T + 0.1 * np.eye(n),
            damping=10 ** draw.uniform(-6, 0) * np.eye(n),
        )  # fmt: skip
        nu = np.sort(draw.uniform(0.05, 4, int(draw.integers(5, 300))))
        nu = np.linspace(nu[0], nu[-1], nu.size)
        r = vv.forced_response(system, nu, load={1: np.ones(n)}, method="linear")
        assert not jumps_of(r.coefficients).any()


def test_coordinates_at_rest_have_no_panel():
    rest = vv.Pendulum(e=0.1, w2=0.53, w3=0.9, alpha=0.5, c1=0.05, c2=0.05, c3=0.05, f0=0.002)
    branch = vv.trace_response(rest, p1=(0.9, 1.0), harmonics=5)
    assert len(vv.plot_branch(branch)) == 1
    # If axes for all coordinates are given, all are drawn.
    _, axes = plt.subplots(3, 1)
    assert len(vv.plot_branch(branch, axes)) == 3


def test_logarithmic_labels_have_room(response):
    part = vv.forced_response(response_mount(), np.linspace(0.5, 1.4, 50), base=1e-3)
    axis = vv.plot_response(part)[0]
    axis.figure.canvas.draw()
    named = [text for text in axis.get_yticklabels(minor=True) if text.get_text()]
    assert len(named) <= 4


def response_mount():
    return vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
                    damping=[[0.2, 0], [0, 0.05]])  # fmt: skip


def test_steady_motions_are_lines_without_lone_points():
    r = vv.run(SCENES / "pendulum_scales.nml").value
    lines = vv.plot_scales_response(r)[0].lines
    assert all(line.get_xdata().size > 1 for line in lines)
    # Only computed motions are drawn.
    for line in lines:
        y = line.get_ydata()
        assert np.isin(y[np.isfinite(y)], r.amplitude("z")).all()
