"""
A bifurcation diagram
=====================

One section point per period of the load, over the amplitude of the load: 400 motions at once.
"""

import numpy as np
import viscovib as vv

pend = vv.Pendulum(
    e=0.1,
    w2=0.4,
    w3=0.8,
    alpha=0.5,
    c1=0.01,
    c2=0.01,
    c3=0.01,
    f0=0.005,
    m01=0.0025,
    m02=0.005,
    p1=0.93,
    p2=0.37,
    p3=0.71,
)
diagram = vv.simulate_ensemble(
    pend,
    initial=(0.05, 0, 0.3, 0, -0.2, 0),
    dt=0.3,
    n_periods=150,
    discard=110,
    sections=1,
    parameters={"f0": np.linspace(0, 0.03, 400)},
)
vv.plot_sections(diagram, parameter="f0", quantity="phi")
