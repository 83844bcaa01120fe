"""Data of a motion of a structure for the core: linear subsystem, load and start in modes."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib._native import ComplexArray
from viscovib.systems.relaxing_rest import remembered_of
from viscovib.systems.structure_rest import in_modes

#: Relative size of rounding errors.
_ROUNDING = 1e-14


def modal_arrays(motion: Any) -> dict[str, Any]:
    """Arrays of the structure, its load and its start in modes, for the core."""
    c = motion.loaded.condensation
    rest, inertia = c.rest, motion.loaded._inertia
    mass: Any = motion.mount.mass
    place, speed = motion.base_state(0.0) if motion.moves_base else (0.0, 0.0)
    place_of, speed_of = motion.start, motion.speed
    b = motion.mount._base_direction
    if b is not None:
        place_of, speed_of = place_of - place * b, speed_of - speed * b
    start, start_rates, others = in_modes(rest, mass, place_of, speed_of)
    shown = np.concatenate([rest.shapes[motion.places].T, c.seen], axis=1)
    direction = np.zeros(shown.shape[1])
    if b is not None:
        direction[: motion.places.size] = b[motion.places]
    # Loads, and the inertia relative to a moving base.
    forces = np.zeros((motion.start.size, max(motion.frequencies.size, 1)), complex)
    if motion.frequencies.size:
        forces = motion.loaded.forces + np.outer(
            inertia, motion.frequencies**2 * motion.loaded.base
        )
    given = {
        "elements": c.law_vector(np.zeros(c.q)),
        "squares": rest.squares, "rates": rest.rates, "seen": c.seen, "pushed": c.seen,
        "patterns": rest.shapes.T @ motion.patterns,
        "frequencies": motion.frequencies if motion.frequencies.size else np.zeros(1),
        "waves": rest.shapes.T @ forces,
        "base_waves": motion.loaded.base if motion.frequencies.size else np.zeros(1, complex),
        "shown": shown, "direction": direction, "inner": rest.shapes.T @ inertia,
        "start": start, "start_rates": start_rates,
    }  # fmt: skip
    if not rest.squares.size:
        # Add one mode that does not move.
        given |= {
            name: np.zeros((1, *np.shape(given[name])[1:]), np.asarray(given[name]).dtype)
            for name in (
                "squares", "rates", "seen", "pushed", "patterns", "waves", "shown", "inner",
                "start", "start_rates",
            )
        }  # fmt: skip
    given |= _others(motion, forces, others)
    return {
        name: value if isinstance(value, int) else np.asfortranarray(value)
        for name, value in given.items()
    }


def _others(motion: Any, forces: ComplexArray, start: ComplexArray) -> dict[str, Any]:
    """Arrays of the complex modes: one of two conjugate poles, which counts twice.

    The state (u, u') is sum_l (left_l, pole_l left_l) z_l with
    z_l = right_l . ((pole_l M + C) u + M u').
    """
    c = motion.loaded.condensation
    rest, q = c.rest, c.q
    kept = np.flatnonzero(rest.poles.imag >= 0)
    past = [remembered_of(one, motion.before, motion.whole_past) for one in rest.remembered]
    at_once = _at_once(motion, forces)
    if not kept.size and not at_once["left"].shape[0]:
        none = np.zeros((1, max(motion.frequencies.size, 1)), complex)
        return {
            "poles": none[0, :1], "left": np.zeros((1, q), complex),
            "right": np.zeros((1, q + motion.patterns.shape[1]), complex), "sine": none,
            "cosine": none, "by_base": np.zeros((1, 2), complex),
            "shown_left": np.zeros((1, motion.places.size + q), complex),
            "start_others": none[0, :1], "n_at_once": 0,
        }  # fmt: skip
    poles, right = rest.poles[kept], rest.right[:, kept]
    twice = np.where(poles.imag > 0, 2.0, 1.0)
    left = rest.left[:, kept] * twice
    mass: Any = motion.mount.mass
    b = motion.mount._base_direction
    moved = np.zeros((kept.size, 2), complex)
    if b is not None:
        zero = np.zeros_like(b)
        kicks = [(b, zero), (zero, b)]
        moved = np.stack([in_modes(c.rest, mass, *kick)[2][kept] for kick in kicks], axis=1)
    seen = c.left[kept] * twice[:, np.newaxis]
    found = {
        "poles": poles, "left": seen,
        "right": np.concatenate([c.right[kept], right.T @ motion.patterns], axis=1),
        "sine": right.T @ forces.real, "cosine": right.T @ forces.imag, "by_base": moved,
        "shown_left": np.concatenate([left[motion.places].T, seen], axis=1),
        "start_others": start[kept]
        + sum(one.pushed[kept] @ y for one, y in zip(rest.remembered, past, strict=True)),
    }  # fmt: skip
    return {name: np.concatenate([part, at_once[name]]) for name, part in found.items()} | {
        "n_at_once": at_once["left"].shape[0]
    }


def _at_once(motion: Any, forces: ComplexArray) -> dict[str, Any]:
    """Massless part, z_m = right_m . forces: a basis of all its deflections."""
    c = motion.loaded.condensation
    n, q, k = forces.shape[0], c.q, motion.patterns.shape[1]
    moved = np.zeros((n, q + k + 2 * forces.shape[1]))
    if c.rest.flexibility is not None:
        pushes = [c.laws.directions, motion.patterns, forces.real, forces.imag]
        moved, _ = c.rest.flexibility(np.concatenate(pushes, axis=1))
    left, sizes, _ = np.linalg.svd(moved, full_matrices=False)
    left = left[:, sizes > _ROUNDING * max(float(sizes.max(initial=0.0)), 1e-300)]
    answer = (left.T @ moved).astype(complex)
    zero = np.zeros(left.shape[1], complex)
    seen = left.T @ c.laws.directions
    return {
        "poles": zero, "left": seen, "right": answer[:, : q + k],
        "sine": answer[:, q + k : q + k + forces.shape[1]],
        "cosine": answer[:, q + k + forces.shape[1] :], "by_base": np.zeros((zero.size, 2)),
        "shown_left": np.concatenate([left[motion.places].T, seen], axis=1),
        "start_others": zero,
    }  # fmt: skip
