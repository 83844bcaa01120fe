"""A process that runs calls in sequence, within limits.

It reads a line of JSON, does this job, and writes a line of JSON. A call is run as text. Its
objects ``this`` are cached, because their construction takes most of the time. The controlling
side is `Worker`: it interrupts a slow call as Ctrl-C does, and kills a process that does not react.
"""

import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from verdicts import MEMORY, SECONDS

#: Seconds until a call is interrupted; and seconds until it is killed, if its threads have used
#: `REACTION` meanwhile (on a busy machine a process may wait for a processor).
PATIENCE = 3.0
DEAF = 2.5
#: Processor time of the main thread that a call may use after Ctrl-C, in seconds.
REACTION = 0.5
#: Jobs after which a process is replaced, and its memory limit in bytes.
_JOBS = 2000
_HERE = Path(__file__).parent


class Worker:
    """The controlling side."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._child: subprocess.Popen[bytes] | None = None
        self._done = 0

    def ask(self, patience: float = PATIENCE, **job: Any) -> dict[str, Any]:
        """Run a job and return its answer, or a ``verdict`` on a process without an answer."""
        if self._child is None or self._done >= _JOBS:
            self._start()
        child = self._child
        assert child is not None
        assert child.stdin is not None
        assert child.stdout is not None
        self._done += 1
        started = time.monotonic()
        child.stdin.write(json.dumps(job).encode() + b"\n")
        child.stdin.flush()
        asked = False
        while True:
            taken = time.monotonic() - started
            left = SECONDS - taken if asked else patience - taken
            if select.select([child.stdout], [], [], max(left, 0.0))[0]:
                break
            if asked:
                self.close()
                return {"verdict": "too long", "detail": f"{SECONDS:g} s; deaf to Ctrl-C"}
            asked, since = True, time.monotonic()
            used, used_by_all = _used(child.pid), _used(child.pid, "stat")
            child.send_signal(signal.SIGINT)
        line = child.stdout.readline()
        if not line:
            return self._fallen()
        answer: dict[str, Any] = json.loads(line)
        late = time.monotonic() - since if asked else 0.0
        if late > DEAF and _used(child.pid, "stat") - used_by_all > REACTION:
            answer |= {"verdict": "too long", "detail": f"heard Ctrl-C after {late:.1f} s"}
        if asked:
            # On a busy machine only the processor time of the call itself counts.
            answer["reaction"] = min(_used(child.pid) - used, late)
            if answer["reaction"] > REACTION:
                detail = f"used {answer['reaction']:.1f} s after Ctrl-C"
                answer |= {"verdict": "too long", "detail": detail}
        answer["seconds"] = time.monotonic() - started
        if answer.get("size", 0) > MEMORY // 2:
            self.close()
        return answer

    def _fallen(self) -> dict[str, Any]:
        assert self._child is not None
        self._child.wait()
        status = self._child.returncode
        self.close()
        said = (self.folder / "stderr").read_text(errors="replace")[-1500:]
        if "allocat" in said or status == -signal.SIGKILL:
            return {"verdict": "memory", "detail": f"{status}: {said}"}
        if status < 0:
            return {"verdict": "signal", "detail": f"{signal.Signals(-status).name}: {said}"}
        return {"verdict": "exit status", "detail": f"{status}: {said}"}

    def _start(self) -> None:
        self.close()
        self.folder.mkdir(parents=True, exist_ok=True)
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        more = {"MPLBACKEND": "agg", **threads}
        with (self.folder / "stderr").open("wb") as errors:
            self._child = subprocess.Popen(
                [sys.executable, str(_HERE / "worker.py")], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=errors, cwd=self.folder, env=os.environ | more,
                start_new_session=True,
            )  # fmt: skip
        self._done = 0
        # The process reports when its imports are done; it may be interrupted only then.
        assert self._child.stdout is not None
        if not self._child.stdout.readline():
            raise SystemExit(
                f"fuzz: a worker does not start: {(self.folder / 'stderr').read_text()}"
            )

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.kill()
            self._child.communicate()
        self._child = None


def _used(pid: int, of: str = "") -> float:
    """Processor time of the main thread of a process (s); of="stat": of all its threads."""
    try:
        fields = (
            Path(f"/proc/{pid}/{of or f'task/{pid}/stat'}").read_text().rpartition(")")[2].split()
        )
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Run jobs until there are none."""
    # Memory mapped by the imports does not count as memory of a call.
    import call_runner

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY + used, MEMORY + used))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 28, 1 << 28))
    jobs = call_runner.JOBS
    with tempfile.TemporaryDirectory(dir=".") as place:
        os.chdir(place)
        answers.write("ready\n")
        answers.flush()
        while True:
            line = sys.stdin.readline()
            if not line:
                return
            job = json.loads(line)
            try:
                try:
                    # Interrupt the job only, not the loop.
                    signal.signal(signal.SIGINT, signal.default_int_handler)
                    answer = jobs[job.pop("job")](**job)
                finally:
                    signal.signal(signal.SIGINT, signal.SIG_IGN)
            except KeyboardInterrupt:
                signal.signal(signal.SIGINT, signal.SIG_IGN)
                answer = {"verdict": "stopped at a given limit", "detail": ""}
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            answer["size"] = pages * resource.getpagesize()
            answers.write(json.dumps(answer) + "\n")
            answers.flush()


if __name__ == "__main__":
    main()
