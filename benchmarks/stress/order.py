"""Order of summation and order of members, which must not matter."""

from collections.abc import Callable, Iterator

import numpy as np
import viscovib as vv
from scenes import PENDULUM, START, far, kernel_of, parts_of
from steps import Job
from tally import Row, Tally


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """One job per row."""
    for name in OF_ORDER:
        yield f"order, {name}", lambda n=name: order_of_summation(n)
    yield "lanes", order_of_lanes


Shuffled = Callable[[vv.PolynomialSystem, dict[int, complex]], np.ndarray]


def _by(method: str) -> Shuffled:
    return lambda body, load: parts_of(
        vv.forced_response(
            body, [0.6, 1.1, 1.9], load=load, method=method, tolerance=1e-14
        ).coefficients
    )


#: Results of a system with permuted terms under a load with permuted terms, by method.
OF_ORDER: dict[str, Shuffled] = {
    "linear response": _by("linear"),
    "successive approximations": lambda body, load: parts_of(
        vv.forced_response(
            body, [0.3, 3.0], load={k: 0.1 * v for k, v in load.items()}, method="successive",
            tolerance=1e-14,
        ).coefficients
    ),
    "Newton response": _by("newton"),
    "motion with memory": lambda body, load: vv.simulate(
        body, 20, dt=0.2, load=[0.2, 0], nu=1.1
    ).state,
    "branch with exponents": lambda body, load: np.concatenate(
        [
            np.ravel(parts_of(branch.coefficients[:, :, 0]))
            for branch in [vv.trace_response(body, (0.5, 1.5), load=load, tolerance=1e-13)]
        ]
    ),
    "characteristic roots": lambda body, load: parts_of(
        np.sort_complex(np.asarray(body.characteristic_roots().oscillatory))
    ),
}  # fmt: skip


def order_of_summation(name: str) -> Row:
    """Terms of kernels, loads and forces in another order."""
    tally = Tally(
        "order", f"{name}: terms of kernel, load and forces permuted", "20 permutations", 1e-12,
        "change over the size of the result",
    )  # fmt: skip
    rng = np.random.default_rng(3)
    few = kernel_of(0.8, 0.25).sum_of_exponentials(tolerance=1e-8, t_min=1e-3, t_max=1e3)
    weights, rates = np.asarray(few.weights), np.asarray(few.rates)
    loads = {1: 0.2, 3: 0.05, 5: 0.02j, 7: 0.01}
    terms = ["0.5*x1^3", "0.2*x1*x2^2", "-0.1*x1^2*x2", "0.05*x2^3"]

    def job(order: np.ndarray, load: np.ndarray, force: np.ndarray) -> np.ndarray:
        body = vv.PolynomialSystem(
            mass=[1, 0.5], stiffness=[[2, -1], [-1, 3]], damping=[[0.1, 0], [0, 0.1]],
            forces={"x1": " + ".join(terms[i] for i in force)},
            kernel=vv.PronyKernel(weights=weights[order], rates=rates[order]),
        )  # fmt: skip
        return OF_ORDER[name](body, {list(loads)[i]: loads[list(loads)[i]] for i in load})

    exact = job(np.arange(rates.size), np.arange(4), np.arange(4))
    for i in range(20):
        made = tally.trial(
            f"permutation {i}",
            lambda: job(rng.permutation(rates.size), rng.permutation(4), rng.permutation(4)),
        )
        if made is not None:
            tally.check(f"permutation {i}", made.shape == exact.shape, "another shape")
            if made.shape == exact.shape:
                tally.measure(f"permutation {i}", far(made, exact))
    return tally.row()


def order_of_lanes() -> Row:
    """Members of an ensemble in another order, lanes and threads: bitwise equal."""
    tally = Tally(
        "order", "members of an ensemble permuted", "5 permutations, 1 and 2 threads", 0.5,
        "members that differ in any bit",
    )  # fmt: skip
    states = np.tile(START, (37, 1))
    states[:, 2] = np.linspace(-0.5, 0.5, 37)
    body = vv.Pendulum(**PENDULUM)

    def job(order: np.ndarray, threads: int) -> np.ndarray:
        many = vv.simulate_ensemble(
            body, initial=states[order], t_end=40, dt=0.4, n_threads=threads
        )
        back = np.empty_like(many.state)
        back[order] = many.state
        return back

    exact = job(np.arange(37), 1)
    for i in range(5):
        order = np.random.default_rng(i).permutation(37)
        made = tally.trial(f"permutation {i}", lambda o=order, i=i: job(o, 1 + i % 2))
        if made is not None:
            tally.measure(f"permutation {i}", int((made != exact).any(axis=1).sum()))
    return tally.row()
