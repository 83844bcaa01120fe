"""Run every method at its limits and write a table of the results.

Writes stress.csv and stress.md. Every row states what was varied, how it ended (ok, warning, clear
error: vv.InputError naming the argument; WRONG: a number beyond its limit, NaN, any other
exception), the worst number and its limit.
"""

import argparse
import csv
import importlib
import sys
import time
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]

from tally import WRONG, Row  # noqa: E402
from timing import machine  # noqa: E402

TOPICS = ("steps", "memory_edges", "rounding", "order", "scene_ulps", "edges", "fading", "flags")


def write(out: Path, rows: list[Row], spent: float, form: str) -> None:
    """Write the table in both formats."""
    out.mkdir(parents=True, exist_ok=True)
    head = f"{machine()}; {time.strftime('%Y-%m-%d', time.gmtime())}; {form}, {spent:.0f} s"
    with open(out / "stress.csv", "w", newline="", encoding="utf-8") as file:
        file.write(f"# {head}\n")
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    about = (Path(__file__).parent / "about.md").read_text(encoding="utf-8")
    lines = [about, f"{head}. {len(rows)} rows, {sum(r.outcome == WRONG for r in rows)} WRONG."]
    for topic in dict.fromkeys(row.topic for row in rows):
        lines += ["", f"## {topic[0].upper() + topic[1:]}"]
        lines += ["| what | range | outcome | worst | limit | of what | remarks |"]
        lines += ["| --- | --- | --- | --- | --- | --- | --- |"]
        lines += [
            "| "
            + " | ".join(
                text.replace("|", "\\|").replace("\n", " ")
                for text in (
                    row.what, row.range, row.outcome, f"{row.worst:.2g}", f"{row.limit:.2g}",
                    row.measure, row.note,
                )
            )
            + " |"
            for row in rows
            if row.topic == topic
        ]  # fmt: skip
    (out / "stress.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> int:
    """Run the selected parts; return 1 if anything is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/stress"))
    parser.add_argument("--quick", action="store_true", help="a minute instead of ten")
    parser.add_argument("--only", nargs="+", choices=TOPICS, default=TOPICS)
    given = parser.parse_args()
    begun = time.perf_counter()
    jobs = [job for name in given.only for job in importlib.import_module(name).jobs(given.quick)]
    rows: list[Row] = []
    with tqdm(jobs, unit=" rows", disable=None) as bar:
        for name, job in bar:
            bar.set_postfix_str(name)
            rows.append(job())
    form = "quick form" if given.quick else "full form"
    write(given.out, rows, time.perf_counter() - begun, form)
    wrong = [row for row in rows if row.outcome == WRONG]
    for row in wrong:
        print(f"WRONG: {row.topic}, {row.what}, {row.range}: {row.note}")
    print(f"{len(rows)} rows, {len(wrong)} wrong: {given.out / 'stress.md'}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
