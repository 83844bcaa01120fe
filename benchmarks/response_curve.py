"""Response curve of the mount: run time against error, compared with harmonic balance in NumPy."""

import warnings

import numpy as np
import viscovib as vv
from timing import pair, seconds, show_time

NU = np.linspace(0.3, 12.0, 1000)
LOAD = 0.05
TARGET_MS, LINEAR_TARGET_MS = 10.0, 1.0


def mount(geometry: str = "cubic") -> vv.Mount:
    """Reference scene, A = 0.048: converges at all frequencies at this load."""
    return vv.Mount(
        mass=1.0,
        inertia=0.1,
        offset=0.5,
        stiffness_x=10.0,
        stiffness_phi=2.0,
        kernel=vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05),
        geometry=geometry,
    )


def numpy_harmonic_balance(tolerance: float = 1e-10, highest: int = 9) -> np.ndarray:
    """The same iteration in plain NumPy: a loop over frequencies, FFTs of a period."""
    from scipy.special import gamma

    c_x, c_phi, arm = 10.0, 2.0, 0.5
    orders = np.arange(1, highest + 1, 2)
    n = 64
    stiffness = np.array([[c_x, -c_x * arm], [-c_x * arm, c_x * arm**2 + c_phi]])
    mass = np.diag([1.0, 0.1])
    curve = np.empty((NU.size, 2, orders.size), dtype=complex)
    spectrum = np.zeros((2, n // 2 + 1), dtype=complex)
    for i, nu in enumerate(NU):
        retained = 1 - 0.048 * gamma(0.1) * (0.05 + 1j * orders * nu) ** -0.1
        dynamic = stiffness * retained[:, None, None] - (orders * nu)[:, None, None] ** 2 * mass
        inverse = np.linalg.inv(dynamic)
        load = np.zeros((orders.size, 2), dtype=complex)
        load[0, 0] = LOAD
        u = np.einsum("kab,kb->ka", inverse, load)
        for _ in range(200):
            spectrum[:, orders] = u.T / 1j * n / 2
            x, phi = np.fft.irfft(spectrum, n)
            force = np.stack(
                [
                    c_x * arm / 6 * phi**3,
                    c_x * arm / 2 * phi**2 * x - 2 / 3 * c_x * arm**2 * phi**3,
                ]
            )
            harmonics = 2j / n * np.fft.rfft(force)[:, orders]
            new = np.einsum("kab,kb->ka", inverse, load - (retained * harmonics).T)
            change = np.abs(new - u).max()
            u = new
            if change <= tolerance * np.abs(u).max():
                break
        curve[i] = u.T
    return curve


def run() -> tuple[list[dict[str, object]], list[dict[str, object]]]:
    """Rows of run time against error, and rows of jobs with their targets."""
    warnings.simplefilter("ignore")
    body = mount()
    reference = vv.forced_response(body, NU, load=LOAD, harmonics=41, tolerance=1e-14)
    scale = reference.amplitude("phi")

    def error(response) -> float:
        first = abs(response.coefficient("phi") - reference.coefficient("phi"))
        return float((first / scale).max())

    rows = []
    for highest in (1, 3, 5, 7, 9, 13, 19, 29):
        for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14):
            options = {"load": LOAD, "harmonics": highest, "tolerance": tolerance}
            rows.append(
                {
                    "harmonics": highest,
                    "tolerance": tolerance,
                    "seconds": seconds(
                        lambda options=options: vv.forced_response(body, NU, **options), repeats=3
                    ),
                    "error": error(vv.forced_response(body, NU, **options)),
                }
            )

    ours, theirs, ratio = pair(
        lambda: vv.forced_response(body, NU, load=LOAD), numpy_harmonic_balance, repeats=5
    )
    agreement = np.abs(
        numpy_harmonic_balance() - vv.forced_response(body, NU, load=LOAD).coefficients
    ).max()
    jobs = [
        {
            "job": "curve of 1000 frequencies, cubic, harmonics 1..9, 1e-10",
            "seconds": ours,
            "target": TARGET_MS / 1e3,
        },
        {"job": "the same, plain NumPy harmonic balance", "seconds": theirs, "target": None},
    ]
    for geometry in ("exact", "printed"):
        other = mount(geometry)
        jobs.append(
            {
                "job": f"curve of 1000 frequencies, {geometry}",
                "seconds": seconds(lambda other=other: vv.forced_response(other, NU, load=LOAD)),
                "target": TARGET_MS / 1e3,
            }
        )
    jobs.append(
        {
            "job": "linear curve of 1000 frequencies",
            "seconds": seconds(lambda: vv.forced_response(body, NU, load=LOAD, method="linear")),
            "target": LINEAR_TARGET_MS / 1e3,
        }
    )
    jobs.append(
        {
            "job": "no memory (kernel=None), 1000 frequencies",
            "seconds": seconds(
                lambda: vv.forced_response(
                    vv.Mount(
                        mass=1,
                        inertia=0.1,
                        offset=0.5,
                        stiffness_x=10,
                        stiffness_phi=2,
                        damping=0.3 * np.eye(2),
                    ),
                    NU,
                    load=LOAD,
                )
            ),
            "target": None,
        }
    )
    print(
        f"curve: {show_time(ours)}; plain NumPy takes {ratio:.0f} times as long "
        f"(largest difference {agreement:.1e})"
    )
    return rows, jobs
