"""Natural frequencies and mode shapes (1, a_2j) of undamped mounts, in 60 digits.

Roots of det(K - omega^2 M) = 0 with K = [[c_x, -c_x l], [-c_x l, c_x l^2 + c_phi]],
M = diag(m, I); a_2j = (c_x - m omega_j^2)/(c_x l) (seed paper 001, (2), (5), (6), corrected).
"""

import argparse
from pathlib import Path

import mpmath as mp

mp.mp.dps = 60
MOUNTS = (
    (1.0, 0.1, 0.5, 10.0, 2.0),
    (1.0, 0.1, 0.5, 1e9, 10.0),
    (1.0, 0.1, 0.5, 10.0, 1e9),
    (2.0, 0.3, -0.7, 5.0, 40.0),
    (1.0, 1.0, 1e-7, 4.0, 4.0),
)


def main():
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1])
    out = parser.parse_args().out
    with open(out / "mount_modes.csv", "w", encoding="utf-8") as file:
        file.write("# undamped modes, shapes (1, a_2j); by data/programs/free_vibration.py\n")
        file.write("mass,inertia,offset,stiffness_x,stiffness_phi,omega_1,omega_2,a_21,a_22\n")
        for parameters in MOUNTS:
            m, i, arm, c_x, c_phi = map(mp.mpf, parameters)
            half = (c_x / m + (c_x * arm**2 + c_phi) / i) / 2
            root = mp.sqrt(half**2 - c_x * c_phi / (m * i))
            squares = (half - root, half + root)
            numbers = [mp.sqrt(s) for s in squares] + [(c_x - m * s) / (c_x * arm) for s in squares]
            file.write(
                ",".join([*map(repr, parameters), *(mp.nstr(n, 20) for n in numbers)]) + "\n"
            )


if __name__ == "__main__":
    main()
