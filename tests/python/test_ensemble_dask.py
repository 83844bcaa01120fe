"""Ensembles on a cluster of processes give the numbers of threads, to the last bit."""

import numpy as np
import pytest
import viscovib as vv

distributed = pytest.importorskip("distributed")

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


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


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
