"""
Branch of a pendulum
====================

The pendulum's swing over the frequency of a moment, through its folds.
"""

import viscovib as vv

pend = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.02, c2=0.02, c3=0.02, m01=0.005, p2=0.37)
vv.plot_branch(vv.trace_response(pend, p2=(0.25, 0.6), harmonics=15))
