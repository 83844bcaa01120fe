"""Fits of random materials: recovered parameters, factors, terms and tables; closed forms of NumPy alone."""

import numpy as np
from scipy.stats import chi2

from referee.case import Case, Claim, even, few

JUDGES = (
    "fit_kernel", "KernelFit", "KernelFit.quantity", "KernelFit.modulus", "KernelFit.bare_kernel",
    "KernelFit.parameters", "KernelFit.interval", "KernelFit.unconstrained", "KernelFit.samples",
    "KernelFit.kernel", "KernelFit.residual", "KernelFit.predict",
    "KernelFit.to_json", "ParametricFit", "ParametricFit.names", "ParametricFit.modulus",
    "ParametricFit.bare_kernel", "ParametricFit.covariance", "ParametricFit.turned_covariance",
    "ParametricFit.correlation", "ParametricFit.interval", "ParametricFit.intervals",
    "ParametricFit.at_bound", "ParametricFit.unconstrained", "ParametricFit.parameters",
    "ParametricFit.zener", "ParametricFit.profile", "ParametricFit.constraints",
    "ParametricFit.samples", "PronyFit", "PronyFit.modulus", "PronyFit.relaxed", "PronyFit.times",
    "PronyFit.moduli", "PronyFit.bare_kernel", "PronyFit.names", "PronyFit.interval",
    "PronyFit.unconstrained", "PronyFit.parameters", "PronyFit.samples", "Profile", "Sample",
    "propagate", "Band", "Optimum", "prony_terms", "PronyTerms", "PronyTerms.modulus",
    "PronyTerms.kernel", "PronyTerms.text", "PronyTerms.write", "read_fit", "read_kernel",
    "write_kernel", "master_curve", "MasterCurve", "MasterCurve.shift", "MasterCurve.fit_law",
    "fit_shift_law", "ShiftFit", "ShiftTable", "ShiftTable.reference", "ShiftTable.log10",
    "kramers_kronig", "KramersKronig", "ModulusData",
    "ModulusData.modulus", "ModulusData.loss_factor", "ModulusData.sets", "ModulusData.to_shear",
    "ModulusData.to_young", "ModulusData.kramers_kronig", "RelaxationData", "RelaxationData.sets",
    "CreepData", "CreepData.sets", "read_dma", "read_dynamic_stiffness", "read_relaxation",
    "read_creep", "fit_amplitude", "AmplitudeFit", "AmplitudeFit.predict", "jenkins_stiffness",
    "fit_progressive", "ProgressiveLaw",
)  # fmt: skip


def _material(rng, index):
    """A kernel that relaxes within 1e-2 to 1e4 rad/s: source, formula of its transform."""
    kind = ("rabotnov", "rzhanitsyn", "abel")[index % 3]
    alpha, tau, p = even(rng, 0.2, 0.85, 2), few(rng, 1e-2, 1, 2), even(rng, 0.3, 0.8, 2)
    slow = tau**-alpha
    if kind == "rabotnov":
        values = {"amplitude": p * slow, "alpha": alpha, "beta": slow}
        formula = "p['amplitude'] / ((1j * nu) ** p['alpha'] + p['beta'])"
    elif kind == "rzhanitsyn":
        values = {"amplitude": 0.3 * p * slow, "alpha": alpha, "beta": 1 / tau}
        formula = "p['amplitude'] * gamma(p['alpha']) * (p['beta'] + 1j * nu) ** -p['alpha']"
    else:
        values = {"amplitude": 0.03 * p, "alpha": even(rng, 0.15, 0.5, 2)}
        formula = "p['amplitude'] * gamma(p['alpha']) * (1j * nu) ** -p['alpha']"
    values = {name: float(f"{value:.4g}") for name, value in values.items()}
    return kind, values, formula


def _parametric(rng, index):
    kind, values, formula = _material(rng, index)
    noise = 0.0 if index % 2 else few(rng, 0.003, 0.02, 1)
    modulus, seed = few(rng, 1e3, 1e9, 3), int(rng.integers(10**6))
    call = f"""import os, tempfile
from math import gamma
p, nu = {values}, np.geomspace(1e-3, 1e4, 70)
noise = 1 + {noise} * np.random.default_rng({seed}).standard_normal((2, 70))
stiff = {modulus} * (1 - {formula})
data = vv.ModulusData(frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1])
fit = vv.fit_kernel(data, kind={kind!r})
found, interval, loose = fit.parameters, fit.interval, fit.unconstrained
said, residual, cost = fit.predict(nu), fit.residual, fit.optima[0].cost
path = os.path.join(tempfile.mkdtemp(), "fit.json")
fit.to_json(path)
back, kernel = vv.read_fit(path).parameters, vv.read_kernel(path)
hats, bare = kernel.transform(nu), fit.bare_kernel.transform(nu)
wide, text, quantity, bound = fit.intervals(0.8)["alpha"], fit.summary(), fit.quantity, fit.at_bound
error = np.sqrt(np.diag(fit.turned_covariance)[0]), np.linalg.eigvalsh(fit.covariance).min()
"""
    if noise:
        call += """band = vv.propagate(fit, lambda s: s.modulus, samples=300)
drawn = np.array([s.modulus * (1 - s.kernel.transform(nu)) for s in fit.samples(300, seed=1)])
ends = (band.low, band.high)
profile = fit.profile('alpha').interval
edges, growth = fit.constraints()
symmetric = abs(fit.correlation - fit.correlation.T).max()
"""

    def judge(names, reported):
        true = {"modulus": modulus, **values}
        found, interval, loose = names["found"], names["interval"], names["loose"]
        for name, value in true.items():
            if name in loose:
                continue
            low, high = interval[name]
            # Five standard errors plus rounding error.
            allowed = 5 / 2 * (high - low) / 1.96 + 1e-7 * value
            yield Claim(f"{kind} {name}", found[name], value, allowed, damage=10)
            yield Claim(
                f"{kind} {name} from a file", names["back"][name], found[name], 1e-12 * value
            )
        stiff = names["fit"].modulus * (1 - names["hats"])
        yield Claim("prediction", names["said"], stiff, 1e-12 * np.abs(stiff))
        wide = bool(names["wide"][0] < found["alpha"] < names["wide"][1])
        close = not noise or names["bound"] or "alpha" in loose
        yield Claim("an interval holds its fit", wide or close, True)
        reported_of = all(name in names["text"] for name in true) and names["quantity"] == "E"
        yield Claim("summary", bool(reported_of), True)
        yield Claim("bare", names["bare"], names["hats"], 1e-15)
        yield Claim("residual", bool(max(names["residual"]) <= 1.6 * noise + 1e-8), True)
        if noise:
            size, best = names["data"], names["said"]
            ratios = [
                (k.real - size.storage) ** 2 / best.real**2
                + (k.imag - size.loss) ** 2 / best.imag**2
                for k in (best, *names["drawn"])
            ]
            squares = np.array(ratios).sum(axis=1)
            n = len(true)
            rises = (squares[1:] / squares[0] - 1) * (140 - n)
            middle = chi2(n).median()
            yield Claim("rise of samples", np.median(rises), middle, 0.5 * middle, damage=2)
        if noise and not loose and not names["bound"]:
            low, high = interval["modulus"]
            width = high - low
            ends = np.array([low, high])
            yield Claim("band", np.array(names["ends"]), ends, 0.3 * width, damage=1)
            low, high = interval["alpha"]
            yield Claim(
                "profile", np.array(names["profile"]), np.array([low, high]), 0.3 * (high - low),
                damage=1,
            )  # fmt: skip
            yield Claim(
                "error", names["error"][0], width / modulus / 3.94, 0.05 * width / modulus, damage=1
            )
            yield Claim("covariance", bool(names["error"][1] > -1e-12), True)
            yield Claim("growth of errors", bool((names["growth"] > 0.99).all()), True)
            yield Claim("correlation", bool(names["symmetric"] < 1e-9), True)

    return Case(call, judge, may_refuse=True)


def _in_time(rng, index):
    _, values, _ = _material(rng, 0)
    modulus = few(rng, 1e3, 1e9, 3)
    a, al, b = (values[name] for name in ("amplitude", "alpha", "beta"))
    lost = float(f"{b - a:.6g}")
    call = f"""t = np.geomspace(1e-4, 1e3, 50)
true = vv.RabotnovKernel(amplitude={a}, alpha={al}, beta={b})
step = vv.RelaxationData(times=t, modulus={modulus} * true.relaxation(t))
relaxed = vv.fit_kernel(step)
# Compliance 1/(s M(s)) = (1 + a/(s^alpha + b - a))/(M_0 s).
creep = 2 - vv.RabotnovKernel(amplitude={a}, alpha={al}, beta={lost}).relaxation(t)
crept = vv.fit_kernel(vv.CreepData(times=t, compliance=creep / {modulus}))
first, second, zener = relaxed.parameters, crept.parameters, relaxed.zener[0]
sets = len(step.sets()) + len(crept.measured.data.sets())
"""

    def judge(names, reported):
        for name, value in {"modulus": modulus, **values}.items():
            for which in ("first", "second"):
                if np.isfinite(names[which][name]):
                    beta = which == "second" and name == "beta"
                    exact = lost + a if beta else value
                    # The difference of beta and amplitude is rounded to six digits.
                    yield Claim(
                        f"{which} {name}", names[which][name], exact, 2e-5 * value, damage=1e-2
                    )
        relaxed = modulus * (1 - a / b)
        yield Claim("relaxed", names["zener"]["relaxed"], relaxed, 1e-6 * modulus, damage=1e-2)
        yield Claim("sets", names["sets"], 2)

    return Case(call, judge, may_refuse=True)


def _terms(rng, index):
    kind, values, formula = _material(rng, index % 2)
    tolerance = few(rng, 1e-3, 0.1, 1)
    modulus = few(rng, 1e5, 1e9, 3)
    name = {"rabotnov": "RabotnovKernel", "rzhanitsyn": "RzhanitsynKernel"}[kind]
    call = f"""import os, tempfile
from math import gamma
p = {values}
kernel = vv.{name}(**p)
terms = vv.prony_terms(kernel, modulus={modulus}, t_min=1e-3, t_max=1e2, tolerance={tolerance})
nu = np.geomspace(1e-2, 1e3, 311)
close = terms.relaxed + sum(m * 1j * nu * t / (1 + 1j * nu * t) for m, t in zip(terms.moduli, terms.times))
own = terms.modulus * (1 - terms.kernel.transform(nu))
exact = {modulus} * (1 - {formula})
error = terms.error
path = os.path.join(tempfile.mkdtemp(), "rubber.inp")
terms.write(path, "abaqus")
rows = [line.split(",") for line in open(path).read().split("PRONY\\n")[1].split("\\n") if line]
shares = sum(float(row[0]) for row in rows)
lines = terms.text("ansys").count("TBDATA")
data = vv.ModulusData(frequencies=nu, storage=exact.real, loss=exact.imag)
fit = vv.fit_kernel(data, kind="prony", terms=20)
refit, residual = fit.predict(nu), fit.residual
bare = fit.modulus * (1 - fit.bare_kernel.transform(nu))
whole = fit.relaxed + fit.moduli.sum()
vv.write_kernel(terms.kernel, path)
same = abs(vv.read_kernel(path).transform(nu) - terms.kernel.transform(nu)).max()
"""

    def judge(names, reported):
        exact = names["exact"]
        size = np.abs(exact)
        yield Claim(
            "terms", names["close"], exact, 1.1 * names["error"] * size, limit=1.3, damage=1
        )
        yield Claim("kernel of terms", names["own"], names["close"], 1e-10 * size)
        yield Claim("tolerance", bool(names["error"] <= tolerance), True)
        share = 1 - names["terms"].relaxed / names["terms"].modulus
        yield Claim("lines", names["lines"], -(-2 * names["terms"].times.size // 6))
        yield Claim("shares", names["shares"], share, 1e-7)
        yield Claim("refit", bool(max(names["residual"]) < 0.02), True)
        yield Claim("bare", names["bare"], names["refit"], 1e-12 * size)
        yield Claim("whole", names["whole"], names["fit"].modulus, 1e-9 * modulus)
        yield Claim("file", 1 + names["same"], 1.0, 1e-15)

    return Case(call, judge, may_refuse=True)


def _sets(rng, index):
    _, values, formula = _material(rng, index % 2)
    c1, c2, noise = even(rng, 5, 15, 1), even(rng, 60, 150, 2), few(rng, 1e-3, 5e-3, 1)
    step, seed = even(rng, 5, 9, 1), int(rng.integers(10**6))
    call = f"""from math import gamma
p, one, warm = {values}, np.geomspace(0.3, 300, 12), 20 + {step} * np.arange(-2, 3)
decades = -{c1} * (warm - 20) / ({c2} + warm - 20)
nu = np.concatenate([one * 10**d for d in decades])
stiff = 1e6 * (1 - {formula})
noise = 1 + {noise} * np.random.default_rng({seed}).standard_normal((2, nu.size))
data = vv.ModulusData(frequencies=np.tile(one, 5), storage=stiff.real * noise[0],
    loss=stiff.imag * noise[1], temperature=np.repeat(warm, 12))
master = vv.master_curve(data, reference=20.0)
found, sure, count = master.decades, master.uncertainty, len(data.sets())
own = master.shift.log10(30.0)
fitted = master.fit_law("wlf").law.log10(30.0)
table = vv.ShiftTable(temperatures=warm, decades=decades)
reference, between = table.reference, table.log10(warm[1] + {step} / 4)
law = vv.fit_shift_law(warm, decades, reference=20.0).law
laws = np.array([law.c1, law.c2])
"""

    def judge(names, reported):
        decades = names["decades"]
        yield Claim("factors", names["found"], decades, 5 * names["sure"] + 0.03, damage=1)
        yield Claim("sets", names["count"], 5)
        at = np.interp(30.0, names["warm"], names["found"])
        yield Claim("own law", names["own"], at, 1e-9)
        true = -c1 * 10 / (c2 + 10)
        allowed = 5 * names["sure"].max() + 0.05
        yield Claim("fitted law", names["fitted"], true, allowed, damage=1)
        yield Claim("reference", names["reference"], 20.0, 1e-9)
        straight = decades[1] + (decades[2] - decades[1]) / 4
        yield Claim("between", names["between"], straight, 1e-12)
        both = np.array([c1, c2])
        yield Claim("law", names["laws"], both, 1e-6 * both, damage=1e-4)

    return Case(call, judge, may_refuse=True)


def _table(rng, index):
    _, values, formula = _material(rng, index % 2)
    mark, comma = ((";", ","), ("\t", "."), (",", "."))[index % 3]
    unit, factor = (("Hz", 2 * np.pi), ("rad/s", 1.0), ("kHz", 2e3 * np.pi))[index % 3]
    pascal, size = (("MPa", 1e6), ("GPa", 1e9), ("kPa", 1e3))[index % 3]
    wrong, poisson = even(rng, 1.6, 3, 2), even(rng, 0.3, 0.5, 2)
    call = f"""import os, tempfile
from math import gamma
p, nu, size = {values}, np.geomspace(1e-3, 1e4, 60), {size}
stiff = 1e6 * (1 - {formula})
rows = np.column_stack([nu / {factor!r}, stiff.real / {size}, stiff.imag / {size}])
lines = [{mark!r}.join(repr(float(x)).replace(".", {comma!r}) for x in row) for row in rows]
head = [{mark!r}.join(["f", "E'", "E''"]), {mark!r}.join([{unit!r}, {pascal!r}, {pascal!r}])]
path = os.path.join(tempfile.mkdtemp(), "table.csv")
open(path, "w").write("\\n".join(head + lines))
data = vv.read_dma(path)
read, at, tangent = data.modulus, data.frequencies, data.loss_factor
shear = data.to_shear(poisson={poisson}).modulus
young = data.to_shear(poisson={poisson}).to_young(poisson={poisson}).modulus
good = vv.kramers_kronig(data).consistent
off = vv.ModulusData(frequencies=nu, storage=stiff.real, loss={wrong} * stiff.imag)
check = off.kramers_kronig()
bad, ratio, text = check.consistent, float(np.median(check.ratio)), check.summary()
head = [{mark!r}.join(["t", "E", "J"]), {mark!r}.join(["min", {pascal!r}, "1/" + {pascal!r}])]
open(path, "w").write("\\n".join(head + lines))
moduli, compliances = vv.read_relaxation(path).modulus, vv.read_creep(path).compliance
head = [{mark!r}.join(["f", "K'", "K''"]), {mark!r}.join([{unit!r}, "N/mm", "N/mm"])]
open(path, "w").write("\\n".join(head + lines))
mount = vv.read_dynamic_stiffness(path).modulus
"""

    def judge(names, reported):
        stiff = names["stiff"]
        size = np.abs(stiff)
        yield Claim("table", names["read"], stiff, 1e-14 * size)
        yield Claim("frequencies", names["at"], names["nu"], 1e-14 * names["nu"])
        yield Claim("loss factor", names["tangent"], stiff.imag / stiff.real, 1e-13)
        yield Claim("shear", names["shear"], stiff / (2 + 2 * poisson), 1e-14 * size)
        yield Claim("young", names["young"], stiff, 1e-14 * size)
        yield Claim("consistent", names["good"], True)
        if np.ptp(stiff.real) > 0.2 * size.max():
            yield Claim("inconsistent", names["bad"], False)
        said = "contradict" in names["text"] or "determines little" in names["text"]
        yield Claim("words", said, True)
        yield Claim("moduli", names["moduli"], stiff.real, 1e-14 * size)
        factor = names["size"]
        yield Claim(
            "compliances", names["compliances"], stiff.imag / factor**2, 1e-13 * size / factor**2
        )
        yield Claim("mount", names["mount"], stiff / factor * 1e3, 1e-14 * size / factor * 1e3)
        yield Claim("ratio", names["ratio"], wrong, 0.2 * wrong, damage=1)

    return Case(call, judge, may_refuse=True)


def _amplitudes(rng, index):
    _, values, _ = _material(rng, 0)
    k, slip, cubic = few(rng, 2e4, 2e5, 3), few(rng, 3e-4, 2e-3, 3), few(rng, 1e8, 1e10, 2)
    call = f"""p = {values}
nu, x = np.tile(np.geomspace(1e-2, 1e3, 15), 5), np.repeat(np.geomspace(1e-4, 1e-2, 5), 15)
u = np.minimum({slip} / x, 1)
angle = np.arccos(1 - 2 * u)
slider = {k} / np.pi * (angle - np.sin(2 * angle) / 2 + 1j * np.sin(angle) ** 2)
own = vv.jenkins_stiffness(x, stiffness={k}, slip={slip})
total = 2e5 * (1 - p['amplitude'] / ((1j * nu) ** p['alpha'] + p['beta'])) + slider
data = vv.ModulusData(frequencies=nu, storage=total.real, loss=total.imag, amplitude=x, quantity="K")
fit = vv.fit_amplitude(data)
found, said = np.array([fit.stiffness[0], fit.slip[0], fit.modulus]), fit.predict(nu, x)
law = vv.fit_progressive(x, {k} * x + {cubic} * x**3)
static = np.array([law.stiffness, law.parameters["k3"]])
"""

    def judge(names, reported):
        true = np.array([k, slip, 2e5])
        yield Claim("Jenkins", names["own"], names["slider"], 1e-12 * k)
        yield Claim("elements", names["found"], true, 1e-5 * true, damage=1e-3)
        size = np.abs(names["total"])
        yield Claim("stiffness", names["said"], names["total"], 1e-6 * size, damage=1e-4)
        yield Claim("static", names["static"], np.array([k, cubic]), 1e-9 * np.array([k, cubic]))

    return Case(call, judge, may_refuse=True)


def case(rng: np.random.Generator, index: int) -> Case:
    """The kinds of fits in turn."""
    kinds = (_parametric, _parametric, _in_time, _terms, _sets, _table, _amplitudes)
    make = kinds[index % 7]
    return make(rng, int(rng.integers(1000)))
