"""Digits of motions of condensed systems near natural frequencies with low damping."""

import warnings

import numpy as np
import pytest
import viscovib as vv
from viscovib.bodies.body import Body


def _engine(rng):
    """A body on three rubber mounts, nonlinear in their third direction."""
    kernel = vv.RzhanitsynKernel(amplitude=rng.uniform(0.3, 0.8), alpha=0.4, beta=20)
    mounts = [
        vv.MountPoint(
            name=f"m{i}",
            position=place + rng.uniform(-0.1, 0.1, 3),
            stiffness=rng.uniform(1e5, 1e6, 3),
            angles=rng.uniform(-0.5, 0.5, 3),
            kernel=kernel,
            law=(None, None, "1e10*d^3"),
        )
        for i, place in enumerate(np.array([[0.4, 0, 0], [-0.3, 0.3, 0.1], [-0.3, -0.3, -0.1]]))
    ]
    return vv.Body(mass=150, inertia=rng.uniform(4, 12, 3), mounts=mounts)


@pytest.mark.parametrize("seed", range(6))
def test_digits_do_not_hang_on_the_distance_to_a_mode(seed, monkeypatch):
    """The same motions with all coordinates, where no compliance has a resonance.

    Near a resonance the compliance of the linear subsystem is dominated by one mode, and its
    inverse would lose digits by the ratio of this mode to the others.
    """
    body, same_body = (_engine(np.random.default_rng(seed)) for _ in range(2))
    away = np.array([0, 1e-12, 1e-7, 3e-6, 1e-5, 3e-5, 1e-4, 1e-3, 5e-3, 0.02])
    nu = np.outer(body.modes().omega, 1 + away * (-1) ** seed).ravel()
    load = body.load(torque=(0, 200, 0))

    def motions(system):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vv.ConvergenceWarning)
            return vv.forced_response(
                system, nu, load=load, method="newton", harmonics=7, tolerance=1e-12
            )

    condensed = motions(body)
    monkeypatch.setattr(Body, "_condensation", None)
    whole = motions(same_body)
    apart = np.abs(condensed.coefficients - whole.coefficients).max(axis=(1, 2))
    apart /= np.abs(whole.coefficients).max(axis=(1, 2))
    # Near a hardening resonance the two may lie on different branches.
    same = condensed.converged & whole.converged & (apart < 1e-4)
    assert same.sum() > 40
    # Regression: errors of 5e-10 before modes within a hundredth became separate unknowns.
    assert apart[same].max() < 5e-12
