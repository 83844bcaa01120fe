"""Lines above tables, about plans and columns: the only definition.

The build reads this file alone and makes constants of the core of it (`fortran/fill_notes.py`), so
it does not import the package.
"""

_ERROR = "error: by the last correction and rounding"
_TRUNCATION = f"truncation: estimated relative error by neglected harmonics; {_ERROR}"
_NU = "nu: circular frequency of the load (rad/s)"
_MOTION = "u = Im sum_k X_k exp(i k nu t)"

#: Lines, and parts of lines, by name.
NOTES = {
    "response": f"{_NU}; rate: ratio of the last corrections; highest: highest harmonic; "
    f"{_TRUNCATION}; {_MOTION},",
    "unsolved": "nan where no solution was found",
    "branch": f"{_NU}; {_MOTION}",
    "branch_errors": f"; highest: highest harmonic; {_TRUNCATION}; ",
    "backbone": "nu: circular frequency",
    "backbone_errors": f"; {_TRUNCATION}; u = sum_k a_k cos(k nu t); ",
    "driven": "q = Im sum_k X_k exp(i k.omega t) of z, phi (rad), psi (rad)",
    "driven_error": f"; {_ERROR}",
    "stability": "; stable: 1, not: 0, unknown: -1; growing: multipliers outside the unit circle, "
    "unknown: -1; multiplier: size of the largest, nan: unknown or too large for a number",
    "scales": "steady motions by multiple scales to third order",
    "scales_columns": "first harmonic of u = Re X exp(i p t) under the load f cos(p t); amplitudes "
    "of the modes; largest growth and its estimated error; sizes of the three orders; estimated "
    "error of X, of the coordinate where it is largest",
    "step_given": "skips: estimate of the error (the step is given)",
    "step_halved": "computes: the step, halved until the last states change by at most ",
    "sampling": "sampling: estimated relative error by the samples of forces",
    "dissipation": "dissipation: energy loss per period (J)",
}
