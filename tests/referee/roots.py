"""Eigenvalues of the ordinary equations with memory states, determinants otherwise; free decay."""

import numpy as np

from referee.case import Case, Claim, even, few
from referee.models import chain, mount, prony, some_memory, some_prony

JUDGES = (
    "CharacteristicRoots", "CharacteristicRoots.growth_rate",
    "CharacteristicRoots.logarithmic_decrement", "Mount.characteristic_roots",
    "PolynomialSystem.characteristic_roots", "free_decay", "FreeDecay", "FreeDecay.frequency",
    "FreeDecay.logarithmic_decrement",
)  # fmt: skip


def _system(rng, index, memory):
    if index % 3 == 0:
        return mount(rng, damped=few(rng, 1e-5, 0.05, 2), memory=memory)
    return chain(rng, int(rng.integers(1, 5)), few(rng, 1e-5, 0.1, 2), memory=memory).model()


def _roots(rng, index):
    memory = [None, some_prony(rng), some_prony(rng), some_memory(rng)][index % 4]
    if index % 8 == 2:
        # The kernel relaxes more than the stiffness: the body creeps away.
        rate = few(rng, 0.05, 1, 2)
        memory = prony([float(f"{rate * rng.uniform(1.02, 1.5):.3g}")], [rate])
    model = _system(rng, index // 2, memory)
    call = f"""system = {model.source}
roots = system.characteristic_roots()
swings, real, n_unstable, complete = roots.oscillatory, roots.real, roots.n_unstable, roots.complete
rate, decrement = roots.growth_rate, roots.logarithmic_decrement
"""

    def judge(names, reported):
        swings = names["swings"]
        yield Claim("complete", bool(names["complete"]), True)
        own = -2 * np.pi * swings.real / swings.imag
        yield Claim("decrement", names["decrement"], own, 1e-13 * np.abs(own) + 1e-300)
        listed = np.concatenate([swings.real, names["real"]])
        yield Claim("growth_rate", names["rate"], listed.max(), 1e-15 * abs(listed.max()) + 1e-300)
        if memory is not None and memory.rates is None:
            for s in swings:
                d = (
                    s**2 * model.mass
                    + s * model.damping
                    + sum(
                        g.slope(np.zeros(model.n))
                        * (1 if g.memory is None else 1 - g.memory.laplace(s))
                        for g in model.groups
                    )
                )
                values = np.linalg.svd(d, compute_uv=False)
                yield Claim(
                    "determinant at a root", 1 + values[-1] / values[0], 1.0, 1e-10, damage=1e-8
                )
            return
        values = np.linalg.eigvals(model.linearised(np.zeros((1, model.n)))[0])
        size = np.abs(values).max()
        up = values[values.imag > 1e-7 * size]
        up = up[np.argsort(up.imag)]
        yield Claim(
            "oscillatory roots",
            swings,
            up,
            1e-9 * np.abs(up) if len(up) == len(swings) else 1.0,
            damage=1e-6,
        )
        unstable = int((values.real > 1e-10 * size).sum())
        if not (np.abs(values.real) < 1e-10 * size).any():
            yield Claim("n_unstable", names["n_unstable"], unstable)
        flat = np.sort(values.real[np.abs(values.imag) <= 1e-7 * size])[::-1]
        positive = flat[flat > 1e-9 * size]
        got = names["real"][names["real"] > 0]
        if memory is not None:
            yield Claim("count of positive real roots", got.size, positive.size)
            if got.size == positive.size and got.size:
                yield Claim("positive real roots", got, positive, 1e-9 * size, damage=1e-3)

    return Case(call, judge)


def _decay(rng, index):
    model = chain(rng, int(rng.integers(1, 3)), few(rng, 0.003, 0.05, 2)).model()
    n = model.n
    source = model.source[: model.source.index("forces=")].rstrip().rstrip(",") + ",\n)"
    state = np.zeros(2 * n)
    state[::2] = [even(rng, 0.2, 1, 2) for _ in range(n)]
    start = even(rng, 0, 5, 2)
    call = f"""system = {source}
run = vv.simulate(system, 80, dt=0.25, initial={state.tolist()})
decay = vv.free_decay(run, count={n}, start={start})
roots, amplitudes, residual = decay.roots, decay.amplitudes, decay.residual
frequency, decrement = decay.frequency, decay.logarithmic_decrement
"""

    def judge(names, reported):
        k, m, c = model.stiffness, model.mass, model.damping
        inverse = np.linalg.inv(m)
        companion = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ k, -inverse @ c]])
        values, vectors = np.linalg.eig(companion)
        shares = np.linalg.solve(vectors, np.concatenate([state[::2], state[1::2]]))
        up = values.imag > 0
        true = np.sort_complex(values[up])
        order = np.argsort(names["roots"].real)
        got = names["roots"][order]
        # The shape of a mode with hardly any motion is lost in rounding errors.
        moved = np.abs(vectors[:n, up] * shares[up]).max(axis=0)
        if moved.min() < 1e-3:
            return
        yield Claim(
            "roots of a decay",
            got[np.argsort(got.imag)],
            true[np.argsort(true.imag)],
            1e-8,
            damage=1e-6,
        )
        place = [int(np.argmin(np.abs(values - s))) for s in names["roots"]]
        own = (2 * vectors[:n, place] * shares[place]).T
        yield Claim(
            "amplitudes of a decay", names["amplitudes"], own, 1e-6 * np.abs(own).max(), damage=1e-4
        )
        yield Claim("frequency", names["frequency"], names["roots"].imag, 1e-14)
        decrement = -2 * np.pi * names["roots"].real / names["roots"].imag
        yield Claim("decrement", names["decrement"], decrement, 1e-13 * np.abs(decrement))
        yield Claim("residual", 1 + names["residual"], 1.0, 1e-8, damage=1e-6)

    return Case(call, judge)


def case(rng, index):
    """Draw a linear system."""
    return _decay(rng, index // 4) if index % 4 == 3 else _roots(rng, index)
