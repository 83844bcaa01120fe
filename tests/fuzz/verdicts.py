"""A case of the fuzzer, its ending, and programs run within limits."""

import math
import os
import resource
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

#: Allowed endings. "trapped": the debug build stops at an overflow; the same scene is checked in
#: other builds.
GOOD = (
    "done", "done with warnings", "refused with a line", "stopped at a given limit", "trapped",
)  # fmt: skip
#: Endings that are faults.
BAD = (
    "signal", "exit status", "message", "too long", "memory", "part left", "not finite",
    "exception", "not the same", "not kept",
)  # fmt: skip

#: Seconds of processor time; the wall time on a busy machine may be this many times longer.
SECONDS = 20.0
BUSY = 6.0
MEMORY = 2 << 30


@dataclass(frozen=True)
class Ending:
    """Ending of a case: a word of GOOD or BAD, and details."""

    verdict: str
    detail: str = ""

    @property
    def good(self) -> bool:
        return self.verdict in GOOD


@dataclass(frozen=True)
class Case:
    """One case: input and ending.

    ``files`` and ``how`` reproduce it: files to write, and a command or a call that uses them.
    """

    part: str
    seed: str
    ending: Ending
    how: str
    files: Mapping[str, bytes] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Write the files and the command into a new folder."""
        name = f"{self.part}_{self.ending.verdict}_{self.seed}".replace(" ", "_").replace(":", "_")
        place = folder / name
        place.mkdir(parents=True, exist_ok=True)
        for file, content in self.files.items():
            (place / file).write_bytes(content)
        (place / "how.txt").write_text(
            f"{self.how}\nseed {self.seed}\n{self.ending.verdict}: {self.ending.detail}\n"
        )
        return place


@dataclass(frozen=True)
class Run:
    """A program that has ended or was killed."""

    status: int
    out: str
    err: str
    seconds: float
    memory: int
    too_long: bool

    def ending(self) -> Ending | None:
        """Faults that are independent of the program; None if there is none."""
        if self.too_long:
            return Ending("too long", f"{self.seconds:.0f} s")
        if self.memory > MEMORY or "Error allocating" in self.err or "out-of-memory" in self.err:
            return Ending("memory", f"{self.memory >> 20} MB {self.err[:300]}")
        if self.status < 0:
            name = signal.Signals(-self.status).name
            return Ending("signal", f"{name} {self.err[:2000]}")
        return None


def run(
    command: Sequence[str],
    folder: Path,
    *,
    address_space: bool = True,
    seconds: float = SECONDS,
    environment: Mapping[str, str] | None = None,
) -> Run:
    """Run a program in a folder, in a new session, with limits of time and memory."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
        most = math.ceil(seconds)
        resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
        if address_space:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))

    started = time.monotonic()
    with open(folder / "stdout", "w+b") as out, open(folder / "stderr", "w+b") as err:
        child = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err,
            preexec_fn=limit, start_new_session=True, env={**os.environ, **(environment or {})},
        )  # fmt: skip
        usage, status, late = _wait(child, started + BUSY * seconds)
        out.seek(0)
        err.seek(0)
        texts = [text.read(1 << 16).decode(errors="replace") for text in (out, err)]
    return Run(
        status=os.waitstatus_to_exitcode(status),
        out=texts[0],
        err=texts[1],
        seconds=time.monotonic() - started,
        memory=usage.ru_maxrss * 1024,
        too_long=late or usage.ru_utime + usage.ru_stime > seconds,
    )


def _wait(
    child: "subprocess.Popen[bytes]", until: float
) -> tuple[resource.struct_rusage, int, bool]:
    late = False
    pause = 0.001
    while True:
        found, status, usage = os.wait4(child.pid, 0 if late else os.WNOHANG)
        if found:
            child.returncode = os.waitstatus_to_exitcode(status)
            return usage, status, late
        if time.monotonic() > until:
            late = True
            os.killpg(child.pid, signal.SIGKILL)
        time.sleep(pause)
        pause = min(1.5 * pause, 0.05)
