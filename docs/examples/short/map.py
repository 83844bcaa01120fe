"""
A map over stiffness and load
=============================

The peak of a nonlinear response over two parameters, by a sweep.
"""

import numpy as np
import viscovib as vv


def peak(stiffness, load):
    """The largest amplitude of x."""
    body = vv.PolynomialSystem(mass=1, stiffness=stiffness, damping=0.1, forces="x^3")
    nu = np.linspace(0.5, 3, 60)
    response = vv.forced_response(body, nu, load=load, method="newton")
    return {"amplitude (m)": response.peak("x").amplitude}


grid = {"stiffness": np.linspace(0.5, 2, 16), "load": np.linspace(0.02, 0.3, 15)}
vv.plot_map(vv.sweep(peak, grid, progress=False), "amplitude (m)")
