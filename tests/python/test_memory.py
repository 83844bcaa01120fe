"""Peak memory: constant in steps and chunks; a response needs little more than its result.

Each job runs in its own process, first short, then long. The system reports the peak memory of
the process, which the long job must not raise.
"""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

HEAD = """
import resource, sys, tempfile, warnings
import numpy as np, viscovib as vv
warnings.simplefilter("ignore")
pend = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=.01, c2=.01, c3=.01, f0=.005, m01=.0025,
                   m02=.005, p1=.93, p2=.37, p3=.71)
start = (0.05, 0, 0.3, 0, -0.2, 0)
def mount():
    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    return vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel)
result = 0
for n in map(int, sys.argv[1:]):
"""
TAIL = """
r = data = None
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, result)
"""
JOBS = {
    "last state": 'vv.simulate(pend, 0.1*n, dt=0.1, initial=start, keep="last")',
    "tail": 'vv.simulate(pend, 0.1*n, dt=0.1, initial=start, keep="tail", tail=50)',
    "thinned": """
r = vv.simulate(pend, 0.1*n, dt=0.1, initial=start, save_every=n // 1000)
assert r.t.size == 1001
""",
    "ensemble": """
vv.simulate_ensemble(pend, initial=np.tile(start, (64, 1)), t_end=0.1*n, dt=0.1, method="rk4",
                     statistics=True, amplitudes_at=[0.93], n_threads=1)
""",
    "sweep on disk": """
with tempfile.TemporaryDirectory() as folder:
    data = vv.sweep(lambda a, b: np.full(4000, a*b), {"a": np.arange(n), "b": np.arange(10.)},
                    checkpoint=folder + "/c", chunk=10, n_threads=2, progress=False)
    assert data.sizes["a"] == n
""",
    "ensembles in chunks": """
def swing(phi, psi):
    states = np.zeros((phi.size, 6))
    states[:, 2], states[:, 4] = phi, psi
    return vv.simulate_ensemble(pend, initial=states, t_end=0.5, dt=0.5, n_threads=1).state
with tempfile.TemporaryDirectory() as folder:
    vv.sweep(swing, {"phi": np.linspace(-1, 1, n), "psi": np.linspace(-1, 1, 512)},
             checkpoint=folder + "/c", vectorized=True, chunk=1024, n_threads=2, progress=False)
""",
}
#: Short and long, in steps or in values of the first parameter.
LENGTHS = {
    "last state": (20_000, 200_000),
    "tail": (20_000, 200_000),
    "thinned": (20_000, 200_000),
    "ensemble": (5_000, 20_000),
    "sweep on disk": (5, 25),
    "ensembles in chunks": (20, 200),
}
#: Overhead of the allocator, far below the memory of stored states.
ROOM = 4 * 2**20


def peaks(job, *lengths):
    """Peak memory after the job of each length, and the recorded result."""
    # Started by a shell, because the peak of a process includes that of its parent, and the test
    # process is large.
    program = HEAD + textwrap.indent(job + TAIL, "    ")
    command = ["sh", "-c", '"$@"; exit $?', "sh", sys.executable, "-c", program]
    command += map(str, lengths)
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return [tuple(map(int, line.split())) for line in done.stdout.splitlines()]


@pytest.mark.parametrize("name", JOBS)
def test_the_peak_is_flat(name):
    (short, _), (long, _) = peaks(JOBS[name], *LENGTHS[name])
    assert long - short < ROOM


def test_what_is_kept_shows():
    """Check of the method: stored states are visible in the peak."""
    ballast = np.ones(2**25)
    keep = JOBS["last state"].replace('"last"', '"all"')
    (short, _), (long, _) = peaks(keep, *LENGTHS["last state"])
    assert long - short > 180_000 * 7 * 8
    assert short < ballast.nbytes


@pytest.mark.parametrize("method", ["linear", "successive"])
def test_a_response_takes_little_more_than_its_result(method):
    job = f"""
r = vv.forced_response(mount(), np.linspace(0.3, 12, n), load=0.02, method="{method}")
result = sum(a.nbytes for a in (r.nu, r.coefficients, r.outcome, r.iterations, r.rate))
"""
    (short, small), (long, large) = peaks(job, 10_000, 80_000)
    assert long - short < 2.5 * (large - small) + ROOM
