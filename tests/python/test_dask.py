"""Ensembles and sweeps on a cluster of processes: the numbers of threads; workers that die."""

import os
import pickle
import signal
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from viscovib.analyses import ensemble

cloudpickle = pytest.importorskip("cloudpickle")
distributed = pytest.importorskip("distributed")
PAPER = Path(__file__).parents[2] / "data" / "scenes" / "mount_paper.nml"
GRID = {"a": np.arange(5.0), "b": np.arange(4.0)}

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


def sweep(*arguments, **options):
    return vv.sweep(*arguments, progress=False, **options)


# Functions are sent to the workers by value: this file is not on their path.
def product(a, b):
    return {"y": a * b, "process": os.getpid()}


@pytest.fixture(autouse=True)
def _send_by_value():
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    yield
    cloudpickle.unregister_pickle_by_value(sys.modules[__name__])


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


def test_processes_give_what_threads_give(client):
    far = sweep(product, GRID, client, chunk=1)
    assert (far.y.values == np.outer(GRID["a"], GRID["b"])).all()
    assert os.getpid() not in far.process.values
    grid = {"mount.stiffness_x": [8.0, 10.0, 12.0]}
    here, there = sweep(PAPER, grid), sweep(PAPER, grid, client)
    assert np.array_equal(here.coefficients.values, there.coefficients.values, equal_nan=True)
    assert (here.outcome.values == there.outcome.values).all()


def test_functions_are_sent_once_and_timed_in_a_warm_worker(client, monkeypatch):
    numbers, submitted = np.arange(300_000.0), []
    submit = client.submit

    def counted(*given, **options):
        submitted.append(len(pickle.dumps(given[1:])))
        return submit(*given, **options)

    def slow_at_first(x):
        if not hasattr(os, "viscovib_was_here"):
            os.viscovib_was_here = True
            time.sleep(0.45)
        return numbers[int(x)]

    monkeypatch.setattr(client, "submit", counted)
    data = sweep(slow_at_first, {"x": np.arange(200.0)}, client)
    assert np.array_equal(data.result.values, np.arange(200.0))
    # The time of the first call in a process would give one point per piece.
    assert len(submitted) <= 20
    assert max(submitted) < 20_000


def test_a_function_that_the_workers_lack_is_reported(client, monkeypatch):
    module = types.ModuleType("nowhere_to_be_found")
    exec("def far(x):\n    return x", module.__dict__)
    monkeypatch.setitem(sys.modules, "nowhere_to_be_found", module)
    with pytest.raises(vv.InputError, match=r"cannot load the function .*nowhere_to_be_found"):
        sweep(module.far, {"x": [1.0]}, client)
    lock = threading.Lock()
    with pytest.raises(vv.InputError, match="cannot be sent"):
        sweep(lambda x: lock and x, {"x": [1.0]}, client)


def test_a_worker_that_dies_is_replaced(client, tmp_path):
    marks = str(tmp_path)

    def mortal(x):
        mark = os.path.join(marks, f"{x}")
        if x == 2 and not os.path.exists(mark):
            open(mark, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        return x * 10

    data = sweep(mortal, {"x": np.arange(8)}, client, tmp_path / "c", chunk=1)
    assert data.result.values.tolist() == [0, 10, 20, 30, 40, 50, 60, 70]
    assert sorted(os.listdir(marks)) == ["2", "c"]


def test_a_point_that_kills_every_worker_ends_in_a_line(client, tmp_path):
    tries = str(tmp_path / "tries")

    def deadly(x):
        if x == 3:
            with open(tries, "a") as file:
                file.write("+")
            os.kill(os.getpid(), signal.SIGKILL)
        return x

    import dask

    grid = {"x": np.arange(6)}
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        client.cluster.scheduler.allowed_failures = 0
        # Under load a neighbouring point may be sent to a dying worker more than once.
        kept = sweep(deadly, grid, client, chunk=1, retries=2, errors="keep")
    assert len(Path(tries).read_text()) == 3
    # Neighbouring points on the same worker are not lost.
    outcomes = ["completed"] * 3 + ["lost"] + ["completed"] * 2
    assert kept.point_outcome.values.tolist() == outcomes
    assert "the worker was lost at each of 3 attempts" in kept.point_error.values[3]
    assert np.isnan(kept.result.values[3])


def test_a_cluster_whose_workers_are_gone_does_not_let_one_wait_for_ever(monkeypatch):
    """Dead workers are not replaced, as on a machine without free memory."""
    from viscovib.common import cluster

    monkeypatch.setattr(cluster, "_LOOK", 0.01)
    monkeypatch.setattr(cluster, "_ALONE", 0.05)
    looks = iter([{"w": 1}] * 3)
    silent = types.SimpleNamespace(
        nthreads=lambda: next(looks, {}), status="running", scheduler_info=dict,
        register_plugin=lambda *_: None, unregister_worker_plugin=lambda *_: None,
        submit=lambda *_, **__: types.SimpleNamespace(
            key=object(), add_done_callback=lambda _: None, release=lambda: None
        ),
    )  # fmt: skip
    with pytest.raises(vv.ViscovibError, match="all its workers are gone"):
        sweep(product, {"a": np.arange(2.0), "b": np.arange(2.0)}, silent)


def test_ctrl_c_leaves_the_cluster_and_a_checkpoint(client, tmp_path):
    """The sweep ends while points are computed; the cluster continues to work."""
    gate, folder = tmp_path / "gate", tmp_path / "c"
    outcomes = folder / "point_outcome" / "c"
    gate.touch()
    name = str(gate)

    def slow(x):
        while x >= 20 and os.path.exists(name):
            time.sleep(0.01)
        return x

    def interrupt():
        while gate.exists() and not (outcomes.exists() and len(list(outcomes.iterdir())) >= 20):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    # If the sweep waits for its points, the test fails after four minutes.
    opener = threading.Timer(240, gate.unlink)
    sender = threading.Thread(target=interrupt)
    opener.start()
    sender.start()
    with pytest.raises(KeyboardInterrupt):
        sweep(slow, {"x": np.arange(40)}, client, folder, chunk=1)
    opener.cancel()
    assert gate.exists()
    gate.unlink()
    sender.join()
    assert len(list(outcomes.iterdir())) == 20
    assert sweep(product, GRID, client).y[4, 3] == 12


def test_what_is_no_running_client_is_reported(client):
    other = distributed.Client(client.cluster)
    other.close()
    with pytest.raises(vv.InputError, match="client: is closed, must be running"):
        sweep(product, GRID, other)
