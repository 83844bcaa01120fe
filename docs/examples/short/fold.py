"""
A resonance with folds
======================

Stable motions are solid, unstable motions dashed. A slow sweep jumps at the folds.
"""

import viscovib as vv

light = vv.Mount(
    mass=1,
    inertia=0.1,
    offset=0.5,
    stiffness_x=10,
    stiffness_phi=2,
    damping=[[0.2, -0.1], [-0.1, 0.09]],
)
branch = vv.trace_response(light, (0.5, 4), load=0.5)
vv.plot_branch(branch)
