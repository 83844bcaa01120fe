"""Sampling errors of forces, against the same harmonics with another integration."""

import numpy as np
import pytest
import viscovib as vv


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_samples_that_are_too_few_are_seen():
    """A power of x^2 hides its kink: the sampling error is reported in each result."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.4*pow(x^2, 0.6)*x")
    r = vv.forced_response(system, [0.8, 1.3], load=0.5, method="newton", harmonics=9)
    assert r.sampling.shape == (2,)
    assert (r.sampling > 1e-12).all()
    assert f"of samples {r.sampling.max():.1e}" in repr(r)
    assert (r.to_dataset()["sampling"].values == r.sampling).all()
    branch = vv.trace_response(
        system, load_range=(0.2, 0.5), nu=0.8, load=1, harmonics=9, stability=False
    )
    assert "of samples" in repr(branch)
    assert 0.1 < branch.sampling[-1] / r.sampling[0] < 10
    assert (branch.to_dataset()["sampling"].values == branch.sampling).all()


def test_polynomials_and_linear_motions_have_samples_enough():
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    laws = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.1*sin(x)")
    for one, method in ((system, "newton"), (system, "successive"), (laws, "linear")):
        r = vv.forced_response(one, [0.5, 1.5], load=0.02, method=method)
        assert (r.sampling == 0).all()
        assert "of samples" not in repr(r)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_structures_and_bases_that_move():
    """The same motion as a system and as a structure, on a moving base."""
    law = "0.4*pow({0}^2, 0.6)*{0}"
    one = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.05, forces=law.format("x"), base_direction=[1]
    )
    other = vv.Structure(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.05]], base_direction=[1],
        elements=[vv.Spring(on="x1", law=law.format("d"))],
    )  # fmt: skip
    found = [
        vv.forced_response(s, [0.8], base=0.3, method="newton", harmonics=9).sampling
        for s in (one, other)
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-2)
    assert (found[0] > 1e-12).all()


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_branches_over_a_parameter():
    """The system differs at each point; at the value 0 it may be singular."""
    mount = vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
        damping=[[0.2, -0.1], [-0.1, 0.09]], geometry="exact",
    )  # fmt: skip
    branch = vv.trace_response(
        mount, nu=2.0, load=0.3, vary="mass", vary_range=(1, 1.2), stability=False
    )
    assert (branch.sampling < 1e-9).all()
    assert "estimated error by neglected harmonics" in repr(branch)
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.05, forces="k*pow(x^2, 0.6)*x", parameters={"k": 0.3}
    )
    given = {"load": 0.5, "harmonics": 9}
    branch = vv.trace_response(
        system, nu=0.8, vary="k", vary_range=(0.3, 0.4), stability=False, **given
    )
    assert (branch.sampling > 1e-12).all()
    assert (branch.sampling < branch.truncation).all()
    gap = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.05, forces="5*max(x - gap, 0)", parameters={"gap": 0.2}
    )
    branch = vv.trace_response(
        gap, nu=0.8, vary="gap", vary_range=(0.2, 0.4), stability=False, **given
    )
    # Integrated from switch to switch; the switches differ at each point.
    assert (branch.sampling < 1e-12).all()


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize(
    "text", ["k*max(x - p, 0)", "k*where(x > p, x_dot, 0)", "0.3*k*abs(x + p)"]
)
def test_branches_over_the_place_where_a_law_switches(text):
    """Each point is a motion of the law with its value: a response at that value agrees."""
    draw = np.random.default_rng(len(text))
    for _ in range(4):
        k, nu = draw.uniform(0.1, 2), draw.uniform(0.6, 1.4)
        system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=0.2, forces=text, parameters={"k": k, "p": 0.1}
        )
        branch = vv.trace_response(
            system, nu=nu, load=0.5, vary="p", vary_range=tuple(draw.uniform(0.05, 0.4, 2)),
            harmonics=7, stability=False,
        )  # fmt: skip
        for i in (1, len(branch.parameter) // 2, -1):
            p = float(branch.parameter[i])
            one = vv.PolynomialSystem(
                mass=1, stiffness=1, damping=0.2, forces=text, parameters={"k": k, "p": p}
            )
            r = vv.forced_response(
                one, [nu], load=0.5, harmonics=7, method="newton", tolerance=1e-13
            )
            size = np.abs(r.coefficients).max()
            assert np.abs(r.coefficients[0] - branch.coefficients[i]).max() <= 1e-10 * size
