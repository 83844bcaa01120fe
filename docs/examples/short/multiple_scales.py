"""
Multiple scales near a resonance
================================

Steady motions by formulas of third order, with their stability.
"""

import numpy as np
import viscovib as vv

pend = vv.Pendulum(
    e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, c3=0.005, f0=0.002, p1=1.02
)
vv.plot_scales_response(vv.MultipleScales(pend).response("p1", np.linspace(1.0, 1.05, 300)))
