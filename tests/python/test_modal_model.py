"""Reduced structures in modal coordinates, against the full structures."""

import numpy as np
import pytest
import scipy.sparse as sp
import viscovib as vv

KERNEL = vv.PronyKernel(weights=[0.2, 0.1], rates=[0.5, 4.0])


def chain(n, elements, **more):
    k = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tocsr() * 200.0
    return vv.Structure(mass=sp.eye_array(n), stiffness=k, elements=elements, **more)


ELEMENTS = {
    "friction": [vv.Jenkins(on="x20", stiffness=50.0, limit=0.3)],
    "gap": [vv.Gap(on=("x20", "x10"), stiffness=100.0, gap=0.01)],
    "stop": [vv.Gap(on="x12", gap=0.05, restitution=0.5), vv.Spring(on="x20", damping=0.3)],
    "memory": [
        vv.Spring(on="x20", stiffness=20.0, law="5*d^3", kernel=KERNEL),
        vv.Gap(on="x12", stiffness=100.0, gap=0.05),
    ],
    "coupling": [
        vv.Coupling(on={"a": "x20", "b": {"x3": 1.0}}, law={"a": "3*a*b^2", "b": "3*a^2*b"}),
        vv.Dahl(on="x12", stiffness=20.0, limit=0.2),
    ],
}


@pytest.mark.parametrize("kind", ELEMENTS)
def test_as_the_whole_structure(kind):
    """All modes of a small structure are kept: only rounding and steps differ."""
    bar = chain(24, ELEMENTS[kind], rayleigh=(0.05, 1e-3))
    modal = bar.reduce(frequency=40.0, loads=["x5"], tolerance=1e-10).in_modes()
    whole = vv.Structure(
        mass=np.eye(24), stiffness=bar.stiffness.toarray(), rayleigh=(0.05, 1e-3),
        elements=ELEMENTS[kind],
    )  # fmt: skip
    u, v = np.random.default_rng(3).normal(size=(2, 24)) * 0.01
    run = vv.simulate(
        modal.structure, 6, load=modal.load({"x5": 2.0}), nu=2.5, initial=modal.start(u, v),
        tolerance=1e-9,
    )  # fmt: skip
    assert run.complete
    start = np.stack([u, v], axis=1).ravel()
    other = vv.simulate(
        whole, 6, load={"x5": 2.0}, nu=2.5, initial=start, tolerance=1e-9, times=run.t
    )
    np.testing.assert_allclose(modal.displacements(run.state), other.state[:, ::2], atol=1e-8)
    np.testing.assert_allclose(
        modal.velocities(run.state, ["x3", "x20"]), other.state[:, [5, 39]], atol=1e-7
    )


def test_few_modes_of_many():
    """The stated error of the reduction is valid, where steps end at corners."""
    elements = [
        vv.Gap(on="x150", stiffness=2.0, gap=0.02),
        vv.Jenkins(on="x80", stiffness=3.0, limit=0.05),
    ]
    bar = chain(150, elements, rayleigh=(0.02, 1e-3))
    runs = []
    for tolerance, frequency in ((1e-5, 2.0), (1e-7, 4.0)):
        modal = bar.reduce(frequency=frequency, loads=["x40"], tolerance=tolerance).in_modes()
        assert modal.structure.n_coordinates < 75
        assert modal.error <= tolerance
        run = vv.simulate(
            modal.structure, 20, load=modal.load({"x40": 0.3}), nu=0.4, tolerance=1e-8,
            times=np.linspace(0, 20, 50),
        )  # fmt: skip
        assert run.error < 1e-8
        runs.append(modal.displacements(run.state, ["x40", "x80", "x150"]))
    assert np.abs(runs[1][:, 1:]).max() > 0.05
    assert np.abs(runs[0] - runs[1]).max() < 1e-3 * np.abs(runs[1]).max()


def test_layers_and_steady_motions():
    """Layers with memory in modal coordinates; a steady motion against the full structure."""
    k = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(12, 12)).tocsr()
    elements = [vv.Gap(on="x12", stiffness=100.0, gap=0.01)]
    bar = chain(12, elements, rayleigh=(0.05, 2e-3), layers=[(40.0 * k, KERNEL)])
    modal = bar.reduce(frequency=40.0, loads=["x5"], tolerance=1e-10).in_modes()
    reported = vv.steady_motion(modal.structure, 2.5, load=modal.load("x5"))
    whole = vv.Structure(
        mass=np.eye(12), stiffness=bar.stiffness.toarray(), rayleigh=(0.05, 2e-3),
        elements=elements, layers=[(40.0 * k.toarray(), KERNEL)],
    )  # fmt: skip
    other = vv.steady_motion(whole, 2.5, load={"x5": 1.0})
    assert reported.outcome == other.outcome == "converged"
    u = modal.displacements(reported.state[0])
    np.testing.assert_allclose(u, other.state[0][::2], atol=1e-9)
    np.testing.assert_allclose(reported.multipliers[:4], other.multipliers[:4], atol=1e-8)


def test_refused():
    bar = chain(24, ELEMENTS["gap"])
    with pytest.raises(vv.InputError, match="is not reduced"):
        bar.in_modes()
    modal = bar.reduce(frequency=4.0, loads=["x5"]).in_modes()
    with pytest.raises(vv.InputError, match="x99"):
        modal.load({"x99": 1.0})
    with pytest.raises(vv.InputError, match="24 numbers"):
        modal.load([1.0, 2.0])
    with pytest.raises(vv.InputError, match="columns"):
        modal.displacements([1.0, 2.0])
    with pytest.raises(vv.InputError, match="x99"):
        modal.displacements(np.zeros(2 * modal.shapes.shape[1]), ["x99"])
    with pytest.raises(vv.InputError, match=r"shape \(24,\)"):
        modal.start([1.0])
    lossy = chain(24, ELEMENTS["gap"], loss_factor=0.1).reduce(frequency=4.0, loads=["x5"])
    with pytest.raises(vv.InputError, match="loss_factor"):
        lossy.in_modes()
    sliding = chain(24, ELEMENTS["friction"]).reduce(frequency=4.0, loads=["x5"])
    with pytest.raises(vv.InputError, match=r"use structure.in_modes\(\)"):
        vv.simulate(sliding, 1.0)
