"""AUTO-07p on the branch of the reference mount: collocation, folds and Floquet multipliers.

AUTO is the Debian package auto-07p (compiled with -O2). Its user file auto/mount.f90, with exact
derivatives, is compiled here with -O3 -march=native. A time is that of the whole process, with
reading of constants and writing of tables, as in normal use of AUTO.
"""

import glob
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from curve import Branch

HOME = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))
CONSTANTS = """NDIM=6, IPS=2, IRS=0, ILP=1
ICP=[1, 11]
NTST={intervals}, NCOL={degree}, IAD=3, ISP={isp}, ISW=1, IPLT=0, NBC=0, NINT=0
NMX=2000, NPR={every}, MXBF=0, IID=0, ITMX=20, ITNW=7, NWTN=3, JAC=1
EPSL=1e-8, EPSU=1e-8, EPSS=1e-7
DS=0.01, DSMIN=1e-6, DSMAX={step}, IADS=1
THL={{11: 0.0}}
UZSTOP={{1: 10.0}}
"""
FOLD = 5


def missing() -> str:
    """Return what is missing; empty if nothing is missing."""
    if not glob.glob(f"{HOME}/lib/*.o"):
        return "AUTO-07p is not installed (Debian's auto-07p): left out"
    return "" if shutil.which("gfortran") else "gfortran is missing: AUTO-07p left out"


class Auto:
    """The compiled problem in a temporary directory, removed at the end."""

    def __enter__(self) -> "Auto":
        self.place = tempfile.TemporaryDirectory()
        source = Path(__file__).parent / "auto" / "mount.f90"
        command = ["gfortran", "-O3", "-march=native", "-fopenmp", "-w", str(source)]
        command += [*sorted(glob.glob(f"{HOME}/lib/*.o")), "-o", "mount"]
        subprocess.run(command, cwd=self.place.name, check=True)
        return self

    def __exit__(self, *_: object) -> None:
        self.place.cleanup()

    def _run(self, intervals: int, degree: int, step: float, every: int, isp: int) -> None:
        text = CONSTANTS.format(intervals=intervals, degree=degree, step=step, every=every, isp=isp)
        subprocess.run(
            ["./mount"], input=text, cwd=self.place.name, check=True, text=True,
            capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip

    def job(
        self, intervals: int, degree: int, step: float = 0.5, stability: bool = True
    ) -> Callable[[], None]:
        """Return a run that stores folds and ends only; ``stability``: also bifurcations."""
        return lambda: self._run(intervals, degree, step, 2000, 2 if stability else 0)

    def branch(self, intervals: int, degree: int, step: float = 0.5) -> Branch:
        """Points, first harmonics and folds of a run that stores every point."""
        self._run(intervals, degree, step, 1, 2)
        rows = [
            (int(part[2]), float(part[4]))
            for line in (Path(self.place.name) / "fort.7").read_text().splitlines()
            if (part := line.split())[0] != "0"
        ]
        # The first point is the uncorrected start.
        solutions = read_solutions(Path(self.place.name) / "fort.8")[1:]
        return Branch(
            nu=np.array([nu for nu, _ in solutions]),
            first=np.array([first for _, first in solutions]),
            folds=np.array([nu for kind, nu in rows if kind % 10 == FOLD]),
        )


def read_solutions(path: Path) -> list[tuple[float, np.ndarray]]:
    """Frequency and first harmonics of x and phi, at zero phase of the load, of each solution."""
    lines, found, i = path.read_text().splitlines(), [], 0
    while i < len(lines):
        head = [int(word) for word in lines[i].split()]
        n_points, length, intervals, degree = head[6], head[8], head[9], head[10]
        values = np.array([line.split() for line in lines[i + 1 : i + 1 + n_points]], float)
        tail = lines[i + 1 + n_points : i + 1 + length]
        # The last lines are the parameters, seven per line; nu is the first.
        parameters = tail[len(tail) - (head[11] + 6) // 7 :]
        harmonics = first_harmonic(values[:, 0], values[:, [1, 3, 5]], intervals, degree)
        found.append((float(parameters[0].split()[0]), harmonics[:2] * np.abs(harmonics[2])
                      / harmonics[2]))  # fmt: skip
        i += 1 + length
    return found


def first_harmonic(t: np.ndarray, u: np.ndarray, intervals: int, degree: int) -> np.ndarray:
    """X of u = Im X exp(2 pi i t) from piecewise polynomials through equidistant points."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    places = np.linspace(-1, 1, degree + 1)
    # Lagrange polynomials through the points, at the nodes.
    basis = np.linalg.solve(np.vander(places).T, np.vander(nodes, degree + 1).T)
    total = np.zeros(u.shape[1], complex)
    for j in range(intervals):
        near = slice(j * degree, (j + 1) * degree + 1)
        half, middle = (t[near][-1] - t[near][0]) / 2, (t[near][-1] + t[near][0]) / 2
        turn = np.exp(-2j * np.pi * (middle + half * nodes))
        total += half * ((weights * turn) @ (basis.T @ u[near]))
    return 2j * total
