"""
A bifurcation diagram
=====================

One section point per period of the load, over the size of the load: 400 motions at once.
"""

import numpy as np
import viscovib as vv

pend = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.06, c2=0.06, c3=0.06, m02=0.1, p3=0.95)
diagram = vv.simulate_ensemble(
    pend,
    initial=(0, 0, 0, 0, 0.1, 0),
    dt=0.3,
    n_periods=150,
    discard=110,
    sections=3,
    parameters={"m02": np.linspace(0.05, 0.4, 400)},
)
vv.plot_sections(diagram, parameter="m02", quantity="psi")
