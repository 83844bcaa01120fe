"""
A map over damping and load
===========================

The peak of a nonlinear response over two parameters, computed by a sweep.
"""

import numpy as np
import viscovib as vv


def peak(damping, load):
    """The largest amplitude of x."""
    body = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, forces="x^3")
    nu = np.linspace(0.5, 3, 60)
    response = vv.forced_response(body, nu, load=load, method="newton")
    return {"amplitude (m)": response.peak("x").amplitude}


grid = {"damping": np.linspace(0.1, 0.5, 16), "load": np.linspace(0.02, 0.3, 15)}
vv.plot_map(vv.sweep(peak, grid, progress=False), "amplitude (m)")
