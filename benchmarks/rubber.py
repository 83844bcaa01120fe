"""Rubber from measured data: fits, master curves, bands, relaxation; compared with pyvisco."""

import importlib.util
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import viscovib as vv
from timing import least, show_time

Row = dict[str, Any]
DATA = Path(__file__).parents[1] / "data" / "rubber"
NU = np.geomspace(1e-3, 1e5, 206)


def measured(kernel: vv.Kernel) -> vv.ModulusData:
    """206 frequencies with 1 % noise."""
    scatter = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, NU.size))
    stiff = 2e6 * (1 - kernel.transform(NU))
    return vv.ModulusData(
        frequencies=NU, storage=stiff.real * scatter[0], loss=stiff.imag * scatter[1]
    )


def peer(data: vv.ModulusData) -> list[Row]:
    """Fit the published master curve with pyvisco, if installed: one term per decade."""
    if importlib.util.find_spec("pyvisco") is None:
        return []
    import pandas as pd
    from pyvisco import prony

    frame = pd.DataFrame(
        {"omega": data.frequencies, "f": data.frequencies / (2 * np.pi)}
        | {f"E_{part}{end}": getattr(data, name) / 1e6
           for part, name in (("stor", "storage"), ("loss", "loss")) for end in ("", "_filt")}
    )  # fmt: skip
    rows = []
    for title, optimised in (("first guess", False), ("optimised", True)):

        def job(optimised: bool = optimised) -> Any:
            frame.domain, frame.modul, frame.RefT = "freq", "E", 0.0
            coarse = prony.discretize(frame)
            return prony.fit_freq(coarse, frame, opt=optimised)

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = job()
            time = least(job, 3)
        terms = found["df_terms"]
        share, tau = terms["alpha_i"].to_numpy(), terms["tau_i"].to_numpy()
        x = np.outer(np.asarray(data.frequencies), tau)
        whole = found["E_0"] * 1e6
        storage = whole * (1 - share.sum() + (x * x / (1 + x * x)) @ share)
        loss = whole * (x / (1 + x * x)) @ share
        rows.append(
            {
                "job": f"pyvisco, {title}, {tau.size} terms", "seconds": time, "target": 0.0,
                "storage": float(np.sqrt(np.mean((storage / data.storage - 1) ** 2))),
                "loss": float(np.sqrt(np.mean((loss / data.loss - 1) ** 2))),
            }
        )  # fmt: skip
    return rows


def run() -> list[Row]:
    """One row per job: time, target time, residuals of storage and loss."""
    warnings.simplefilter("ignore")
    rows: list[Row] = []

    def add(job: str, time: float, target: float, fit: Any = None) -> None:
        both = fit.residual if fit is not None else (float("nan"),) * 2
        rows.append(
            {"job": job, "seconds": time, "target": target, "storage": both[0], "loss": both[1]}
        )
        print(f"{job:60} {show_time(time):>8} {show_time(target):>8}")

    kernels = {
        "rabotnov": vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3),
        "rzhanitsyn": vv.RzhanitsynKernel(amplitude=0.05, alpha=0.3, beta=0.05),
        "abel": vv.AbelKernel(amplitude=0.02, alpha=0.1),
    }
    for kind, kernel in kernels.items():
        data = measured(kernel)
        time = least(lambda data=data, kind=kind: vv.fit_kernel(data, kind=kind), 5)
        add(f"fit of {kind}, 206 frequencies, 4 starts", time, 0.05, vv.fit_kernel(data, kind=kind))
    master = vv.read_dma(DATA / "pyvisco_freq_user_master.csv")
    for title, more, target in (
        ("prony, 30 terms, published master curve", {"terms": 30}, 2e-3),
        ("prony, 26 terms, storage alone", {"terms": 26, "loss_weight": 0.0}, 2e-3),
        ("prony, terms chosen, published master curve", {}, 0.01),
    ):
        time = least(lambda more=more: vv.fit_kernel(master, kind="prony", **more))
        add(title, time, target, vv.fit_kernel(master, kind="prony", **more))
    both = ["fractional_zener"] * 2
    add(
        "two fractional Zener elements, published master curve",
        least(lambda: vv.fit_kernel(master, kind=both), 3), 0.0, vv.fit_kernel(master, kind=both),
    )  # fmt: skip
    raw = vv.read_dma(DATA / "pyvisco_freq_user_raw.csv")
    add("master curve of 21 sets", least(lambda: vv.master_curve(raw, reference=20)), 0.05)
    add("Kramers-Kronig check, 206 frequencies", least(lambda: vv.kramers_kronig(master)), 0.05)
    fit = vv.fit_kernel(measured(kernels["rabotnov"]))
    nu = np.linspace(0.3, 12, 1000)

    def curve(sample: vv.Sample) -> Any:
        mount = vv.Mount(
            mass=1, inertia=0.1, offset=0.5, stiffness_x=10 * sample.modulus / fit.modulus,
            stiffness_phi=2, kernel=sample.kernel,
        )  # fmt: skip
        return vv.forced_response(mount, nu, load=0.1, method="linear").amplitude("x")

    add("band of 1000 curves of 1000 frequencies", least(lambda: vv.propagate(fit, curve), 2), 3.0)
    t = np.geomspace(1e-6, 1e8, 50_000)
    tables = {"close to an exponential": vv.RabotnovKernel(amplitude=0.3, alpha=0.98, beta=0.5)}
    for title, kernel in (kernels | tables).items():
        time = least(lambda kernel=kernel: kernel.relaxation(t), 5) / t.size
        add(f"relaxation() of {title}, a value", time, 2e-6)
    for alpha in (0.5, 0.98, 0.99):
        kernel = vv.RabotnovKernel(amplitude=0.3, alpha=alpha, beta=0.5)
        mount = vv.Mount(
            mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel
        )
        time = least(lambda mount=mount: vv.simulate(mount, 1000, load=0.1, nu=1.5), 2)
        add(f"motion to t = 1000, Rabotnov with alpha = {alpha}", time, 0.0)
    return rows + peer(master)
