"""Tables and Datasets against attributes of the result; matrix files, intact or damaged."""

import numpy as np

from referee.case import Case, Claim, few, numbers

JUDGES = (
    "Result", "Result.to_csv", "Result.to_dataset", "Response.to_dataset", "Branch.to_dataset", "Branch.label",
    "DrivenResponse.to_dataset", "DrivenBranch.to_dataset",
    "DrivenBranch.label", "Backbone.to_dataset", 
    "Trajectory.to_dataset", "Trajectory.plan", "Trajectory.dof_names",
    "Spectrum.to_dataset", "ScalesResponse.to_dataset", 
    "ScalesResponse.nearest",
    "ScalesMotion.to_dataset", "Structure.read",
)  # fmt: skip
_DUFFING = 'system = vv.PolynomialSystem(mass=1, stiffness=1, damping={c}, forces="0.5*x^3")\n'
_PENDULUM = "system = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1={c}, c2={c}, c3={c}, m01={p}, p2=0.37)\n"
#: Results, and pairs of a table column and its expected values.
_KINDS = (
    (_DUFFING, 'r = vv.forced_response(system, np.linspace(0.5, 1.5, 9), load={p}, method="newton", stability=True)',
     {"nu": "r.nu", "x_1_re": "r.coefficient('x', 1).real", "x_3_im": "r.coefficient('x', 3).imag", "truncation": "r.truncation", "error": "r.error"},
     {"amplitude": "abs(r.coefficients)", "nu": "r.nu", "highest": "r.highest"}),
    (_DUFFING, "r = vv.trace_response(system, (0.5, 1.5), load={p}, harmonics=7)",
     {"nu": "r.nu", "x_1_re": "r.coefficients[:, 0, 0].real", "growing": "r.growing", "multiplier": "abs(r.multipliers[:, 0])"},
     {"nu": "r.nu", "coefficients": "r.coefficients", "growing": "r.growing"}),
    (_PENDULUM, "r = vv.forced_response(system, p2=np.linspace(0.3, 0.5, 4), harmonics=9, stability=True)",
     {"p2": "r.parameter", "phi_1_re": "r.coefficient('phi', 1).real", "stable": "r.stable"},
     {"parameter": "r.parameter", "coefficients": "r.coefficients", "truncation": "r.truncation"}),
    (_PENDULUM, "r = vv.trace_response(system, p2=(0.3, 0.34), harmonics=9)",
     {"p2": "r.parameter", "growing": "r.growing", "z_2_im": "r.coefficients[:, 0, list(r.harmonics).index(2)].imag"},
     {"parameter": "r.parameter", "coefficients": "r.coefficients", "growing": "r.growing"}),
    (_DUFFING, "r = vv.backbone(system, 0, (0.01, 0.01 + {p}))",
     {"nu": "r.nu", "x_1": "r.coefficients[:, 0, list(r.harmonics).index(1)].imag"},
     {"nu": "r.nu", "coefficients": "r.coefficients"}),
    (_DUFFING, "r = vv.simulate(system, 10, dt=0.1, initial=[{p}, 0.0])",
     {"t": "r.t", "x": "r.state[:, 0]", "x_dot": "r.state[:, 1]"}, {"x": "r.state[:, 0]", "t": "r.t", "x_dot": "r.state[:, 1]"}),
    (_DUFFING, "r = vv.spectrum(vv.simulate(system, 10, dt=0.1, initial=[{p}, 0.0]).state[:, 0], 0.1)",
     {"omega": "r.omega", "signal_amplitude": "r.amplitude", "signal_phase": "r.phase"}, {"amplitude": "r.amplitude", "omega": "r.omega", "phase": "r.phase"}),
    (_DUFFING, 'r = vv.MultipleScales(system, load={p} / 100, nu=1.0).response("nu", np.linspace(0.95, 1.05, 9))',
     {}, {"harmonics": "r.harmonics", "error_estimate": "r.error_estimate", "eigenvalues": "r.eigenvalues"}),
    (_DUFFING, "r = vv.MultipleScales(system, load={p} / 100, nu=1.0).motion(np.linspace(0, 9, 7), [0.01, 0.0])",
     None, {"state": "r.state", "amplitude": "r.modulation.amplitude", "error_estimate": "r.error_estimate"}),
)  # fmt: skip


def _matrices(rng):
    """A chain in Matrix Market files: storage as declared, both triangles or one."""
    n = int(rng.integers(2, 7))
    springs = [few(rng, 0.5, 2, 3) for _ in range(n + 1)]
    full = np.diag(springs[:-1]) + np.diag(springs[1:])
    full -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    declared = ("general", "symmetric")[rng.integers(2)]
    stored = (full, np.tril(full), np.triu(full))[rng.integers(3)]
    sound = (declared == "general") == (stored is full)
    entries = [f"{i + 1} {j + 1} {stored[i, j]!s}" for i, j in np.argwhere(stored)]
    omega = few(rng, 0.01, 0.2)
    call = f"""import pathlib, tempfile
head, entries = "%%MatrixMarket matrix coordinate real ", {entries}
with tempfile.TemporaryDirectory() as folder:
    mass, stiffness = (pathlib.Path(folder) / name for name in ("m.mtx", "k.mtx"))
    mass.write_text(head + "general\\n{n} {n} {n}\\n" + "".join(f"{{i}} {{i}} 1.0\\n" for i in range(1, {n + 1})))
    stiffness.write_text("\\n".join([head + "{declared}", "{n} {n} {len(entries)}", *entries]))
    try:
        system, refused = vv.Structure.read(mass, stiffness), ""
    except vv.InputError as error:
        system, refused = None, str(error)
if system is not None:
    r = vv.forced_response(system, [{omega}], load={numbers(np.eye(n)[0])}, method="linear")
    amplitude = abs(r.coefficients[0, :, 0])
"""

    def judge(names, reported):
        yield Claim("refused", bool(names["refused"]), not sound)
        if names["system"] is not None:
            true = np.abs(np.linalg.solve(full - omega**2 * np.eye(n), np.eye(n)[0]))
            yield Claim("amplitude of matrices read", names["amplitude"], true, 1e-11 * true.max())

    return Case(call, judge)


def case(rng, index):
    """Draw a result and write it, or matrices and read them."""
    if index % (len(_KINDS) + 2) >= len(_KINDS):
        return _matrices(rng)
    index %= len(_KINDS) + 2
    system, made, columns, variables = _KINDS[index % len(_KINDS)]
    given = {"c": few(rng, 0.03, 0.1, 2), "p": few(rng, 0.02, 0.2, 2)}
    if "Pendulum" in system:
        given["p"] = few(rng, 0.001, 0.005, 2)
    call = system.format(**given) + made.format(**given) + "\n"
    if columns is not None:
        call += f"""import pathlib, tempfile
with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder) / "table.csv"
    r.to_csv(path)
    lines = [line for line in open(path) if line[0] != "#"]
table = np.genfromtxt(lines, delimiter=",", names=True)
columns = {{{", ".join(f"{k!r}: (table[{k!r}], {v})" for k, v in columns.items())}}}
"""
    else:
        call += "columns = {}\n"
    call += f"""data = r.to_dataset()
variables = {{{", ".join(f"{k!r}: (data[{k!r}].values, {v})" for k, v in variables.items())}}}
label = getattr(r, "label", None)
plan = str(r.plan)
dof_names = getattr(r, "dof_names", ("x",))
"""

    def judge(names, reported):
        for name, (got, true) in names["columns"].items():
            if np.asarray(true).dtype.kind in "bi":
                yield Claim(
                    f"column {name}", np.asarray(got).astype(int), np.asarray(true).astype(int)
                )
                continue
            true = np.asarray(true, float)
            yield Claim(
                f"column {name}",
                np.asarray(got, float),
                true,
                1e-15 * np.abs(true).max() + 1e-300,
                damage=1e-3,
            )
        for name, (got, true) in names["variables"].items():
            if np.asarray(true).dtype.kind in "bi":
                yield Claim(
                    f"variable {name}", np.asarray(got).astype(int), np.asarray(true).astype(int)
                )
                continue
            yield Claim(
                f"variable {name}",
                np.nan_to_num(np.asarray(got)),
                np.nan_to_num(np.asarray(true)),
                1e-300,
                damage=1e-3,
            )
        if hasattr(names["r"], "nearest"):
            r, value = names["r"], 0.9512
            true = np.abs(r.at - value) == np.abs(r.values - value).min()
            yield Claim("nearest", names["r"].nearest(value), np.flatnonzero(true))
        yield Claim("plan says what is computed", "computes: " in names["plan"], True)
        dofs = ("z", "phi", "psi") if "Pendulum" in system else ("x",)
        yield Claim("dof_names", tuple(names["dof_names"]), dofs)
        if names["label"] is not None:
            yield Claim("label", bool(names["label"]), True)

    return Case(call, judge)
