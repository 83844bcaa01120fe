"""
Backbone curve over the response
================================

The backbone curve of free motions passes through the peaks of the weakly damped response.
"""

import viscovib as vv

duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*x^3")
ax = vv.plot_branch(vv.trace_response(duffing, (0.3, 2.5), load=0.15))
vv.plot_backbone(vv.backbone(duffing, 0, (0.01, 2)), ax=ax)
