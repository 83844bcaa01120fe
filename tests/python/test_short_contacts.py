"""Contacts shorter than a step, against the closed-form motion of a mass."""

import numpy as np
import pytest
import viscovib as vv


def bouncing(gap: float, spring: float, t: float) -> np.ndarray:
    """State of x'' + x + spring*max(x - gap, 0) = 0 a time t after x = 1, x' = 0."""
    rate = np.sqrt(1 + spring)
    rest = spring * gap / (1 + spring)
    half = np.arccos((gap - rest) / (1 - rest)) / rate
    speed = -rate * (1 - rest) * np.sin(rate * half)
    amplitude, phase = np.hypot(gap, speed), np.arctan2(-speed, gap)
    period = 2 * half + 2 * np.pi - 2 * phase
    now = t % period
    if now > period / 2:
        return bouncing(gap, spring, period - now) * [1, -1]
    if now < half:
        angle = rate * now
        return np.array([rest + (1 - rest) * np.cos(angle), -rate * (1 - rest) * np.sin(angle)])
    angle = now - half + phase
    return np.array([amplitude * np.cos(angle), -amplitude * np.sin(angle)])


def random_contacts(count: int, seed: int) -> list[tuple[float, float, float]]:
    rng = np.random.default_rng(seed)
    return [
        (1 - 10 ** rng.uniform(-9, -1), 10 ** rng.uniform(0, 4), rng.uniform(0, 6))
        for _ in range(count)
    ]


@pytest.mark.parametrize("method", ["auto", "gauss16"])
def test_contacts_are_met_wherever_they_lie_in_a_step(method: str) -> None:
    for gap, spring, start in random_contacts(60, 3):
        system = vv.PolynomialSystem(
            mass=1, stiffness=1, forces="k*max(x - g, 0)", parameters={"k": spring, "g": gap}
        )
        run = vv.simulate(
            system, 30, initial=bouncing(gap, spring, start), tolerance=1e-9, method=method
        )
        error = np.abs(run.state[-1] - bouncing(gap, spring, start + 30)).max()
        assert error < max(10 * run.error, 1e-10), (gap, spring, start, error, run.error)


def test_grazing_contacts_are_met_in_given_steps() -> None:
    for gap, spring, start in random_contacts(60, 4):
        gap = 1 - (1 - gap) * 1e-3
        system = vv.PolynomialSystem(mass=1, stiffness=1, forces=f"{spring!r}*max(x - {gap!r}, 0)")
        run = vv.simulate(system, 30, initial=bouncing(gap, spring, start), dt=0.2)
        error = np.abs(run.state[-1] - bouncing(gap, spring, start + 30)).max()
        assert error < 1e-10, (gap, spring, start, error)
