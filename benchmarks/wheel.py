"""Native build and wheel compared: `./run bench --wheel [WHEEL]`.

Both run alternately in separate processes, so that the load of the machine affects both. The table
contains medians of the alternate runs and the ratio of native to wheel (1: equal). The line above
it contains the times of importing the installed wheel and of importing NumPy.
"""

import argparse
import csv
import resource
import statistics
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CASES = ROOT / "benchmarks" / "wheel_cases.py"


#: Imports that are timed in new interpreters with the installed wheel.
IMPORTS = {
    "nothing": "",
    "numpy": "import numpy",
    "viscovib": "import viscovib",
    "a first response": "import viscovib as vv\nmount = vv.Mount(mass=1, inertia=1, offset=0.1,"
    " stiffness_x=1, stiffness_phi=1)\nvv.forced_response(mount, [0.5, 0.9], load=0.01)",
    "every public name": "import viscovib\nfor name in viscovib.__all__: getattr(viscovib, name)",
}


def import_times(python: Path, turns: int) -> dict[str, float]:
    """Return the least processor time (s) of a new interpreter by import, measured in turn."""
    taken: dict[str, list[float]] = {name: [] for name in IMPORTS}
    for _ in range(turns):
        for name, code in IMPORTS.items():
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([str(python), "-c", code], check=True, cwd=tempfile.gettempdir())
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent = after.ru_utime + after.ru_stime
            taken[name].append(spent - before.ru_utime - before.ru_stime)
    return {name: min(times) for name, times in taken.items()}


class Worker:
    """A process that times cases."""

    def __init__(self, python: Path) -> None:
        # Not in the source folder, which contains another viscovib.
        self.process = subprocess.Popen(
            [str(python), str(CASES)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=tempfile.gettempdir(),
        )
        self.cases = self.process.stdout.readline().strip().split(",")

    def time(self, case: str) -> float:
        """Return the time of a case in seconds."""
        self.process.stdin.write(case + "\n")
        self.process.stdin.flush()
        return float(self.process.stdout.readline())

    def end(self) -> None:
        """End the process."""
        self.process.stdin.close()
        self.process.wait()


def installed(wheel: Path) -> Path:
    """Install a wheel without access to compiler and sources; return the interpreter."""
    folder = ROOT / "build" / "wheel-environment"
    python = folder / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    pip = [str(python), "-m", "pip", "install", "-q", "--only-binary", ":all:"]
    subprocess.run([*pip, str(wheel)], check=True)
    subprocess.run([*pip, "--force-reinstall", "--no-deps", str(wheel)], check=True)
    return python


def newest() -> Path:
    """Return the newest wheel in dist for this Python."""
    version = sysconfig.get_config_var("py_version_nodot")
    found = sorted(
        ROOT.glob(f"dist/viscovib-*-cp{version}-*.whl"), key=lambda path: path.stat().st_mtime
    )
    if not found:
        sys.exit(f"bench: no wheel for cp{version} in dist: ./run wheel makes one")
    return found[-1]


def main() -> None:
    """Print the table and write it."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], prog="./run bench --wheel"
    )
    parser.add_argument("wheel", nargs="?", type=Path, help="default: the newest in dist")
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench")
    options = parser.parse_args()
    wheel = options.wheel or newest()
    python = installed(wheel)
    imports = import_times(python, options.turns)
    print(f"{'fresh interpreter':24}{'seconds':>12}{'of numpy':>12}")
    for name, spent in imports.items():
        print(f"{name:24}{spent:12.3f}{spent / imports['numpy']:12.2f}", flush=True)
    workers = {"native": Worker(Path(sys.executable)), "wheel": Worker(python)}
    rows = []
    print(f"\nwheel: {wheel.name}; medians of {options.turns} alternate runs")
    print(f"{'case':24}{'native ms':>12}{'wheel ms':>12}{'speed':>8}")
    for case in workers["native"].cases:
        taken: dict[str, list[float]] = {name: [] for name in workers}
        for turn in range(options.turns):
            for name in sorted(workers, reverse=turn % 2 == 1):
                taken[name].append(workers[name].time(case))
        native, other = (1e3 * statistics.median(taken[name]) for name in ("native", "wheel"))
        ratio = statistics.median(
            a / b for a, b in zip(taken["native"], taken["wheel"], strict=True)
        )
        rows.append([case, f"{native:.4g}", f"{other:.4g}", f"{ratio:.3f}"])
        print(f"{case:24}{native:12.4g}{other:12.4g}{ratio:8.2f}", flush=True)
    for worker in workers.values():
        worker.end()
    options.out.mkdir(parents=True, exist_ok=True)
    with open(options.out / "wheel.csv", "w", newline="") as file:
        csv.writer(file).writerows([["case", "native_ms", "wheel_ms", "speed"], *rows])
    with open(options.out / "imports.csv", "w", newline="") as file:
        csv.writer(file).writerows([["imported", "processor_s"], *imports.items()])


if __name__ == "__main__":
    main()
