"""The process of a family under supervision: a crash or a hang is a failure of the current case."""

import json
import math
import os
import queue
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

#: Limits of one case: processor time, and wall time, so that a slow case on a busy machine does
#: not count as a hang.
PATIENCE = 120.0
LONGEST = 10 * PATIENCE
#: Seconds between two checks of a process without output.
LOOK = 1.0
#: A family with more crashes is given up.
MOST_CRASHES = 20
#: Fraction of the claims of a name in which an injected error must be found.
FOUND = 0.5


@dataclass(frozen=True)
class Failure:
    """A wrong result and the call that produces it."""

    family: str
    index: int
    text: str
    call: str

    def script(self) -> str:
        """Return Python code that reproduces it."""
        comment = "\n".join(f"# {row}" for row in self.text.strip().splitlines())
        return (
            f"# {self.family}, case {self.index}\n{comment}\n"
            f"import numpy as np\nimport viscovib as vv\n\n{self.call.strip()}\n"
        )


@dataclass
class Verdict:
    """The result of a family."""

    family: str
    systems: int = 0
    claims: int = 0
    refused: int = 0
    seconds: float = 0.0
    #: The ratio of true to stated error that is closest to its limit, and this limit.
    worst: float = 0.0
    worst_limit: float = 1.0
    worst_claim: str = ""
    failures: list[Failure] = field(default_factory=list)
    #: For each correct claim: the count, and the count of injected errors that were found.
    injected: dict[str, list[int]] = field(default_factory=dict)

    def unseen(self) -> list[str]:
        """Claims in which an injected error is usually not found."""
        return [
            f"{what} ({found} of {n})"
            for what, (n, found) in self.injected.items()
            if found < FOUND * n
        ]

    def take(self, record: dict, call: str) -> None:
        """Add one case."""
        self.systems += record["systems"]
        self.refused += record["ended"] == "refused"
        if record["ended"] == "raised":
            self.failures.append(Failure(self.family, record["index"], record["message"], call))
        texts = []
        for what, ratio, limit, wrong, found, text in record["claims"]:
            self.claims += 1
            if wrong:
                texts.append(text)
            else:
                seen = self.injected.setdefault(what, [0, 0])
                seen[0] += 1
                seen[1] += found
            if ratio / limit > self.worst / self.worst_limit or math.isnan(ratio):
                self.worst, self.worst_limit, self.worst_claim = ratio, limit, what
        if texts:
            self.failures.append(Failure(self.family, record["index"], "\n".join(texts), call))


def run_family(family: str, seed: int, seconds: float, least: int, most: int = 10**9) -> Verdict:
    """Run a family for a time. After a crash or a hang the next case continues in a new process."""
    verdict = Verdict(family)
    begun, first, crashes = time.monotonic(), 0, 0
    while crashes <= MOST_CRASHES:
        left = seconds - (time.monotonic() - begun)
        lacking = max(least - verdict.systems, 0)
        if (left <= 0 and not lacking and first) or verdict.systems >= most:
            break
        index, call, reason = _watch(
            verdict, family, seed, first, max(left, 0.0), lacking, most - verdict.systems
        )
        if not reason:
            break
        verdict.failures.append(Failure(family, index, reason, call))
        crashes += 1
        first = index + 1
    verdict.seconds = time.monotonic() - begun
    return verdict


def _watch(
    verdict: Verdict, family: str, seed: int, first: int, seconds: float, least: int, most: int
) -> tuple[int, str, str]:
    """Follow one process to its end; return the current case and the cause of the end."""
    options = {"--seed": seed, "--first": first, "--seconds": seconds, "--least": least}
    arguments = [str(part) for pair in options.items() for part in pair]
    process = subprocess.Popen(
        [sys.executable, "-m", "referee.worker", family, *arguments, "--most", str(most)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    lines: queue.Queue[str | None] = queue.Queue()
    heard: list[str] = []
    stdout, stderr = process.stdout, process.stderr
    listeners = [
        threading.Thread(target=_listen, args=(stdout, lines)),
        threading.Thread(target=lambda: heard.extend(stderr)),
    ]
    for thread in listeners:
        thread.daemon = True
        thread.start()
    index, call, hung = first, "", False
    try:
        while True:
            try:
                text = _awaited(lines, process.pid)
            except queue.Empty:
                hung = True
                break
            if text is None:
                break
            record = json.loads(text)
            index = record["index"]
            if "begin" in record:
                call = record["begin"]
            else:
                verdict.take(record, call)
    finally:
        if hung or (process.poll() is None and sys.exc_info()[0] is not None):
            process.kill()
        status = process.wait()
        for thread in listeners:
            thread.join()
        stdout.close()
        stderr.close()
    if hung:
        return index, call, f"no answer within {PATIENCE:g} s of its processor"
    if status == 0:
        return index, "", ""
    if status > 0:
        raise RuntimeError(f"{family}: the referee itself failed\n{''.join(heard)}")
    return index, call, f"the process ended by signal {-status}"


def _awaited(lines: "queue.Queue[str | None]", pid: int) -> str | None:
    """Return the next line of a process; queue.Empty on timeout."""
    begun, used = time.monotonic(), _used(pid)
    while True:
        try:
            return lines.get(timeout=LOOK)
        except queue.Empty:
            late = time.monotonic() - begun > LONGEST
            if late or _used(pid) - used > PATIENCE:
                raise


def _used(pid: int) -> float:
    """Processor time of a process and its finished children."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _listen(stream, lines: "queue.Queue[str | None]") -> None:
    for text in stream:
        if text.startswith("{"):
            lines.put(text)
    lines.put(None)
