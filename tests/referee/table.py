"""The referee's tables."""

import csv
import platform
import time
from pathlib import Path

from referee.coverage import description
from referee.session import Verdict

#: Where every failing call is written, whatever place the table has.
FAILURES = Path("out/referee/failures.py")
_HEAD = ("family", "systems", "claims", "refused", "failures", "worst ratio", "of what")
_ABOUT = """# The referee's table
`./run referee --minutes N` draws random systems, loads and settings for every public method and judges each answer by
something that shares no code with it: SciPy's integrators at 1e-12, mpmath, solutions in closed form, a harmonic balance and
Floquet multipliers of its own in NumPy, an identity. A claim is a number with the error that the answer admits, or a verdict.
The ratio is the true error over the admitted one, inf where a verdict, a count or an outcome is wrong; 1 is allowed for
numbers, more for estimates, as their claims say. Refused: an error that names its argument instead of an answer.
"""


def line(verdict: Verdict) -> str:
    """One family on the terminal."""
    return (
        f"{verdict.family:14s} {verdict.systems:6d} systems {verdict.claims:6d} claims "
        f"{verdict.refused:4d} refused {len(verdict.failures):4d} failures, worst "
        f"{verdict.worst:.2g} ({verdict.worst_claim}), {verdict.seconds:.0f} s"
    )


def write(out: Path, verdicts: list[Verdict], seed: int, spent: float) -> None:
    """Write referee.csv and referee.md."""
    out.mkdir(parents=True, exist_ok=True)
    head = (
        f"{platform.machine()}; {time.strftime('%Y-%m-%d', time.gmtime())}; seed {seed}, "
        f"{spent / 60:.0f} minutes"
    )
    rows = [
        (
            v.family, v.systems, v.claims, v.refused, len(v.failures), f"{v.worst:.2g}",
            v.worst_claim,
        )
        for v in verdicts
    ]  # fmt: skip
    with open(out / "referee.csv", "w", newline="", encoding="utf-8") as file:
        file.write(f"# {head}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_HEAD)
        writer.writerows(rows)
    total = f"{sum(v.systems for v in verdicts)} systems, {sum(v.claims for v in verdicts)} claims"
    lines = [_ABOUT, f"{head}. {total}, {sum(len(v.failures) for v in verdicts)} failures.", ""]
    lines += [
        f"| {' | '.join(_HEAD)} | judged by |",
        f"| {' | '.join('---' for _ in _HEAD)} | --- |",
    ]
    lines += [f"| {' | '.join(map(str, row))} | {description(row[0])} |" for row in rows]
    (out / "referee.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
