"""Modes of a body on mounts: Hz, kinetic energies, decoupling."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Number, Panel, Result, as_dataset
from viscovib.common.tables import Table
from viscovib.errors import InputError

#: A squared frequency below this part of the highest is a rigid-body mode.
_RIGID = 1e-12


@dataclass(frozen=True, eq=False, repr=False)
class BodyModes(Result):
    """Modes of a body about its static equilibrium, damped or undamped (`Body.modes`).

    Attributes
    ----------
    omega : ndarray, shape (m,)
        Circular frequencies (rad/s), ascending; 0 for a rigid-body mode. For a damped mode exp(s t)
        the imaginary part of s.
    shapes : ndarray, shape (n, m)
        One column each, phi^H M phi = 1; complex for damped modes.
    energy : ndarray, shape (n, m)
        Kinetic energy of each coordinate (row) in each mode (column), percent: 100 Re conj(phi_i)
        sum_j M_ij phi_j. Columns add up to 100. Products of inertia are part of their coordinate,
        so a share may be negative.
    loss_factor : ndarray, shape (m,)
        Im/Re of phi^H D(i omega) phi without inertia: the loss factor of kernels and dampers in the
        mode at its own frequency. NaN for a mode at frequency 0.
    damping_ratio : ndarray, shape (m,)
        -Re s/|s| for damped modes; half the loss factor for undamped modes.
    names : tuple of str
        Names of the coordinates.

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> modes = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot], gravity=None).modes()
    >>> modes.decoupling.round(1).tolist()
    [100.0, 100.0, 100.0, 100.0, 100.0, 100.0]
    """

    kind: ClassVar[str] = "modes"

    omega: FloatArray
    shapes: FloatArray | ComplexArray
    energy: FloatArray
    loss_factor: FloatArray
    damping_ratio: FloatArray
    names: tuple[str, ...]

    @property
    def hz(self) -> FloatArray:
        """Frequencies (Hz)."""
        return self.omega / (2 * math.pi)

    @property
    def decoupling(self) -> FloatArray:
        """The largest share of a coordinate in each mode (percent)."""
        return np.asarray(self.energy.max(axis=0))

    def _headline(self) -> str:
        rigid = int(np.sum(self.omega == 0))
        note = f", {rigid} of them rigid-body modes" if rigid else ""
        kind = "damped mode" if np.iscomplexobj(self.shapes) else "mode"
        return (
            f"{things(self.omega.size, kind)} from {self.hz[0]:.6g} to {self.hz[-1]:.6g} Hz{note}"
        )

    def _scope(self) -> list[str]:
        head = "mode        Hz  ratio   loss" + "".join(f"{name:>9}" for name in self.names)
        lines = [f"kinetic energy of each coordinate in percent\n  {head}"]
        for r, hz in enumerate(self.hz):
            shares = "".join(f"{share:9.2f}" for share in self.energy[:, r])
            ratios = f"{self.damping_ratio[r]:7.4f}{self.loss_factor[r]:7.4f}"
            lines.append(f"{r + 1:4d}{hz:10.4f}{ratios}{shares}")
        return lines

    def numbers(self) -> dict[str, Number]:
        """Return frequencies and decoupling, for sweeps."""
        found = {f"f{r + 1}": Number(float(f), "Hz") for r, f in enumerate(self.hz)}
        shares = {
            f"decoupling{r + 1}": Number(float(p), "%") for r, p in enumerate(self.decoupling)
        }
        return found | shares

    def panels(self) -> list[Panel]:
        """Return the shares of each coordinate over the modes."""
        modes = np.arange(1.0, self.omega.size + 1)
        return [
            Panel(modes, self.energy[i], "mode", name, "%") for i, name in enumerate(self.names)
        ]

    def plot(self, *args: Any, **options: Any) -> Any:
        """Draw the table of energies by `plot_energy`; return axes."""
        return import_module("viscovib.plots.bodies").plot_energy(self, *args, **options)

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        return as_dataset(
            {
                "frequency": ("mode", self.hz, {"units": "Hz"}),
                "loss_factor": ("mode", self.loss_factor, {"units": "1"}),
                "damping_ratio": ("mode", self.damping_ratio, {"units": "1"}),
                "energy": (("coordinate", "mode"), self.energy, {"units": "%"}),
                "shape": (("coordinate", "mode"), self.shapes),
            },
            coords={"mode": np.arange(1, self.omega.size + 1), "coordinate": list(self.names)},
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        columns: dict[str, Any] = {
            "mode": np.arange(1, self.omega.size + 1),
            "frequency": self.hz,
            "loss_factor": self.loss_factor,
            "damping_ratio": self.damping_ratio,
        }
        chosen: Any = self.names if coordinates is None else coordinates
        if not isinstance(chosen, (list, tuple)):
            raise InputError(f"coordinates = {_native.shown(chosen)}: must be a list of names")
        for name in chosen:
            if name not in self.names:
                raise InputError(
                    f"coordinates: {_native.shown(name)} must be one of {', '.join(self.names)}"
                )
            columns[f"energy_{name}"] = self.energy[self.names.index(name)]
        return Table(["frequency in Hz, energy in percent of the kinetic energy"], columns)


def find_modes(body: Any, stiffness: FloatArray, what: str = "") -> BodyModes:
    """Solve K phi = omega^2 M phi, phi^T M phi = 1; ``what``: name of a selected stiffness."""
    from scipy.linalg import eigh

    squares, shapes = eigh(stiffness, body._mass_matrix)
    largest = np.abs(squares).max()
    if squares[0] < -_RIGID * largest and what:
        raise InputError(f"stiffness = {what}: is negative in a direction, the rubber only creeps")
    if squares[0] < -_RIGID * largest:
        raise InputError(
            "mounts: the static equilibrium is unstable, a mode grows like "
            f"exp({math.sqrt(-squares[0]):.6g} t)"
        )
    omega = np.sqrt(np.where(squares > _RIGID * largest, squares, 0.0))
    return _modes_of(body, omega, shapes)


def find_damped_modes(body: Any) -> BodyModes:
    """Solve D(s) phi = 0, phi^H M phi = 1; rigid-body modes come first."""
    undamped = find_modes(body, body._stiffness_at_rest)
    free = undamped.omega == 0
    roots, shapes = body._damped_roots
    if not roots.size and not free.any():
        raise InputError(
            "mounts: no mode oscillates, all free motions creep, or the table of a kernel is too "
            "long for decaying motions (pass kernel.sum_of_exponentials(t_min=, t_max=)); "
            "modes(stiffness='instantaneous') gives undamped modes"
        )
    omega = np.append(undamped.omega[free], roots.imag)
    shapes = np.hstack([undamped.shapes[:, free], shapes])
    ratio = np.append(np.full(free.sum(), np.nan), -roots.real / np.abs(roots))
    return _modes_of(body, omega, shapes, ratio)


def _modes_of(
    body: Any, omega: FloatArray, shapes: Any, ratio: FloatArray | None = None
) -> BodyModes:
    energy = 100 * (shapes.conj() * (body._mass_matrix @ shapes)).real
    held = omega > 0
    # Zero without kernels and dampers.
    loss = np.where(held, 0.0, np.nan)
    if held.any() and (body._active_kernels or body._damping.any()):
        dynamic = body.dynamic_stiffness(omega[held])
        modal = np.einsum("ar,rab,br->r", shapes[:, held].conj(), dynamic, shapes[:, held])
        loss[held] = modal.imag / (modal.real + omega[held] ** 2)
    return BodyModes(
        omega, shapes, energy, loss, loss / 2 if ratio is None else ratio, body.dof_names
    )
