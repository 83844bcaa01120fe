"""Ensembles on a cluster of processes give the numbers of threads, to the last bit."""

import pickle

import numpy as np
import pytest
import viscovib as vv
from viscovib.analyses import ensemble

cloudpickle = pytest.importorskip("cloudpickle")

PENDULUM = vv.Pendulum(
    e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
)
STOP = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="10*max(x - 0.2, 0)")
LAYER = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="0.05*tanh(2000*x)")
HEREDITARY = vv.Mount(
    mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
    kernel=vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05),
)  # fmt: skip
LOAD = {"load": {1: 0.1}, "nu": 0.9}
STATES = 0.1 * np.random.default_rng(2).standard_normal((24, 6))
ARRAYS = (
    "t_reached", "state", "outcome", "step", "peak", "mean", "rms", "amplitudes", "sections",
    "lyapunov", "lyapunov_error", "error", "section_error", "amplitude_error", "section_times",
)  # fmt: skip


@pytest.mark.parametrize(
    ("system", "options"),
    [
        (PENDULUM, {"initial": STATES, "t_end": 20.0, "statistics": True, "lyapunov": True}),
        (
            PENDULUM,
            {"initial": STATES[0], "n_periods": 4, "sections": 1, "amplitudes_at": [1.02],
             "parameters": {"p1": np.linspace(0.9, 1.1, 20)}, "dt": 0.1},
        ),
        (STOP, {"initial": STATES[:, :2], "t_end": 9.0, "sections": "x_dot", **LOAD}),
        (LAYER, {"initial": STATES[:12, :2], "t_end": 4.0, "statistics": True, **LOAD}),
        (HEREDITARY, {"initial": STATES[:6, :4], "t_end": 3.0, "tolerance": 1e-6}),
    ],
)  # fmt: skip
def test_a_cluster_gives_what_threads_give(client, system, options):
    here = vv.simulate_ensemble(system, **options)
    there = vv.simulate_ensemble(system, **options, client=client)
    for name in ARRAYS:
        one, other = getattr(here, name), getattr(there, name)
        assert (one is None) == (other is None), name
        if one is not None:
            np.testing.assert_array_equal(one, other, err_msg=name)


class Forgetful:
    """A cluster with a new worker for each piece, which knows nothing of earlier step sizes."""

    threads = 2

    def __init__(self, function, *_):
        self.data, self.done = cloudpickle.dumps(function), []

    def submit(self, i, *given):
        self.done.append((i, pickle.loads(self.data)(*given)))

    def next(self):
        return self.done.pop()

    def close(self):
        pass


@pytest.mark.parametrize("statistics", [False, True])
def test_workers_receive_what_earlier_step_sizes_have_found(monkeypatch, statistics):
    """A run that once needs partial steps has them with all step sizes, wherever it is computed."""
    given = {"initial": STATES[:12, :2], "t_end": 4.0, "statistics": statistics, **LOAD}
    here = vv.simulate_ensemble(LAYER, **given)
    monkeypatch.setattr(ensemble, "Cluster", Forgetful)
    there = vv.simulate_ensemble(LAYER, **given, client="any")
    np.testing.assert_array_equal(here.state, there.state)
    assert here.error == there.error


def test_errors_of_workers_and_arguments_are_those_of_threads(client):
    start = {"initial": STATES[:, :2], "t_end": 9.0}
    chaotic = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.05, forces="x^3")
    strong = {"load": {1: 5.0}, "nu": 1.0, "initial": STATES[:4, :2], "t_end": 800.0}
    with pytest.raises(vv.InputError, match="may be chaotic"):
        vv.simulate_ensemble(chaotic, **strong, client=client)
    with pytest.raises(vv.InputError, match="n_threads: is for threads of this process"):
        vv.simulate_ensemble(STOP, **start, n_threads=2, client=client)
    with pytest.raises(vv.InputError, match=r"must be a dask.distributed.Client"):
        vv.simulate_ensemble(STOP, **start, client="tcp://nowhere")
