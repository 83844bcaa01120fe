"""The result tables of the referee."""

import csv
import platform
import time
from pathlib import Path

from referee.coverage import description
from referee.session import Verdict

#: File with all failing calls, independent of the folder of the table.
FAILURES = Path("out/referee/failures.py")
_HEAD = (
    "family", "systems", "claims", "refused", "failures", "worst ratio", "limit", "of what",
)  # fmt: skip
_ABOUT = """# Random systems against independent references
`./run referee --minutes N` draws random systems, loads and settings for every public method. It checks each result by
a method that shares no code with the library: SciPy's integrators at 1e-12, mpmath, closed-form solutions, a harmonic balance and
Floquet multipliers in NumPy, or an identity. A claim is a number with the error that the result states, or a verdict.
The ratio is the true error divided by the stated error, inf for a wrong verdict, count or outcome. The limit is 1 for
numbers and larger for estimates. The table shows the ratio that comes closest to its limit. Refused: an error message
that names its argument instead of a result.
"""


def line(verdict: Verdict) -> str:
    """Return the line of a family for the terminal."""
    return (
        f"{verdict.family:14s} {verdict.systems:6d} systems {verdict.claims:6d} claims "
        f"{verdict.refused:4d} refused {len(verdict.failures):4d} failures, worst "
        f"{verdict.worst:.2g} of {verdict.worst_limit:g} ({verdict.worst_claim}), "
        f"{verdict.seconds:.0f} s"
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
            f"{v.worst_limit:g}", v.worst_claim,
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
