"""Linear motions of condensed systems where an element is at rest, against a solution of it all."""

import numpy as np
import pytest
import viscovib as vv

WEIGHTS, RATES = np.array([0.1, 0.3]), np.array([0.5, 3.0])
EPS = np.finfo(float).eps


def chain(seed):
    """A chain under light damping, where cubic springs are, and frequencies that hold one still."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(9, 20))
    k = rng.uniform(0.5, 2) * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    places = np.sort(rng.choice(n, rng.integers(1, 4), replace=False))
    rest = np.delete(np.delete(k, places[0], 0), places[0], 1)
    still = np.sqrt(np.linalg.eigvalsh(rest))
    nu = np.concatenate([still, still * (1 + 1e-6), rng.uniform(0.1, 2.5, 8)])
    load = np.zeros(n)
    load[rng.integers(n)] = 1
    return k, 10 ** rng.uniform(-7, -1) * k, places, nu, load


def worst(found, stiffness, load):
    """Largest error of all motions in units of what rounding and the condition leave."""
    errors = []
    for u, d in zip(found, stiffness, strict=True):
        true = np.linalg.solve(d, load)
        errors.append(np.abs(u - true).max() / np.abs(true).max() / np.linalg.cond(d) / EPS)
    return max(errors)


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("remembers", [False, True])
def test_linear_motions_keep_their_digits_where_an_element_is_at_rest(seed, remembers):
    """Before, up to 1e7 times as much was lost: 1e-7 of the motion at a damping of 1e-5."""
    k, c, places, nu, load = chain(seed)
    n = load.size
    laws = {f"x{a + 1}": f"x{a + 1}^3" for a in places}
    held = np.zeros((n, n))
    springs = []
    if remembers:
        held[places, places] = 0.3
        kernel = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
        springs = [vv.Springs(stiffness=held, forces=laws, kernel=kernel)]
    body = vv.PolynomialSystem(
        mass=np.ones(n), stiffness=k, damping=c, springs=springs,
        forces={} if remembers else laws,
    )  # fmt: skip
    motion = vv.forced_response(body, nu, load=load, method="linear")
    relaxed = [1 - (WEIGHTS / (RATES + 1j * w)).sum() for w in nu]
    stiffness = [
        k - w**2 * np.eye(n) + 1j * w * c + f * held for w, f in zip(nu, relaxed, strict=True)
    ]
    assert worst(motion.coefficients[:, :, 0], stiffness, load) < 300


@pytest.mark.parametrize("seed", range(10))
def test_so_do_structures(seed):
    k, c, places, nu, load = chain(seed)
    n = load.size
    elements = [vv.Spring(on=f"x{a + 1}", stiffness=0.2, law="d^3") for a in places]
    body = vv.Structure(mass=np.ones(n), stiffness=k, damping=c, elements=elements)
    wanted = [f"x{i + 1}" for i in range(n)]
    motion = vv.forced_response(body, nu, load=load, method="linear", coordinates=wanted)
    held = np.zeros((n, n))
    held[places, places] = 0.2
    stiffness = [k - w**2 * np.eye(n) + 1j * w * c + held for w in nu]
    assert worst(motion.coefficients[:, :, 0], stiffness, load) < 300
