"""Systems of 4 to 7 coordinates with few forces or memory, which the library condenses."""

import numpy as np

from referee.case import even, few
from referee.models import Draft, Memory, Model, Term


def hidden(rng: np.random.Generator, damping: float, memory: Memory | None) -> Model:
    """Draw a chain or full matrices, with or without proportional damping; memory on a part or none."""
    n = int(rng.integers(4, 8))
    places = sorted(rng.choice(n, int(rng.integers(1, n // 2 + 1)), replace=False))
    mass = np.round(rng.uniform(0.6, 2, n), 3)
    if rng.random() < 0.5:
        k = np.round(rng.uniform(0.5, 1.8, n + 1), 3)
        matrix = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    else:
        a = rng.normal(size=(n, n))
        matrix = a @ a.T / n + 0.3 * np.eye(n)
        matrix = 0.5 * (matrix + matrix.T)
    matrix = np.round(matrix, 6)
    lost = damping * matrix
    if rng.random() < 0.5:
        own = rng.uniform(0, 2, n)
        lost = lost + damping * np.diag(own)
    terms = [_term(rng, n, d) for d in places[: int(rng.integers(1, len(places) + 1))]]
    more = []
    if memory is not None:
        held = [d for d in places if rng.random() < 0.6] or places[:1]
        spring = np.zeros((n, n))
        for d in held:
            spring[d, d] = even(rng, 0.1, 0.8, 3)
        if len(held) > 1:
            pull = even(rng, 0.1, 0.5, 3)
            i, j = held[:2]
            spring[[i, j], [i, j]] += pull
            spring[i, j] = spring[j, i] = -pull
        kept = [_term(rng, n, held[0])] if rng.random() < 0.5 else []
        more = [(np.round(spring, 6), kept, memory)]
    return Draft(mass, np.round(lost, 9), matrix, terms, None, more).model()


def _term(rng: np.random.Generator, n: int, d: int) -> Term:
    power = 3 if rng.random() < 0.7 else 2
    size = few(rng, 0.05, 0.6, 3) * (1 if power == 3 or rng.random() < 0.5 else -1)
    return Term(size, tuple(power * int(k == d) for k in range(n)), int(d))
