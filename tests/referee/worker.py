"""One family in a separate process: one JSON line per case, so that a crash affects one case only."""

import argparse
import importlib
import json
import sys
import time
import traceback
import warnings
from typing import Any

import numpy as np
import viscovib as vv

from referee.case import Case, Claim

#: A fault in the reference itself.
BROKEN = "the referee itself failed"


def generator(seed: int, family: str, index: int) -> np.random.Generator:
    """Random numbers of a case, independent of the cases before it."""
    return np.random.default_rng([seed, index, *family.encode()])


def answer(case: Case) -> tuple[list[Claim], str, str]:
    """Run a case: its claims, how it ended ("answered", "refused", "raised") and the message."""
    names: dict[str, Any] = {"np": np, "vv": vv}
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            exec(compile(case.call, "<call>", "exec"), names)
        except vv.InputError as error:
            return [], "refused" if case.may_refuse else "raised", f"InputError: {error}"
        except Exception as error:
            reported = "\n".join(str(error).splitlines()[:3])
            return [], "raised", f"{type(error).__name__}: {reported}"
    reported = [f"{w.category.__name__}: {w.message}" for w in heard]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return list(case.judge(names, reported)), "answered", ""


def main() -> int:
    """Run cases until the time is over and enough systems were checked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("family")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--least", type=int, default=0, help="systems at least")
    parser.add_argument("--most", type=int, default=10**9, help="systems at most")
    given = parser.parse_args()
    family = importlib.import_module(f"referee.{given.family}")
    begun, index, systems = time.monotonic(), given.first, 0
    while systems < given.most and (
        time.monotonic() - begun < given.seconds or systems < given.least
    ):
        record: dict[str, Any] = {"index": index}
        case = family.case(generator(given.seed, given.family, index), index)
        print(json.dumps({"index": index, "begin": case.call}), flush=True)
        start = time.monotonic()
        try:
            claims, ended, message = answer(case)
        except Exception:
            claims, ended, message = [], "raised", f"{BROKEN}: {traceback.format_exc()}"
        record |= {"ended": ended, "message": message, "systems": case.systems, "claims": []}
        record["seconds"] = time.monotonic() - start
        for claim in claims:
            ratio = claim.ratio()
            # NaN is no ratio: a non-finite result is wrong.
            wrong = not ratio <= claim.limit
            found = not claim.damaged().ratio() <= claim.limit
            record["claims"].append(
                [
                    claim.what,
                    ratio,
                    claim.limit,
                    bool(wrong),
                    bool(found),
                    str(claim) if wrong else "",
                ]
            )
        print(json.dumps(record), flush=True)
        systems += case.systems
        index += 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
