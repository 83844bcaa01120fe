"""Accelerations under shocks and run-ups, by SciPy; shock spectra, by matrix exponentials.

Some of the calls are scenes.
"""

import itertools

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from referee.case import Case, Claim, even, few, numbers
from referee.integration import solve_ivp

JUDGES = (
    "RunUp", "shock_response_spectrum", "ShockResponseSpectrum", "ShockResponseSpectrum.maximax",
    "Trajectory.acceleration", "Trajectory.relative_to_base",
)  # fmt: skip
KINDS = ("absolute_acceleration", "relative_displacement", "pseudo_velocity")
PARTS = ("primary_positive", "primary_negative", "residual_positive", "residual_negative")
_RUN = """import pathlib, tempfile
with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder) / "scene.nml"
    path.write_text(text)
    result = vv.run(path)
"""
#: Samples of a period between which there is at most one extreme.
DENSE = 40


def _spectrum(times, values, hz, zeta, kind):
    """Extremes of one oscillator: matrix exponentials of (x, x', a, a'), extremes by Brent."""
    w = 2 * np.pi * hz
    matrix = np.zeros((4, 4))
    matrix[0, 1] = matrix[2, 3] = 1.0
    matrix[1, :3] = -(w**2), -2 * zeta * w, -1.0
    shown = np.array([w ** (kind == KINDS[2]), 0.0, 0.0, 0.0])
    if kind == KINDS[0]:
        shown = np.array([-(w**2), -2 * zeta * w, 0.0, 0.0])
    rate = shown @ matrix
    ends = [*np.diff(times), 1 / (hz * np.sqrt(1 - zeta**2))]
    levels = [*itertools.pairwise(values), (0.0, 0.0)]
    state, found = np.zeros(2), np.zeros(4)
    for part, (h, (a, b)) in enumerate(zip(ends, levels, strict=True)):
        late = 2 * (part == len(ends) - 1)
        m = max(4, int(np.ceil(h * hz * DENSE)))
        step = expm(matrix * (h / m))
        points = [np.array([*state, a, (b - a) / h])]
        for _ in range(m):
            points.append(step @ points[-1])
        at = np.array(points)
        q, slope = at @ shown, at @ rate
        found[late] = max(found[late], q.max())
        found[late + 1] = max(found[late + 1], -q.min())
        for i in np.flatnonzero(slope[1:] * slope[:-1] < 0):
            size, sign = max(abs(q[i]), abs(q[i + 1])), int(slope[i] < 0)
            # The value between two points is at most a little larger.
            if size * 1.02 < found[late + sign]:
                continue
            top = brentq(lambda t, i=i: rate @ expm(matrix * t) @ at[i], 0.0, h / m, xtol=1e-15)
            value = (shown @ expm(matrix * top) @ at[i]) * (1 - 2 * sign)
            found[late + sign] = max(found[late + sign], value)
        state = at[-1, :2]
    return found


def _listed(values):
    """Numbers of a scene."""
    return "\n  ".join(repr(float(one)) for one in np.ravel(values))


def _of_records(rng, index):
    n = int(rng.integers(2, 12)) if index % 4 else int(rng.integers(150, 400))
    values = (rng.standard_normal(n) * 10.0 ** rng.uniform(-2, 2)).round(6)
    if index % 8 == 4:
        values = np.sin(rng.uniform(0.05, 1.5) * np.arange(n)).round(6)
    times = np.round(np.append(0.0, np.cumsum(rng.uniform(0.05, 0.3, n - 1))), 4)
    if index % 2 == 0:
        times = 0.1 * np.arange(n)
    hz = np.sort(10.0 ** rng.uniform(-1.5, 0.6 if n > 100 else 1.3, 3)).round(6)
    zeta, kind = float(rng.choice([0.0, even(rng, 0, 0.2), even(rng, 0, 0.95)])), KINDS[index % 3]
    # From 0, or the reference may miss a tiny extreme soon after the start.
    values[0] = 0.0
    call = f"""record = vv.LoadTable(times={numbers(times)}, values={numbers(values)})
found = vv.shock_response_spectrum(record, {numbers(hz)}, damping={zeta}, kind={kind!r})
"""
    if index % 5 == 3:
        text = f"""&system coordinates='x' mass=1 stiffness=1 /
&load shape='step' amplitude=1 /
&transient t_end=1 dt=0.1 /
&shock_spectrum times={_listed(times)} values={_listed(values)}
  frequencies={_listed(hz)} damping={zeta} kind='{kind}' /
"""
        call = f"text = {text!r}\n{_RUN}found = result.shock_spectrum\n"
    call += f"""parts = np.array([getattr(found, name) for name in {PARTS}])
maximax = found.maximax
"""

    def judge(names, reported):
        true = np.array([_spectrum(times, values, one, zeta, kind) for one in hz]).T
        yield Claim("extremes", names["parts"], true, 1e-9 * true.max(axis=0))
        yield Claim("maximax", names["maximax"], true.max(axis=0), 1e-9 * true.max(axis=0))

    return Case(call, judge)


def _of_runs(rng, index):
    """Two masses on a moving base: springs with a cubic term, and memory of one exponential."""
    m, k = rng.uniform(0.5, 2, 2).round(3), rng.uniform(50, 300, 3).round(1)
    c, cubic = rng.uniform(0.1, 2, 2).round(3), few(rng, 1e2, 1e5, 3)
    weight, rate = (few(rng, 0.1, 3, 2), few(rng, 4, 20, 2)) if index % 2 else (0.0, 1.0)
    height, length, start = few(rng, 1, 80, 2), few(rng, 0.02, 0.5, 2), even(rng, 0, 0.3, 2)
    mass, damping = np.diag(m), np.diag(c)
    stiffness = np.array([[k[0] + k[1], -k[1]], [-k[1], k[1] + k[2]]])
    kernel = f", kernel=vv.PronyKernel(weights=[{weight}], rates=[{rate}])" if weight else ""
    call = f"""system = vv.PolynomialSystem(
    mass={numbers(mass)}, damping={numbers(damping)}, stiffness={numbers(stiffness)},
    forces={{"x1": "{cubic!r}*x1^3"}}, base_direction=[1, 1]{kernel},
)
shock = vv.HalfSine(amplitude={height}, duration={length}, start={start})
run = vv.simulate(system, 1.5, base_acceleration=shock, initial=[0.01, 0, 0, 0.1], tolerance=1e-9)
"""
    if index % 3 == 1:
        text = f"""&system coordinates='x1' 'x2' mass={_listed(m)} damping={_listed(c)}
  stiffness={_listed(stiffness)} base_direction=1 1 /
&force on='x1' law='{cubic!r}*x1^3' /
&load kind='acceleration' shape='half_sine' amplitude={height} duration={length} start={start} /
&transient t_end=1.5 tolerance=1e-9 initial=0.01 0 0 0.1 acceleration='yes' /
"""
        if weight:
            text += f"&kernel kind='prony' weights={weight} rates={rate} /\n"
        call = f"text = {text!r}\n{_RUN}run = result.trajectory\n"
    call += """t, a, error, relative = run.t, run.acceleration, run.error, run.relative_to_base
"""

    def judge(names, reported):
        def force(u):
            return stiffness @ u + np.array([cubic * u[0] ** 3, 0.0])

        def base(t):
            inside = start <= t < start + length
            return height * np.sin(np.pi * (t - start) / length) * inside

        def second(t, y):
            # y[4:] are the forces that the springs have relaxed by.
            return np.linalg.solve(mass, y[4:] - force(y[:2]) - damping @ y[2:4]) - base(t)

        def right(t, y):
            relaxed = weight * force(y[:2]) - rate * y[4:]
            return np.concatenate([y[2:4], second(t, y), relaxed])

        y, wanted = np.array([0.01, 0.0, 0.0, 0.1, 0.0, 0.0]), []
        t, cuts = names["t"], [0.0, start, start + length, 1.5]
        for begin, end in itertools.pairwise(cuts):
            if end <= begin:
                continue
            # The base at the end of a part is that before it.
            here = t[(t >= begin) & (t < end)] if end < 1.5 else t[t >= begin]
            path = solve_ivp(right, (begin, end), y, "DOP853", rtol=1e-12, atol=1e-14,
                             dense_output=True, max_step=(end - begin) / 8)  # fmt: skip
            wanted += [second(at, path.sol(at)) + base(at) for at in here]
            y = path.y[:, -1]
        true = np.array(wanted)
        # The error of a state times the largest change of forces with it.
        gain = np.abs(stiffness).sum() / m.min() + 3 * cubic * 0.3**2 / m.min() + c.max() / m.min()
        yield Claim("accelerations", names["a"], true, gain * names["error"] + 1e-7, 10.0, 1e-3)
        yield Claim("relative", names["relative"], True)

    return Case(call, judge)


def _of_run_ups(rng, index):
    """A rotor with an anisotropic spring and a cubic one: run-up or coast-down, and after it."""
    k, c = rng.uniform(50, 200, 2).round(2), rng.uniform(0.2, 2, 2).round(3)
    cubic = few(rng, 1, 1e3)
    speed = np.sort(rng.uniform(0, 30, 2).round(2))[:: rng.choice([1, -1])]
    u, duration, hold = few(rng, 1e-3, 0.05), even(rng, 1, 4, 2), even(rng, 0, 1, 2)
    start, phase = even(rng, 0, 0.5, 2), even(rng, -3, 3)
    call = f"""rotor = vv.PolynomialSystem(
    mass=np.eye(2), stiffness=np.diag({numbers(k)}), damping=np.diag({numbers(c)}),
    forces={{x: f"{cubic!r}*(x1^2 + x2^2)*{{x}}" for x in ("x1", "x2")}},
)
load = vv.RunUp(
    unbalance=[{u}, {u}j], speed={numbers(speed)}, duration={duration}, hold={hold},
    start={start}, phase={phase},
)
run = vv.simulate(rotor, {start + duration + hold + 1}, force=load, tolerance=1e-9)
state, error = run.state[-1, [0, 2, 1, 3]], run.error
"""
    slope = (speed[1] - speed[0]) / duration

    def judge(names, reported):
        y = np.zeros(4)
        cuts = start + np.cumsum([0.0, duration, hold, 1.0])
        for part, (begin, end) in enumerate(itertools.pairwise(cuts)):

            def right(t, y, part=part):
                early = duration if part else t - start
                rate = speed[0] + slope * early
                phi = phase + (speed[0] + rate) / 2 * early + speed[1] * (t - start - early)
                force = u * (rate**2 - (0 if part else 1j * slope)) * np.exp(1j * phi)
                push = np.array([force.imag, force.real]) * (part < 2)
                return np.append(y[2:], push - (k + cubic * (y[:2] @ y[:2])) * y[:2] - c * y[2:])

            if end > begin:
                y = solve_ivp(right, (begin, end), y, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        yield Claim("state", names["state"], y, names["error"] + 1e-11, 10.0)

    return Case(call, judge)


def case(rng, index):
    """Draw a record or a motion."""
    return (_of_records, _of_records, _of_runs, _of_run_ups)[index % 4](rng, index // 4)
