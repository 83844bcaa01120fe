"""Branches along a parameter of the system, against other ways to the same motions."""

import numpy as np
import pytest
import viscovib as vv
from test_branch import KERNEL, STIFFNESS, _duffing, damped

# Few harmonics are intended here; test_truncation.py tests the warning.
pytestmark = pytest.mark.filterwarnings("ignore:.*estimated relative error")


def kinds(branch):
    return [crossing.kind for crossing in branch.crossings]


def places(branch):
    return np.array([crossing.parameter for crossing in branch.crossings])


def test_a_cubic_coefficient_is_the_square_of_a_load():
    """X'' + d x' + x + c x^3 = F cos nu t depends on c F^2 only."""
    options = {"nu": 1.0, "load": 1.0, "harmonics": 31}
    by_load = vv.trace_response(_duffing(), load_range=(0.1, 30.0), **options)
    by_force = vv.trace_response(
        _duffing(), vary="forces[u^3]", vary_range=(0.01, 900.0), **options
    )
    assert by_force.varies == "forces[u^3]"
    assert by_force.outcome == "completed"
    assert kinds(by_force) == kinds(by_load)
    assert {"fold", "symmetry breaking"} == set(kinds(by_load))
    assert places(by_force) == pytest.approx(places(by_load) ** 2, rel=1e-11)
    assert by_force.folds == pytest.approx(by_load.folds**2, rel=1e-12)
    for mine, other in zip(by_force.crossings, by_load.crossings, strict=True):
        scaled = mine.coefficients * np.sqrt(mine.parameter)
        # Near a fold the accuracy is the root of the rounding error.
        assert scaled == pytest.approx(other.coefficients, rel=1e-6, abs=1e-6)


def test_a_period_doubles_along_a_quadratic_coefficient():
    """X'' + d x' + x - b x^2 = F cos nu t depends on b F only."""
    escape = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="-x^2")
    options = {"nu": 0.85, "load": 1.0, "harmonics": 24}
    by_load = vv.trace_response(escape, load_range=(0.01, 0.2), **options)
    by_force = vv.trace_response(escape, vary="forces[x^2]", vary_range=(-0.01, -0.2), **options)
    assert "period doubling" in kinds(by_load)
    assert kinds(by_force) == kinds(by_load)
    assert -places(by_force) == pytest.approx(places(by_load), rel=1e-9)


@pytest.mark.parametrize(
    ("kernel", "damping", "kind"),
    [
        (None, 0.02, "Neimark-Sacker"),
        (None, 0.02, "symmetry breaking"),
        (KERNEL, 0.01, "Neimark-Sacker"),
        (KERNEL, 0.01, "symmetry breaking"),
    ],
)
def test_changes_along_a_mounts_parameter_lie_where_those_in_frequency_do(kernel, damping, kind):
    """Bifurcations in frequency are bifurcations at 1 along any factor that is 1."""
    body = damped(kernel=kernel, damping=damping * STIFFNESS)
    swept = vv.trace_response(body, (0.45, 2.7), load=2.5, harmonics=15, max_points=3000)
    found = [c for c in swept.crossings if c.kind == kind][-1]
    size = np.abs(found.coefficients).max()
    along = {"nu": found.parameter, "load": 2.5, "harmonics": 15}
    off = []
    for name in ("cubic_scale", "mass"):
        for ends in ((0.8, 1.2), (1.2, 0.8)):
            branch = vv.trace_response(body, **along, vary=name, vary_range=ends)
            near = [c for c in branch.crossings if c.kind == kind and c.parameter is not None]
            gaps = [np.abs(c.coefficients - found.coefficients).max() / size for c in near]
            off += [abs(c.parameter - 1) for c, gap in zip(near, gaps, strict=True) if gap < 1e-4]
    assert off
    assert max(off) < 1e-8


TWO = {
    "mass": [[1.0, 0.1], [0.1, 0.5]],
    "damping": [[0.1, -0.02], [-0.03, 0.06]],
    "stiffness": [[3.0, -0.5], [-0.5, 2.0]],
    "forces": {"a": "0.3*a^3 + 0.2*a*b^2", "b": "0.1*b^3"},
}


def two(springs=None, kernel=KERNEL, **changes):
    coupling = {"stiffness": [[1.0, -1.0], [-1.0, 1.0]], "forces": {"a": "0.4*a^2"}}
    return vv.PolynomialSystem(
        **(TWO | changes),
        springs=[vv.Springs(**(coupling | (springs or {})), kernel=kernel)],
        names=("a", "b"),
    )


def entry(matrix, places, value):
    changed = np.array(matrix)
    for place in places:
        changed[place] = value
    return changed


@pytest.mark.parametrize(
    ("name", "ends", "made"),
    [
        ("mass[a,b]", (0.1, 0.2), lambda p: two(mass=entry(TWO["mass"], [(0, 1), (1, 0)], p))),
        ("mass[b,b]", (0.5, 0.4), lambda p: two(mass=entry(TWO["mass"], [(1, 1)], p))),
        ("damping[a,b]", (0.0, 0.05), lambda p: two(damping=entry(TWO["damping"], [(0, 1)], p))),
        (
            "stiffness[b,a]",
            (-0.5, 0.5),
            lambda p: two(stiffness=entry(TWO["stiffness"], [(0, 1), (1, 0)], p)),
        ),
        ("mass_scale", (1, 1.3), lambda p: two(mass=p * np.array(TWO["mass"]))),
        ("damping_scale", (1, 0.5), lambda p: two(damping=p * np.array(TWO["damping"]))),
        (
            "stiffness_scale",
            (1, 1.2),
            lambda p: two(
                {"stiffness": p * np.array([[1.0, -1.0], [-1.0, 1.0]])},
                stiffness=p * np.array(TWO["stiffness"]),
            ),
        ),
        (
            "springs[0].stiffness_scale",
            (0, 2),
            lambda p: two({"stiffness": p * np.array([[1.0, -1.0], [-1.0, 1.0]])}),
        ),
        (
            "forces[a, b^2*a]",
            (-0.2, 0.4),
            lambda p: two(forces={"a": f"0.3*a^3 + {p!r}*a*b^2", "b": "0.1*b^3"}),
        ),
        ("springs[0].forces[a,a^2]", (0, 0.6), lambda p: two({"forces": {"a": f"{p!r}*a^2"}})),
        (
            "forces_scale",
            (0.2, 2),
            lambda p: two(
                {"forces": {"a": f"{p!r}*0.4*a^2"}},
                forces={"a": f"{p!r}*(0.3*a^3 + 0.2*a*b^2)", "b": f"{p!r}*0.1*b^3"},
            ),
        ),
        (
            "memory_scale",
            (0, 1.3),
            lambda p: two(
                kernel=vv.RzhanitsynKernel(amplitude=0.048 * p, alpha=0.1, beta=0.05)
                if p else None
            ),
        ),
    ],
)  # fmt: skip
def test_every_name_means_the_number_it_says(name, ends, made):
    """Both ends are motions of systems with these values, with their stability."""
    branch = vv.trace_response(two(), nu=1.1, vary=name, vary_range=ends, load=[0.2, 0.1])
    assert branch.outcome == "completed"
    assert (branch.nu == 1.1).all()
    for i in (0, -1):
        alone = vv.forced_response(
            made(float(branch.parameter[i])), 1.1, load=[0.2, 0.1], method="newton",
            tolerance=1e-13, stability=True,
        )  # fmt: skip
        n = alone.harmonics.size
        kept = np.isin(branch.harmonics, alone.harmonics)
        assert branch.coefficients[i][:, kept] == pytest.approx(
            alone.coefficients[0][:, :n], abs=1e-10
        )
        assert branch.stable[i] == alone.stable[0]
        assert branch.growing[i] == 0
        sizes = np.abs([branch.multipliers[i, 0], alone.multipliers[0, 0]])
        assert sizes[0] == pytest.approx(sizes[1], rel=1e-6)


def test_a_coefficient_may_pass_zero():
    """From softening through linear to hardening: the point at 0 is the linear response."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.3, forces="0.1*x^3")
    branch = vv.trace_response(
        system, nu=0.9, vary="forces[x^3]", vary_range=(-0.1, 0.3), load=0.3, at=[0.0]
    )
    assert branch.outcome == "completed"
    (i,) = branch.stops
    assert branch.parameter[i] == 0
    linear = 0.3 / (1 - 0.81 + 0.27j)
    assert branch.coefficients[i, 0, 0] == pytest.approx(linear, rel=1e-12)
    for name, value in (("mass", 1.2), ("stiffness", 1.4), ("damping", 0.1)):
        one = vv.trace_response(
            system, nu=0.9, vary=name, vary_range=(1, value), load=0.3, harmonics=9
        )
        given = {"mass": 1, "stiffness": 1, "damping": 0.3, "forces": "0.1*x^3"} | {name: value}
        alone = vv.forced_response(
            vv.PolynomialSystem(**given),
            0.9,
            load=0.3,
            method="newton",
            harmonics=9,
            tolerance=1e-13,
        )
        assert one.coefficients[-1] == pytest.approx(alone.coefficients[0], abs=1e-10)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("colour", "vary = 'colour': must be 'memory_scale', 'mass_scale'"),
        (3, "vary = 3: must be"),
        ("stiffness", "vary = 'stiffness': must have two coordinates in brackets"),
        ("stiffness[a,c]", "coordinate = 'c': must be one of 'a', 'b'"),
        ("forces[a,a^2]", "is not among the forces (a: a^3, a: a*b^2, b: b^3)"),
        ("forces[a,2*a^3]", "2*a^3 must be one monomial"),
        ("forces[a]", "must have an equation and a monomial in brackets"),
        ("springs[1].stiffness_scale", "the system has 1 springs"),
        ("springs[0].mass_scale", "whose stiffness and forces may vary"),
        ("memory", "must be 'memory_scale'"),
        ("mass[a,b", "must be 'memory_scale', 'mass_scale'"),
    ],
)
def test_wrong_names(name, text):
    with pytest.raises(vv.InputError) as error:
        vv.trace_response(two(), nu=1.0, vary=name, vary_range=(1, 2), load=[0.1, 0])
    assert text in str(error.value)


def test_ends_must_make_a_system():
    options = {"nu": 1.0, "load": [0.1, 0.0]}
    with pytest.raises(vv.InputError, match="mass: must be symmetric and positive definite"):
        vv.trace_response(two(), **options, vary="mass[a,b]", vary_range=(0, 2))
    with pytest.raises(vv.InputError, match="mass: must be symmetric and positive definite"):
        vv.trace_response(two(), **options, vary="mass[a,b]", vary_range=(2, 0))
    with pytest.raises(vv.InputError, match="mass: must be symmetric and positive definite"):
        vv.trace_response(_duffing(), nu=1.0, load=0.1, vary="mass", vary_range=(1, 0))
    with pytest.raises(vv.InputError, match="the system has no kernel"):
        vv.trace_response(two(kernel=None), **options, vary="memory_scale", vary_range=(1, 2))
    plain = vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 2], forces={"x1": "x1^3"})
    with pytest.raises(vv.InputError, match="vary = 'damping_scale': all of it is 0"):
        vv.trace_response(plain, **options, vary="damping_scale", vary_range=(1, 2))
    with pytest.raises(vv.InputError, match=r"vary_range\[0\] = nan"):
        vv.trace_response(two(), **options, vary="mass_scale", vary_range=(np.nan, 2))
    with pytest.raises(vv.InputError, match="must be two different numbers"):
        vv.trace_response(two(), **options, vary="mass_scale", vary_range=(2, 2))


@pytest.mark.parametrize("kernel", [None, KERNEL])
@pytest.mark.parametrize(
    ("law", "name", "ends"),
    [
        ("F*tanh(x_dot/w)", "w", (0.1, 0.3)),
        ("F*tanh(x/w)", "w", (0.2, 0.5)),
        ("F*max(x, 0)^n", "n", (1.2, 2.8)),
        ("x/w + F*sinh(x/w)", "w", (0.7, 1.3)),
    ],
)
def test_parameters_that_move_the_stiffness_or_damping_at_rest(law, name, ends, kernel):
    def system(value):
        given = {"F": 0.3, name: value}
        return vv.PolynomialSystem(
            mass=1, stiffness=1, damping=0.1, forces=law, parameters=given, kernel=kernel
        )

    given = {"load": 0.4, "harmonics": 15, "tolerance": 1e-5}
    branch = vv.trace_response(system(ends[0]), nu=1.1, vary=name, vary_range=ends, **given)
    assert branch.outcome == "completed"
    for i in (0, branch.nu.size // 2, branch.nu.size - 1):
        own = system(float(branch.parameter[i]))
        alone = vv.forced_response(own, [1.1], method="newton", **given)
        assert branch.amplitude("x")[i] == pytest.approx(alone.amplitude("x")[0], rel=1e-8)


def test_a_power_that_has_no_value_below_0():
    """At integers it is a polynomial, which must not be used in between."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.1, forces="0.5*x^n", parameters={"n": 3.0}
    )
    with pytest.raises(vv.InputError, match="must be defined near rest"):
        vv.trace_response(system, nu=1.1, vary="n", vary_range=(2, 4), load=0.4, harmonics=9)


@pytest.mark.parametrize(
    "forces",
    ["0.3*x + x^3", "0.3*tanh(2*x)", "0.2*x + sin(x)", "x^2 - 0.4*x + 0.1*x_dot*abs(x_dot)"],
)
@pytest.mark.parametrize("in_springs", [False, True])
def test_a_stiffness_is_the_one_that_is_given(forces, in_springs):
    """As for a system with this stiffness, whatever is linear in its forces."""

    def made(k):
        own = {"stiffness": k, "forces": forces}
        if not in_springs:
            return vv.PolynomialSystem(mass=1, damping=0.2, **own)
        own["forces"] = forces.split(" + 0.1*x_dot")[0]
        return vv.PolynomialSystem(mass=1, damping=0.2, stiffness=0.5, springs=[vv.Springs(**own)])

    branch = vv.trace_response(
        made(1.5), nu=0.7, load=0.2, vary="springs[0].stiffness" if in_springs else "stiffness",
        vary_range=(1.0, 2.0), harmonics=15, stability=False,
    )  # fmt: skip
    alone = vv.forced_response(made(2.0), 0.7, load=0.2, method="newton", harmonics=15)
    assert branch.amplitude("x", 1)[-1] == pytest.approx(alone.amplitude("x", 1)[0], rel=1e-9)
