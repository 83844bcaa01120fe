"""Sweeps on a cluster of processes: the same numbers, and workers that die."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv

distributed = pytest.importorskip("distributed")
PAPER = Path(__file__).parents[2] / "data" / "scenes" / "mount_paper.nml"
GRID = {"a": np.arange(5.0), "b": np.arange(4.0)}

#: A sweep on a separate cluster, which is interrupted.
CHILD = """
import sys, time, pathlib
import numpy as np, viscovib as vv
from distributed import Client, LocalCluster

def slow(x):
    time.sleep(0.05 if x < 20 else 30)
    return x

if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0") as cluster:
        with Client(cluster) as client:
            try:
                vv.sweep(slow, {"x": np.arange(100)}, client, sys.argv[1], progress=False, chunk=1)
            except KeyboardInterrupt:
                print("stopped", time.monotonic(), flush=True)
"""


def sweep(*arguments, **options):
    return vv.sweep(*arguments, progress=False, **options)


# Functions are sent to the workers by value: this file is not on their path.
def product(a, b):
    return {"y": a * b, "process": os.getpid()}


@pytest.fixture(autouse=True)
def _send_by_value():
    import cloudpickle

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    yield
    cloudpickle.unregister_pickle_by_value(sys.modules[__name__])


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


def test_a_point_that_fails_in_a_process_is_named_or_kept(client):
    def root(x):
        if x < 0:
            raise ValueError("negative")
        return x**0.5

    grid = {"x": np.array([4.0, -1.0, 9.0])}
    with pytest.raises(vv.SweepError, match=r"at x = -1.0: ValueError: negative"):
        sweep(root, grid, client)
    kept = sweep(root, grid, client, errors="keep")
    assert np.array_equal(kept.result.values, [2, np.nan, 3], equal_nan=True)


def test_a_worker_that_dies_is_replaced(client, tmp_path):
    marks = str(tmp_path)

    def mortal(x):
        mark = os.path.join(marks, f"{x}")
        if x in (2, 5) and not os.path.exists(mark):
            open(mark, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        return x * 10

    data = sweep(mortal, {"x": np.arange(8)}, client, tmp_path / "c", chunk=1)
    assert data.result.values.tolist() == [0, 10, 20, 30, 40, 50, 60, 70]
    assert sorted(os.listdir(marks)) == ["2", "5", "c"]


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
        with pytest.raises(
            vv.SweepError, match=r"x = 3.*the worker was lost at each of 2 attempts"
        ):
            sweep(deadly, grid, client, chunk=1, retries=1)
        assert len(Path(tries).read_text()) == 2
        # Under load a neighbouring point may be sent to a dying worker more than once.
        kept = sweep(deadly, grid, client, chunk=1, retries=3, errors="keep")
    # Neighbouring points on the same worker are not lost.
    outcomes = ["completed"] * 3 + ["lost"] + ["completed"] * 2
    assert kept.point_outcome.values.tolist() == outcomes
    assert "worker was lost" in kept.point_error.values[3]
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


def test_ctrl_c_leaves_the_cluster_and_a_checkpoint(start, tmp_path):
    script, folder = tmp_path / "child.py", tmp_path / "c"
    script.write_text(CHILD)
    child = start(
        [sys.executable, str(script), str(folder)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    outcomes = folder / "point_outcome" / "c"
    deadline = time.monotonic() + 60
    while not outcomes.exists() or len(list(outcomes.iterdir())) < 20:
        assert child.poll() is None, child.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    sent = time.monotonic()
    child.send_signal(signal.SIGINT)
    said = child.stdout.readline().split()
    assert said[0] == "stopped"
    assert float(said[1]) - sent < 1
    child.communicate(timeout=60)

    assert len(list(outcomes.iterdir())) >= 20


def test_what_is_no_running_client_is_reported(client):
    other = distributed.Client(client.cluster)
    other.close()
    with pytest.raises(vv.InputError, match="client: is closed, must be running"):
        sweep(product, GRID, other)
