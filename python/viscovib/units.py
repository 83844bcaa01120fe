"""Factors from the units of drawings and test benches to SI: multiply by them.

viscovib uses SI units (m, kg, s, N, rad) and does not convert units. Multiply input in a different
unit by its factor; divide results by it.

Examples
--------
>>> from viscovib import units
>>> stiffness = 350 * units.newton_per_mm
>>> round(stiffness)
350000
>>> round(25 * units.hz / units.rpm)
1500
"""

import math

#: Length (m).
mm = 1e-3
#: Force (N).
kN = 1e3  # noqa: N816 - the unit's own name
#: Stiffness (N/m).
newton_per_mm = 1e3
#: Angle (rad).
degree = math.pi / 180
#: Circular frequency (rad/s) of one oscillation a second.
hz = 2 * math.pi
#: Circular frequency (rad/s) of one revolution a minute.
rpm = 2 * math.pi / 60
#: Standard acceleration of gravity (m/s^2).
g = 9.80665
