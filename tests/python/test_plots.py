"""Plots: the drawn values are the computed values."""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
import viscovib as vv
from test_pendulum import P1R, START


def test_motion_has_a_history_and_a_phase_plane_a_coordinate():
    run = vv.simulate(vv.Pendulum(**P1R), 20, dt=0.25, initial=START)
    axes = vv.plot_trajectory([run, run], labels=["one", "two"])
    assert len(axes) == 6
    history, plane = axes[2].lines[0], axes[3].lines[0]
    assert (history.get_xydata() == np.column_stack([run.t, run.state[:, 2]])).all()
    assert (plane.get_xydata() == run.state[:, 2:4]).all()
    assert [text.get_text() for text in axes[0].get_legend().get_texts()] == ["one", "two"]
    plt.close("all")


def test_sections_as_plane_and_as_diagram():
    values = np.linspace(0.9, 1.0, 5)
    many = vv.simulate_ensemble(
        vv.Pendulum(**P1R), initial=START, n_periods=8, discard=3, dt=0.3, sections=1,
        parameters={"p1": values},
    )  # fmt: skip
    plane = vv.plot_sections(many, quantity="psi").lines[0]
    assert (plane.get_xdata() == many.sections[:, :, 4].ravel()).all()
    diagram = vv.plot_sections(many, parameter="p1", quantity="z").lines[0]
    assert (np.unique(diagram.get_xdata()) == values).all()
    assert (diagram.get_ydata() == many.sections[:, :, 0].ravel()).all()
    plt.close("all")


def test_what_cannot_be_drawn_is_reported():
    body = vv.Pendulum(**P1R)
    plain = vv.simulate_ensemble(body, initial=START, t_end=5, dt=0.5)
    with pytest.raises(vv.InputError, match="contains no sections"):
        vv.plot_sections(plain)
    cut = vv.simulate_ensemble(body, initial=START, n_periods=2, dt=0.5, sections=1)
    with pytest.raises(vv.InputError, match="parameter = 'p1'"):
        vv.plot_sections(cut, parameter="p1")
    with pytest.raises(vv.InputError, match="must not be empty"):
        vv.plot_trajectory([])
    run = vv.simulate(body, 1, dt=0.5, initial=START)
    with pytest.raises(vv.InputError, match="must be Axes"):
        vv.plot_trajectory(run, ax=[1, 2])


def test_a_harmonic_that_rounding_made_has_no_panel():
    """The spring of a swinging pendulum moves in even harmonics: its first is a rounding error."""
    swung = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.02, c2=0.02, c3=0.02, m01=0.005, p2=0.37
    )
    branch = vv.trace_response(swung, p2=(0.3, 0.45), harmonics=15, tolerance=1e-4, stability=False)
    assert [axis.get_ylabel().count("varphi") for axis in vv.plot_branch(branch)] == [1, 0]
    assert len(vv.plot_branch(branch, harmonic=2)) == 1
    plt.close("all")
