"""
From rubber data to a band
==========================

A published table of storage and loss moduli gives a master curve, a kernel with intervals, and
the band of the transmissibility of an engine at 90 deg C.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import viscovib as vv

table = Path(vv.__file__).parents[2] / "data/rubber/pyvisco_freq_user_raw.csv"
warm = vv.read_dma(table).sets()[-6:]
columns = ("frequencies", "storage", "loss", "temperature", "set")
data = vv.ModulusData(**{c: np.concatenate([getattr(s, c) for s in warm]) for c in columns})
master = vv.master_curve(data, reference=80, by="both")
fit = vv.fit_kernel(master, kind="rabotnov")
hz = np.linspace(4, 40, 120)


def decibels(sample):
    """Force on the floor over that on the engine, of three mounts."""
    size = sample.modulus * 1e-3
    mounts = [
        vv.MountPoint(name=n, position=p, stiffness=(size,) * 3, kernel=sample.kernel.at(90))
        for n, p in {"a": (0.3, 0.4, 0), "b": (0.3, -0.4, 0), "c": (-0.4, 0, 0)}.items()
    ]
    engine = vv.Body(mass=164, inertia=(9.9, 4.1, 9.1), mounts=mounts)
    return 20 * np.log10(np.abs(engine.force_transmissibility(2 * np.pi * hz)[:, 2]))


fig, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
fit.plot(axes[0])
band = vv.propagate(fit, decibels, samples=100)
band.plot(hz, axes[1]).set(xlabel="frequency (Hz)", ylabel="transmissibility (dB)")
