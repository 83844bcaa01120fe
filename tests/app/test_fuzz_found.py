"""Findings of the fuzzer: each scene is run or refused with a line, in every build."""

import os
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[1] / "fuzz"
sys.path.insert(0, str(FUZZ))

from scenes import drive  # noqa: E402


@pytest.mark.parametrize("scene", sorted((FUZZ / "found").glob("*.nml")), ids=lambda p: p.stem)
def test_a_finding_stays_mended(solve, tmp_path, scene):
    driver = Path(solve("--version").args[0])
    bounded = "sanitize" not in os.environ.get("VISCOVIB_SOLVE", "")
    case = drive(scene.read_bytes(), driver, tmp_path / "work", "found", bounded=bounded, seconds=1)
    assert case.ending.good, case.ending


def test_the_fuzzer_sees_what_is_wrong(tmp_path):
    """The fuzzer detects each kind of fault of a driver."""
    ways = {
        "signal": "kill -SEGV $$",
        "exit status": "exit 4",
        "message": "echo one >&2; echo two >&2; exit 2",
        "part left": "mkdir out; touch out/a.csv.part",
        "not finite": "mkdir out; printf 'nu,outcome,x\\n1,converged,nan\\n' >out/a.csv",
        "done": "mkdir out; printf 'nu,outcome,x\\n1,stalled,nan\\n' >out/a.csv",
        "done with warnings": "echo 'warning: odd' >&2",
        "refused with a line": "echo no >&2; exit 2",
        "stopped at a given limit": "echo 'a: stopped: the time limit is reached'; exit 1",
    }
    for verdict, script in ways.items():
        driver = tmp_path / "driver"
        driver.write_text(f"#!/bin/sh\n{script}\n")
        driver.chmod(0o755)
        case = drive(b"", driver, tmp_path / "work", "way")
        assert case.ending.verdict == verdict, case
