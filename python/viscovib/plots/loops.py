"""Plot of the loop of an element: its force over its deflection."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.results import Axes
from viscovib.errors import InputError
from viscovib.plots.panels import panel
from viscovib.results.dissipation import _loss_of, _sampled
from viscovib.systems.contacts import Contact
from viscovib.systems.elements import Coupling, element_terms
from viscovib.systems.series_dampers import Maxwell


def plot_loop(element: Any, amplitude: float, *, nu: float, ax: Axes | None = None) -> Axes:
    """Draw the force of an element over a cycle d = X sin(nu t) of its deflection.

    The title states the loss per cycle.

    Parameters
    ----------
    element : object
        An element of a structure with one deflection, with a kernel too: Spring, FluidDamper,
        Maxwell, StribeckFriction, Jenkins, Iwan, BoucWen, Dahl, Gap or Stop.
    amplitude : float
        X, greater than 0 (m).
    nu : float
        Circular frequency, greater than 0 (rad/s).
    ax : Axes, optional
        Axes of the plot; None creates a figure.

    Returns
    -------
    Axes

    Examples
    --------
    >>> import viscovib as vv
    >>> vv.plot_loop(vv.Jenkins(on="x1", stiffness=20, limit=1), 0.3, nu=1.0).get_title()
    'loss per cycle: 1 J'
    """
    for name, value in (("amplitude", amplitude), ("nu", nu)):
        if _native.number(name, value) <= 0:
            raise InputError(f"{name} = {value:g}: must be greater than 0")
    rigid = isinstance(element, Contact) and element.stiffness is None
    if rigid or isinstance(element, Coupling) or not hasattr(element, "on"):
        raise InputError(
            f"element = {_native.shown(element)}: must be an element with one deflection and a "
            "force, such as a FluidDamper"
        )
    if isinstance(element, Maxwell):
        d = amplitude * np.sin(2 * np.pi * np.arange(720) / 720)
        lost = float(element.energy(amplitude, nu=nu))
        return _drawn(d, element.loop(amplitude, nu=nu), lost, ax)
    terms = element_terms([replace(element, on=[1.0])], ("d",), {"d": 0})[0]
    order, size = np.array([1]), np.array([[amplitude + 0j]])
    theta, force, rate = _sampled(terms, float(nu), order, size, False)
    if terms.kernel is not None:
        parts = np.fft.rfft(force)
        orders = np.arange(1, parts.size)
        parts[0] *= 1 - terms.kernel.integral
        parts[1:] *= 1 - terms.kernel.laplace(1j * nu * orders)
        force = np.fft.irfft(parts, theta.size)
    force = force + terms.damping * rate
    return _drawn(
        amplitude * np.sin(theta), force, _loss_of(terms, float(nu), order, size, False), ax
    )


def _drawn(d: FloatArray, force: FloatArray, lost: float, ax: Axes | None) -> Axes:
    ax = panel(ax, (4.2, 3.6))
    ax.plot(np.append(d, d[0]), np.append(force, force[0]))
    ax.set_xlabel("d (m)")
    ax.set_ylabel("force (N)")
    ax.set_title(f"loss per cycle: {lost:.4g} J", fontsize="medium")
    return ax
