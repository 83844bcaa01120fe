"""
Spectrum of a pendulum
======================

Labels are the combination frequencies of the lines.
"""

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
motion = vv.simulate(pend, 2000, dt=0.5, initial=(0.05, 0, 0.3, 0, -0.2, 0))
spectrum = vv.spectrum(motion, window="blackman_harris")
vv.plot_spectrum(spectrum, bases={"p1": 0.93, "p2": 0.37, "p3": 0.71})
