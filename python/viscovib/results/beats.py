"""Beating (quasi-periodic) motions by multiple scales."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Result, as_dataset

#: Highest multiple of a load frequency in the search of line orders, by the number of loads.
_HIGHEST = {1: 24, 2: 24, 3: 16, 4: 6, 5: 3, 6: 2}
#: Frequencies that differ by less than this part of the highest are equal.
_SAME = 2e-9
#: Random phases, starts and steps of the search for the largest value.
_STARTS, _TRIES, _ROUNDS = 4000, 12, 40


@dataclass(frozen=True, eq=False, repr=False)
class BeatingMotion(Result):
    """A quasi-periodic motion under several loads, as a sum of lines.

    u(t) = mean + sum_k Re X_k exp(i f_k t + i n_k . c), where n_k are the multiples of the loads'
    frequencies in f_k, and c the phases of the loads.

    Attributes
    ----------
    value : float
        Value of the parameter that varies.
    n_beats : int
        Number of incommensurate beat frequencies of the amplitudes.
    frequencies : ndarray, shape (n_lines,)
        Circular frequencies f_k (rad/s), ascending, the mean (0) first.
    harmonics : complex ndarray, shape (n_lines, n_dof)
        X_k; for the mean its value.
    errors : ndarray, shape (n_dof,)
        Estimated error of a coordinate at any time, and so of each line, ``mean``, ``rms`` and
        ``largest``.
    growth : float
        Mean exponential growth of small perturbations (1/s); negative: stable. It is that of the
        modulation equations, or of the full equations if the error of the former exceeds it.
    growth_error : float
        Estimated error of ``growth``.
    loads : dict
        Frequencies of the loads by name (rad/s).

    Examples
    --------
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.0102, w2=0.366, w3=0.988, alpha=0.573, c1=0.0258, c2=0.00555, c3=0.00837,
    ...     f0=0.0046, m01=0.00058, m02=0.0017, p1=1.01, p2=1.0086, p3=0.3595,
    ... )
    >>> response = vv.MultipleScales(body).response("p1", [1.01])
    >>> lines = [response.beating(i).lines("z")[:3] for i in response.beating_points]
    """

    value: float
    n_beats: int
    frequencies: FloatArray
    harmonics: ComplexArray
    errors: FloatArray
    growth: float
    growth_error: float
    loads: dict[str, float]
    dof_names: tuple[str, ...]

    kind = "beating_motion"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if lines were found."""
        return self.frequencies.size > 0

    @property
    def stable(self) -> bool | None:
        """True if perturbations decay; None if ``growth_error`` exceeds the growth."""
        return None if abs(self.growth) <= self.growth_error else self.growth < 0

    def _headline(self) -> str:
        beats = things(self.n_beats, "beat frequency", "beat frequencies")
        return f"{things(self.frequencies.size, 'line')}, {beats}"

    def _scope(self) -> list[str]:
        verdict = {True: "stable", False: "unstable", None: "of unknown stability"}[self.stable]
        return [f"{', '.join(self.dof_names)}; {verdict}, growth {self.growth:.4g}"]

    @cached_property
    def orders(self) -> FloatArray:
        """Multiples n of the loads' frequencies in each line, shape (n_lines, n_loads).

        They are integers or half integers, the smallest that fit; NaN if none within reach fits.
        """
        p = np.array(list(self.loads.values()))
        top = _HIGHEST[min(p.size, 6)]
        n = np.array(list(product(range(-top, top + 1), repeat=p.size)), dtype=float)
        n = n[np.argsort(np.abs(n).sum(axis=1), kind="stable")]
        half = n[(np.abs(n) <= top // 2).all(axis=1) & (n % 2 != 0).any(axis=1)] / 2
        n = np.concatenate([n, half])
        sums = n @ p
        found = np.full((self.frequencies.size, p.size), np.nan)
        for k, f in enumerate(self.frequencies):
            at = np.flatnonzero(np.abs(sums - f) <= _SAME * p.max())
            if at.size:
                found[k] = n[at[0]]
        return found

    @property
    def mean(self) -> FloatArray:
        """Mean of each coordinate, shape (n_dof,)."""
        return np.ascontiguousarray(self.harmonics[0].real)

    @property
    def rms(self) -> FloatArray:
        """Root mean square of each coordinate about its mean, shape (n_dof,)."""
        return np.asarray(np.sqrt((np.abs(self.harmonics[1:]) ** 2).sum(axis=0) / 2))

    @cached_property
    def largest(self) -> FloatArray:
        """Smallest upper bound of the absolute value of each coordinate, shape (n_dof,).

        The bound is over all phases of the loads. For incommensurate frequencies the motion comes
        arbitrarily close to it. For commensurate frequencies it may not be reached.
        """
        known = np.isfinite(self.orders).all(axis=1)
        angles = np.random.default_rng(0).uniform(0, 4 * np.pi, (_STARTS, self.orders.shape[1]))
        found = np.abs(self.harmonics[~known]).sum(axis=0)
        for d in range(len(self.dof_names)):
            size = np.abs(self.harmonics[:, d])
            use = known & (size > 1e-16 * size.max())
            n, x = self.orders[use], self.harmonics[use, d]
            found[d] += max(_highest(n, x, angles), _highest(n, -x, angles))
        return np.asarray(found)

    def lines(self, dof: str) -> list[tuple[float, float, tuple[float, ...]]]:
        """Return (frequency, amplitude, multiples) of a coordinate, the largest amplitude first."""
        d = self.dof_names.index(_native.choice("dof", dof, self.dof_names))
        sizes = np.abs(self.harmonics[:, d])
        order = np.argsort(-sizes, kind="stable")
        return [
            (float(self.frequencies[k]), float(sizes[k]), tuple(self.orders[k].tolist()))
            for k in order
            if sizes[k] > 0
        ]

    def to_dataset(self) -> Dataset:
        """Return the lines and the derived values as an xarray Dataset."""
        return as_dataset(
            {
                "frequency": ("line", self.frequencies, {"units": "rad/s"}),
                "multiple": (("line", "load"), self.orders),
                "harmonic": (("line", "dof"), self.harmonics),
                "error": ("dof", self.errors),
                "mean": ("dof", self.mean),
                "rms": ("dof", self.rms),
                "largest": ("dof", self.largest),
            },
            coords={"dof": list(self.dof_names), "load": list(self.loads)},
            attrs={
                "n_beats": self.n_beats,
                "value": self.value,
                "growth": self.growth,
                "growth_error": self.growth_error,
            },
        )

    def at(self, t: npt.ArrayLike) -> FloatArray:
        """Return the coordinates at times t, all loads being cosines, shape (n, n_dof)."""
        times = _native.real_array("t", t, ndim=1)
        with np.errstate(over="ignore"):
            phases = np.outer(times, self.frequencies)
        _native.check_range("t", times, phases, "the phase of a load")
        waves = np.exp(1j * phases)
        return np.ascontiguousarray((waves @ self.harmonics).real)


def _highest(n: FloatArray, x: ComplexArray, angles: FloatArray) -> float:
    """Largest value of Re sum_k x_k exp(i n_k . c) over the angles c, by Newton's method."""
    values = (np.exp(1j * angles @ n.T) @ x).real
    best = float(values.max())
    for c in angles[np.argsort(-values)[:_TRIES]]:
        for _ in range(_ROUNDS):
            waves = x * np.exp(1j * n @ c)
            slope = -waves.imag @ n
            bend = -(n.T * waves.real) @ n
            # Ascend for any sign of the curvature.
            values_of, vectors = np.linalg.eigh(bend)
            steep = np.maximum(np.abs(values_of), 1e-9 * np.abs(waves).sum())
            step = vectors @ ((vectors.T @ slope) / steep)
            c = c + step / max(1.0, float(np.abs(step).max()))
            if np.abs(step).max() < 1e-9:
                break
        best = max(best, float((x * np.exp(1j * n @ c)).real.sum()))
    return best
