"""Amplitudes of loads as formulas in the frequency, with the same as Python functions."""

from collections.abc import Callable

import numpy as np

from referee.case import even


def formula(
    rng: np.random.Generator, size: float, w: float
) -> tuple[str, Callable[[float], complex]]:
    """Draw a formula whose value is about ``size`` near the frequency w, and its function."""
    c = float(f"{size / w**2:.3g}")
    b = even(rng, 0.1, 0.9, 2)
    forms: list[tuple[str, Callable[[float], complex]]] = [
        (f"{c}*nu^2", lambda nu: c * nu**2),
        (f"{c}*nu^2 - {b * size:.3g}", lambda nu: c * nu**2 - float(f"{b * size:.3g}")),
        (f"{c}*nu^2*exp({b}j*nu)", lambda nu: c * nu**2 * np.exp(1j * b * nu)),
        (f"{c}*nu^2/(1 + {b}j*nu)", lambda nu: c * nu**2 / (1 + 1j * b * nu)),
        (f"{size}*sqrt({b} + nu)", lambda nu: size * np.sqrt(b + nu)),
        (f"{size}*tanh({b}*nu) + {c}*nu^2", lambda nu: size * np.tanh(b * nu) + c * nu**2),
        (f"({c} + {c}j)*abs(nu)^{1 + b}", lambda nu: (c + 1j * c) * nu ** (1 + b)),
    ]
    return forms[int(rng.integers(len(forms)))]
