"""A scene by Python (bitwise equal) and the table of the standalone driver."""

import numpy as np

from referee.case import Case, Claim, even, few

JUDGES = (
    "Scene", "Scene.read", "Scene.override", "Scene.is_pendulum", "Scene.pendulum",
    "Scene.oscillator", "Scene.polynomial_system", "Scene.structure", "Scene.mount", "Scene.loads", "Scene.nu",
    "Scene.sweep_grid", "SceneResult", "SceneResult.kind", "SceneResult.response",
    "SceneResult.branch", "SceneResult.backbone", "SceneResult.sweep", "SceneResult.steady",
    "SceneResult.trajectory", "SceneResult.to_csv", "SceneResult.plan", "run", "plan",
    "plan_response", "Plan", "Plan.computes", "Plan.skips", "FileError",
)  # fmt: skip
SAME = 1e-300
_BEGIN = """import os, pathlib, tempfile
folder = pathlib.Path(tempfile.mkdtemp())
path = folder / "scene.nml"
path.write_text(text)
scene = vv.Scene.read(path)
result = vv.run(scene)
kind, plan, reported = result.kind, str(vv.plan(scene)), str(result.plan)
result.to_csv(folder / "table.csv")
lines = [line for line in open(folder / "table.csv") if line[0] != "#"]
table = np.genfromtxt(lines, delimiter=",", names=True)
"""
_END = "import shutil\nshutil.rmtree(folder)\n"


def _mount(rng):
    m, inertia, cx, cphi = (
        even(rng, 0.5, 2, 3),
        even(rng, 0.05, 0.2, 2),
        even(rng, 5, 15, 3),
        even(rng, 1, 4, 2),
    )
    c = few(rng, 0.01, 0.1, 2)
    size, phase = few(rng, 0.02, 0.5, 2), even(rng, -1, 1, 2)
    text = (
        f"&mount mass = {m}, inertia = {inertia}, offset = 0.5, stiffness_x = {cx}, stiffness_phi = {cphi},\n"
        f" damping = {c}, 0, 0, {c / 10} /\n&load amplitude = {size}, phase = {phase} /\n"
    )
    python = (
        f"system = vv.Mount(mass={m}, inertia={inertia}, offset=0.5, stiffness_x={cx}, stiffness_phi={cphi},\n"
        f"    damping=[[{c}, 0], [0, {c / 10}]])\n"
        f"load = {{1: np.array([1.0, 0.0]) * ({size} * complex(np.cos({phase}), np.sin({phase})))}}\n"
    )
    return text, python


def _response(rng, index):
    text, python = _mount(rng)
    kept = "'auto'" if index % 2 else "9"
    text += f"&response nu_from = 0.5, nu_to = 5, nu_count = 40, method = 'newton', harmonics = {kept} /\n"
    call = f"""text = {text!r}
{_BEGIN}{python}
direct = vv.forced_response(system, np.linspace(0.5, 5, 40), load=load, method="newton", harmonics={kept})
got, true, nu = result.response.coefficients, direct.coefficients, scene.nu()
column, other = table["x_1_re"], direct.coefficient("x", 1).real
lines = vv.plan_response(system, nu, load=load, method="newton", harmonics={kept})
pendulum, is_pendulum, built = False, scene.is_pendulum, scene.oscillator().natural_frequencies()
loads, frequencies = scene.loads()["load"][1], system.natural_frequencies()
computes, skips, heavier = lines.computes, lines.skips, scene.override({{"mount.mass": 3.0}}).mount().mass
{_END}"""

    def judge(names, reported):
        yield Claim("kind", names["kind"], "response")
        same = np.where(np.isnan(names["true"]) & np.isnan(names["got"]), 0, names["got"])
        yield Claim("response", same, np.nan_to_num(names["true"]), 1e-9, damage=1e-3)
        column = np.nan_to_num(names["column"])
        yield Claim("table", column, np.nan_to_num(names["other"]), 1e-9, damage=1e-3)
        yield Claim("nu", names["nu"], np.linspace(0.5, 5, 40), 1e-14)
        yield Claim("is_pendulum", names["is_pendulum"], False)
        yield Claim("system", names["built"], names["frequencies"], SAME, damage=1e-3)
        yield Claim("loads", names["loads"], names["load"][1], 1e-15)
        yield Claim("override", names["heavier"], 3.0, SAME)
        yield Claim("plan reported twice", names["plan"], names["reported"])
        yield Claim(
            "no memory is planned", any("memory" in why for why in names["skips"].values()), True
        )

    return Case(call, judge)


def _branch(rng, index):
    text, python = _mount(rng)
    text += "&branch nu_from = 0.5, nu_to = 6, harmonics = 7 /\n"
    call = f"""text = {text!r}
{_BEGIN}{python}
direct = vv.trace_response(system, (0.5, 6), load=load, harmonics=7)
got, true, column = result.branch.coefficients, direct.coefficients, table["nu"]
{_END}"""

    def judge(names, reported):
        yield Claim("kind", names["kind"], "branch")
        yield Claim("branch", names["got"], names["true"], 1e-9, damage=1e-3)
        yield Claim("table", names["column"], names["direct"].nu, 1e-9)

    return Case(call, judge)


def _backbone(rng, index):
    text, python = _mount(rng)
    text += f"&backbone from = 0.001, to = {few(rng, 0.02, 0.3, 2)}, mode = {index % 2} /\n"
    top = text.split("to = ")[1].split(",")[0]
    call = f"""text = {text!r}
{_BEGIN}{python}
direct = vv.backbone(system, {index % 2}, (0.001, {top}))
got, true, column = result.backbone.coefficients, direct.coefficients, table["nu"]
{_END}"""

    def judge(names, reported):
        yield Claim("kind", names["kind"], "backbone")
        yield Claim("backbone", names["got"], names["true"], 1e-9, damage=1e-3)
        yield Claim("table", names["column"], names["direct"].nu, 1e-9)

    return Case(call, judge)


def _motion(rng, index):
    phi, end = even(rng, -0.3, 0.3, 2), even(rng, 10, 30, 3)
    text = (
        "&pendulum e = 0.1, w2 = 0.4, w3 = 0.8, alpha = 0.5, c1 = 0.01, c2 = 0.01, c3 = 0.01, f0 = 0.005, p1 = 0.93 /\n"
        f"&transient initial = 0.05 0 {phi} 0 -0.2 0, t_end = {end}, dt = 0.25 /\n&spectrum window = 'hann' /\n"
    )
    call = f"""text = {text!r}
{_BEGIN}
system = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.005, p1=0.93)
direct = vv.simulate(system, {end}, dt=0.25, initial=[0.05, 0, {phi}, 0, -0.2, 0])
got, true, column = result.trajectory.state, direct.state, table["phi"]
same, is_pendulum = scene.pendulum() == system, scene.is_pendulum
tone = result.spectrum.amplitude[:, 0]
{_END}"""

    def judge(names, reported):
        yield Claim("kind", names["kind"], "transient")
        yield Claim("motion", names["got"], names["true"], 1e-9, damage=1e-3)
        yield Claim("table", names["column"], names["true"][:, 2], 1e-12)
        yield Claim("pendulum", bool(names["same"]), True)
        yield Claim("is_pendulum", names["is_pendulum"], True)
        u = names["true"][:, 0]
        n = u.size
        window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n)
        mean = (window @ u) / window.sum()
        own = 2 * np.abs(np.fft.rfft(window * (u - mean))) / window.sum()
        own[0] = abs(mean)
        yield Claim("spectrum", names["tone"][1 : n // 2], own[1 : n // 2], 1e-10, damage=1e-3)

    return Case(call, judge)


def _steady(rng, index):
    k3, size = even(rng, 0.3, 1, 2), few(rng, 1e-3, 1e-2, 2)
    text = (
        f"&system coordinates = 'x', mass = 1, stiffness = 1, damping = 0.02 /\n&force law = '{k3}*x^3' /\n"
        f"&load amplitude = {size} /\n&multiple_scales from = 0.9, to = 1.1, count = 21 /\n"
    )
    call = f"""text = {text!r}
{_BEGIN}
system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces="{k3}*x^3")
direct = vv.MultipleScales(system, load={size}, nu=1.0).response("nu", np.linspace(0.9, 1.1, 21))
got, true, built = result.steady.harmonics, direct.harmonics, scene.polynomial_system().natural_frequencies()[0]
{_END}"""

    def judge(names, reported):
        yield Claim("kind", names["kind"], "multiple_scales")
        yield Claim("steady", names["got"], names["true"], 1e-12, damage=1e-3)
        yield Claim("polynomial_system", names["built"], 1.0, 1e-14)

    return Case(call, judge)


def _sweep(rng, index):
    text, python = _mount(rng)
    values = sorted([even(rng, 1, 2, 3), even(rng, 2.1, 3, 3)])
    text += (
        "&response nu = 0.7, 1.1, 1.9, method = 'linear' /\n"
        f"&sweep key = 'mount.mass', values = {values[0]}, {values[1]} /\n"
    )
    call = f"""text = {text!r}
{_BEGIN.replace('result.to_csv(folder / "table.csv")', "").replace('lines = [line for line in open(folder / "table.csv") if line[0] != "#"]', "").replace('table = np.genfromtxt(lines, delimiter=",", names=True)', "")}
{python}
grid = scene.sweep_grid()["mount.mass"]
got = result.sweep["peak_x"].values
true = []
for mass in grid:
    one = scene.override({{"mount.mass": float(mass)}})
    true.append(vv.run(one).response.peak("x").amplitude)
{_END}"""

    def judge(names, reported):
        yield Claim("kind", names["kind"], "sweep")
        yield Claim("grid", names["grid"], np.array(values), 1e-14)
        yield Claim("sweep", names["got"], np.array(names["true"]), 1e-15, damage=1e-3)

    return Case(call, judge)


def _structure(rng, index):
    """A chain with elements: the condensation of the driver against the full equations."""
    n = 3 + index % 4
    mass = [even(rng, 0.5, 2, 2) for _ in range(n)]
    springs = [even(rng, 0.5, 2, 2) for _ in range(n + 1)]
    k = np.diag(springs[:-1]) + np.diag(springs[1:])
    k -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    # Dampers at some of the masses couple the modes.
    c = np.diag([few(rng, 0.02, 0.2, 2) for _ in range(n)]) if index % 3 else 0.02 * k
    kept, cubic, size = even(rng, 0.2, 2, 2), few(rng, 0.1, 2, 2), few(rng, 0.05, 0.5, 2)
    mean = few(rng, 0.02, 0.2, 1) if index % 2 else 0.0
    numbers = [" ".join(map(repr, map(float, m.ravel()))) for m in (k, c)]
    text = (
        f"&structure size = {n}, mass = {' '.join(map(str, mass))},\n stiffness = {numbers[0]},\n"
        f" damping = {numbers[1]} /\n&kernel kind = 'prony', weights = 0.3, rates = 1.5 /\n"
        f"&element on = 'x{n}', stiffness = {kept}, law = '{cubic}*d^3', kernel = 1 /\n"
        f"&element on = 'x{n}', 'x2', law = '0.3*d^2 + 0.2*d', kernel = 0 /\n"
        f"&load on = 'x1', amplitude = {size} /\n&load on = 'x2', order = 0, amplitude = {mean} /\n"
        "&response nu = 0.3, 0.8, 1.4, 2.1, method = 'newton', harmonics = 4 /\n"
    )
    names = [f"x{i + 1}" for i in range(n)]
    call = f"""text = {text!r}
{_BEGIN}
mass, stiffness, damping = np.array({mass}), np.array({k.tolist()}), np.array({c.tolist()})
e, tip = np.zeros({n}), np.zeros({n})
tip[-1] = 1
e[-1] += 1
e[1] -= 1
springs = [
    vv.Springs(stiffness=stiffness + 0.2 * np.outer(e, e)),
    vv.Springs(forces={{"x{n}": "0.3*(x{n} - x2)^2", "x2": "-0.3*(x{n} - x2)^2"}}),
    vv.Springs(stiffness={kept} * np.outer(tip, tip), forces={{"x{n}": "{cubic}*x{n}^3"}},
        kernel=vv.PronyKernel(weights=[0.3], rates=[1.5])),
]
whole = vv.PolynomialSystem(mass=mass, damping=damping, springs=springs, names={names})
direct = vv.forced_response(whole, [0.3, 0.8, 1.4, 2.1], method="newton", harmonics=4,
    load={{0: 1j * {mean} * np.eye({n})[1], 1: {size} * np.eye({n})[0]}})
got = np.array([[table[f"{{name}}_{{k}}_re"] + 1j * table[f"{{name}}_{{k}}_im"] for k in range(5)] for name in {names}])
true = np.moveaxis(direct.coefficients, 0, 2)
same = scene.structure().deflections
{_END}"""

    def judge(names, reported):
        yield Claim("kind", names["kind"], "response")
        true, got = np.nan_to_num(names["true"]), np.nan_to_num(names["got"])
        yield Claim("structure", got, true, 1e-8, damage=1e-3)
        yield Claim("deflections", len(names["same"]), 2 if n > 2 else 1)

    return Case(call, judge)


def _command(rng, index):
    """The driver and the command: the same table, the same exit status."""
    size = few(rng, 0.01, 3, 2)
    orders = "1" if index % 2 else "'auto'"
    text = (
        "&system coordinates = 'x', mass = 1, stiffness = 1, damping = 0.05 /\n&force law = '1.0*x^3' /\n"
        f"&load amplitude = {size} /\n&response nu = 0.3, 0.9, 1.4, method = 'newton', harmonics = {orders} /\n"
    )
    if index % 3 == 2:
        text = text.replace("nu = 0.3", "nu = 0.02")
    call = f"""text = {text!r}
import pathlib, subprocess, sys, tempfile
folder = pathlib.Path(tempfile.mkdtemp())
(folder / "scene.nml").write_text(text)
driver = pathlib.Path("build/release/fortran/viscovib-solve").resolve()
codes = [None, None]
if driver.exists():
    command = pathlib.Path(sys.executable).with_name("viscovib")
    for i, program in enumerate(([driver, "scene.nml", "--out", "a"], [command, "run", "scene.nml", "--out", "b"])):
        (folder / "ab"[i]).mkdir()
        codes[i] = subprocess.run(program, cwd=folder, capture_output=True).returncode
rows = [[line for line in next((folder / x).glob("*.csv")).read_text().splitlines() if line[0] != "#"] for x in "ab"] if codes[0] is not None else [[], []]
import shutil
shutil.rmtree(folder)
"""

    def judge(names, reported):
        codes = names["codes"]
        if codes[0] is None:
            return
        yield Claim("exit status", int(codes[1]), int(codes[0]))
        ours, theirs = ([_cells(row) for row in rows] for rows in reversed(names["rows"]))
        yield Claim(
            "words of the two tables",
            str([row[0] for row in ours]),
            str([row[0] for row in theirs]),
        )
        for a, b in zip(ours, theirs, strict=True):
            yield Claim(
                "numbers of the two tables", np.array(a[1]), np.array(b[1]), 1e-300, damage=1e-3
            )

    return Case(call, judge)


def _cells(row):
    """Words and numbers of a row; non-finite numbers count as words."""
    words, values = [], []
    for cell in row.split(","):
        try:
            value = float(cell)
        except ValueError:
            words.append(cell)
        else:
            words.append("nan" if np.isnan(value) else "")
            values.append(np.nan_to_num(value))
    return words, values


def case(rng, index):
    """Draw a scene."""
    if index % 23 == 22:
        return _command(rng, index // 23)
    if index % 7 == 6:
        return _structure(rng, index // 7)
    kinds = (_response, _branch, _backbone, _motion, _steady, _sweep)
    return kinds[index % 6](rng, index // 6)
