"""Check random systems, loads and settings over every public method.

    python -m referee [--minutes N] [--systems N] [--seed S] [--only FAMILY ...]
                      [--self-test] [--out DIR]

One line per family: systems, claims, refusals, failures, the largest ratio of the true error to the
stated error, and the limit of this ratio. Each failure is printed as a Python call that reproduces
it, and written to out/referee/failures.py when its family ends. --systems limits the systems per
family, so that the same systems are checked at any speed of the machine if --minutes suffices.
--self-test injects an error into every claim and requires that it is found.
"""

import argparse
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from referee.coverage import FAMILIES
from referee.session import Verdict, run_family
from referee.table import FAILURES, line, write

#: Minimum number of systems per family, unless the time is short.
LEAST = 200


def main() -> int:
    """Run the selected families; return 1 if there is a failure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--systems", type=int, default=10**9, help="of a family at most")
    parser.add_argument("--seed", type=int, default=None, help="default: the time of day")
    parser.add_argument("--only", nargs="+", choices=FAMILIES, default=FAMILIES, metavar="FAMILY")
    parser.add_argument("--self-test", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("out/referee"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    seed = int(time.time()) % 10**6 if given.seed is None else given.seed
    share = 60 * given.minutes * given.jobs / len(given.only)
    least = LEAST if given.minutes >= 10 else 0
    begun = time.monotonic()
    print(f"seed {seed}, {share:.0f} s a family", flush=True)

    FAILURES.parent.mkdir(parents=True, exist_ok=True)
    FAILURES.write_text("", encoding="utf-8")

    def one(family: str) -> Verdict:
        verdict = run_family(family, seed, share, least, given.systems)
        print(line(verdict), flush=True)
        # Written immediately, so that a killed run loses no failure.
        with FAILURES.open("a", encoding="utf-8") as file:
            for failure in verdict.failures:
                file.write(f"{failure.script()}\n")
        for failure in verdict.failures[:40]:
            print(f"\n{failure.script()}", flush=True)
        if len(verdict.failures) > 40:
            print(f"\n{len(verdict.failures) - 40} more in {FAILURES}", flush=True)
        return verdict

    with ThreadPoolExecutor(given.jobs) as pool:
        verdicts = list(pool.map(one, given.only))
    spent = time.monotonic() - begun
    write(given.out, verdicts, seed, spent)
    failures = [failure for verdict in verdicts for failure in verdict.failures]
    print(
        f"{sum(v.systems for v in verdicts)} systems, {len(failures)} failures, {spent:.0f} s: "
        f"{given.out / 'referee.md'}"
    )
    if given.self_test:
        unseen = [f"{v.family}: {what}" for v in verdicts for what in v.unseen()]
        for text in unseen:
            print(f"an injected error is not found: {text}")
        empty = [v.family for v in verdicts if not v.claims]
        for name in empty:
            print(f"{name}: no claim was judged")
        print(f"self-test: {len(unseen)} claims in which an injected error is not found")
        return 1 if unseen or empty or failures else 0
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
