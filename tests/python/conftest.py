"""Shared fixtures: the reference scene of the mount, processes that are killed after their test."""

import signal
import subprocess

import hypothesis
import pytest
import viscovib as vv

# The same inputs in each run, without a deadline on busy machines.
hypothesis.settings.register_profile("viscovib", deadline=None, derandomize=True)
hypothesis.settings.load_profile("viscovib")

# As background processes of a shell, these tests and their children would ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def start():
    """Start a process as `subprocess.Popen` does; killed if it outlives its test."""
    children = []

    def popen(*arguments, **options):
        children.append(subprocess.Popen(*arguments, **options))
        return children[-1]

    yield popen
    for child in children:
        child.kill()
        child.communicate()


@pytest.fixture
def mount():
    """Build the reference mount with any parameter changed."""

    def build(amplitude=0.048, **changes):
        kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=0.1, beta=0.05)
        parameters = {
            "mass": 1.0,
            "inertia": 0.1,
            "offset": 0.5,
            "stiffness_x": 10.0,
            "stiffness_phi": 2.0,
            "kernel": kernel,
        }
        return vv.Mount(**(parameters | changes))

    return build


@pytest.fixture(scope="module")
def client():
    """Client of a Dask cluster of two processes."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
