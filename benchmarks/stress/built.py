"""Results of one build of the library: ``python built.py BUILD_FOLDER OUT.npz``.

Every result is an array; a refusal or any exception is stored as text.
"""

import importlib.util
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]


def load(build: Path) -> Any:
    """The package of this checkout with the compiled core of the given build."""
    # The editable installation would otherwise use its own build.
    sys.meta_path[:] = [f for f in sys.meta_path if "editable" not in type(f).__module__]
    source = ROOT / "python" / "viscovib"
    spec = importlib.util.spec_from_file_location(
        "viscovib", source / "__init__.py",
        submodule_search_locations=[str(source), str(build / "python")],
    )  # fmt: skip
    if spec is None or spec.loader is None:
        raise ImportError(f"{source}: cannot be imported")
    module = importlib.util.module_from_spec(spec)
    sys.modules["viscovib"] = module
    spec.loader.exec_module(module)
    from viscovib import _native

    if Path(_native.core.__file__).parent != build / "python":
        raise ImportError(f"{_native.core.__file__} was imported, not the core of {build}")
    return module


def results() -> dict[str, Callable[[], Any]]:
    """Every result by name; results with a reference have the names of flags.REFERENCES."""
    import viscovib as vv
    from rounding import BASE, OF_MOUNT
    from scenes import DAMPING, PENDULUM, START, kernel_of, mount, parts_of

    pend = vv.Pendulum(**PENDULUM)
    bare = mount(kernel=None, damping=DAMPING)
    remembering = mount(kernel=vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05))
    creeping = mount(kernel=vv.RzhanitsynKernel(amplitude=0.078, alpha=0.1, beta=0.05))
    jobs: dict[str, Callable[[], Any]] = {
        f"ten inputs: {name}": lambda job=job: job(BASE) for name, job in OF_MOUNT.items()
    }

    def transforms() -> np.ndarray:
        """R_c and R_s divided by values with 25 digits: ones."""
        lines = (ROOT / "data" / "kernel_transforms.csv").read_text().splitlines()[2:]
        out = []
        for kind, alpha, beta, mu, *exact in (line.split(",") for line in lines):
            if kind != "rzhanitsyn":
                continue
            kernel = vv.RzhanitsynKernel(amplitude=1.0, alpha=float(alpha), beta=float(beta))
            got = kernel.cosine(float(mu)), kernel.sine(float(mu))
            out += [g / float(e) if float(e) else 1.0 + g for g, e in zip(got, exact, strict=True)]
        return np.array(out)

    def exponents() -> np.ndarray:
        branch = vv.trace_response(remembering, (0.8, 3), load=0.2, stability=True)
        return parts_of(branch.exponents[:, 0])

    def endings() -> np.ndarray:
        """Outcomes at loads where successive approximations do not converge."""
        found = []
        for load in (0.1, 1.0, 1e4, 1e200, 1e307):
            r = vv.forced_response(remembering, [0.7, 1.5, 3.0], load=load, method="successive")
            found += [r.outcome == word for word in ("converged", "diverged", "stalled")]
            found += [np.isnan(r.coefficients.real).all(axis=(1, 2))]
        return np.concatenate(found).astype(float)

    jobs |= {
        "kernel transforms": transforms,
        "sum of exponentials at 200 times": lambda: by_exponentials(vv, kernel_of),
        "motion with memory at t = 100": lambda: vv.simulate(
            remembering, 100, dt=0.25, load=0.5, nu=1.5, tolerance=1e-12, keep="last"
        ).state[-1, ::2],
        "motion of the pendulum at t = 200": lambda: vv.simulate(
            pend, 200, dt=0.5, initial=START, keep="last"
        ).state[-1],
        "the same by verner9": lambda: vv.simulate(
            pend, 200, dt=0.1, initial=START, method="verner9", keep="last"
        ).state[-1],
        "ensemble by dop8": lambda: vv.simulate_ensemble(
            pend, initial=np.tile(START, (11, 1)) * np.linspace(0.5, 1, 11)[:, None],
            t_end=40, dt=0.2, method="dop8", n_threads=1,
        ).state,
        "energy after 1e6 undamped steps of gauss2": lambda: energy(vv),
        "folds of the branch": lambda: vv.trace_response(
            bare, (0.5, 10), load=0.5, harmonics=31, tolerance=1e-13, stability=False
        ).folds,
        "multipliers along the branch": lambda: multipliers(vv, bare),
        "response 1e-6 from a fold": lambda: parts_of(vv.forced_response(
            bare, [2.268893724956, 2.593183316412], load=0.5, method="newton", harmonics=31,
            tolerance=1e-13,
        ).coefficients[:, :, 0]),
        "roots of the slow creep": lambda: roots(creeping),
        "stability with memory": exponents,
        "torus of the pendulum": lambda: vv.forced_response(
            vv.Pendulum(**(PENDULUM | {"c1": 0.1, "c2": 0.1, "c3": 0.1, "m02": 0.0})),
            harmonics=10, stability=False,
        ).state(0, np.linspace(0, 50, 40)),
        "resonant steady motions": lambda: scales(vv),
        "spectrum": lambda: vv.spectrum(
            vv.simulate(pend, 500, dt=0.25, initial=START).state, 0.25
        ).amplitude,
        "endings, and NaN where there is no solution": endings,
    }  # fmt: skip
    return jobs


def by_exponentials(vv: Any, kernel_of: Callable[..., Any]) -> np.ndarray:
    """A kernel as a sum of exponentials, at times over 9 decades."""
    few = kernel_of(0.8, 0.1).sum_of_exponentials(t_min=1e-6, t_max=1e3, tolerance=1e-13)
    t = np.geomspace(1e-6, 1e3, 200)
    return np.array([few.weights @ np.exp(-few.rates * x) for x in t]) * t**0.9


def energy(vv: Any) -> np.ndarray:
    """Sum of squares after many small steps of an undamped oscillator: 1."""
    run = vv.simulate(
        vv.PolynomialSystem(mass=1, stiffness=1), 2e4, dt=0.02, initial=[1, 0], method="gauss2",
        keep="last",
    )  # fmt: skip
    return (run.state[-1:] ** 2).sum(axis=1)


def roots(body: Any) -> np.ndarray:
    """Characteristic roots, real and imaginary parts."""
    found = body.characteristic_roots()
    pairs = np.sort_complex(np.asarray(found.oscillatory))
    return np.concatenate([pairs.real, pairs.imag, np.atleast_1d(found.real).astype(float)])


def multipliers(vv: Any, body: Any) -> np.ndarray:
    """Largest multipliers at about forty points."""
    branch = vv.trace_response(body, (0.5, 4), load=0.5, harmonics=15, tolerance=1e-12)
    return np.abs(branch.multipliers).max(axis=1)[:: max(1, len(branch.nu) // 40)][:40]


def scales(vv: Any) -> np.ndarray:
    """Amplitudes of steady motions near a resonance."""
    pend = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, c3=0.005, f0=0.004,
                       p1=1.02)  # fmt: skip
    r = vv.MultipleScales(pend).response("p1", np.linspace(0.97, 1.08, 50))
    return np.sort(np.abs(r.amplitudes).max(axis=-1))


def main() -> None:
    """Compute and store everything."""
    build, out = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    load(build)
    sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
    warnings.simplefilter("ignore")
    found = {}
    for name, job in results().items():
        try:
            found[name] = np.asarray(job())
        except Exception as error:  # a build with wrong results is the object of this test
            found[name] = np.array(f"{type(error).__name__}: {error}")
    np.savez(out, **found)


if __name__ == "__main__":
    main()
