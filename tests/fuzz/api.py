"""The whole public Python API: random calls in a process with limits, and many calls at once."""

import json
import math
import random
import re
from pathlib import Path
from typing import Any

from calls import FILES, READERS, SOUND, Caller, split
from scenes import torn
from verdicts import Case, Ending
from worker import Worker

#: Replacements for a word or a number of a file.
_PIECES = (
    b"", b"0", b"1", b"-1", b"2", b"0.5", b"1e308", b"1e-308", b"5e-324", b"1e400", b"nan", b"NaN",
    b"inf", b"-inf", b"Infinity", b"1e3", b"2147483648", b"9223372036854775808", b"1" * 400, b"x",
    b"null", b"true", b"[]", b"{}", b"[[]]", b'"x"', b'""', b"[" * 3000, b"\x00", b"\xff", b"\xe9",
    b"\r\n", b"\n\n", b",", b";", b"\t", b"%", b"pattern", b"complex", b"hermitian", b"array",
    b"skew-symmetric", b"1000000000 1000000000", b'"abel"', b'"prony"', b'"rabotnov"',
    b'{"kind": "abel", "amplitude": 0.1, "alpha": 0.3}', b"Hz", b"MPa", b"rad/s", b"K", b"3,5",
)  # fmt: skip
#: Replacements for a JSON value.
_VALUES = (
    None, True, 0, 1, -1, 2, 0.5, 1e308, 1e-308, 5e-324, math.nan, math.inf, 10**400, 2**31, "x",
    "", "nan", "prony", "abel", "rabotnov", "sum", "K", "E", "model", [], {}, [[]], [0, 1],
    [[1, 2]], ["x"],
    {"kind": "abel", "amplitude": 0.1, "alpha": 0.3}, "\ud800", "x" * 5000, 3.0,
)  # fmt: skip


class Calls:
    """The part that makes single calls."""

    name = "api"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)
        self._caller: Caller | None = None

    @property
    def caller(self) -> Caller:
        """Created at the first call, because a run may use other parts only."""
        if self._caller is None:
            answer = self.worker.ask(job="makers", patience=600)
            if "makers" not in answer:
                raise SystemExit(f"fuzz: sound calls fail: {answer}")
            self._caller = Caller(answer["makers"])
        return self._caller

    def case(self, rng: random.Random, seed: str) -> Case:
        """One call."""
        text = self.caller.call(rng)
        return ended("api", seed, text, self.worker.ask(job="call", text=text))


class Interrupts(Calls):
    """The part that interrupts calls at random times and measures how long they continue."""

    name = "interrupts"

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.reactions: list[float] = []

    def case(self, rng: random.Random, seed: str) -> Case:
        """One call; most calls end before the interrupt."""
        text = self.caller.call(rng)
        answer = self.worker.ask(job="call", text=text, patience=10 ** rng.uniform(-2, 0))
        if "reaction" in answer:
            self.reactions.append(answer["reaction"])
        return ended(self.name, seed, text, answer)

    def reported(self) -> str:
        """Reaction times in a line."""
        times = sorted(self.reactions)
        if not times:
            return "interrupts: no call was stopped"
        return (
            f"interrupts: {len(times)} calls stopped, processor time afterwards: median "
            f"{times[len(times) // 2]:.2f} s, longest {times[-1]:.2f} s"
        )


class Files:
    """The part that damages files and reads them."""

    name = "files"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)

    def case(self, rng: random.Random, seed: str) -> Case:
        """One reader, with one or all of its files damaged."""
        text, names = rng.choice(READERS)
        some = names if rng.random() < 0.2 else [rng.choice(names)]
        files = {name: spoilt(rng, FILES[name].encode()) for name in some}
        reported = {name: content.decode("latin-1") for name, content in files.items()}
        answer = self.worker.ask(job="call", text=text, files=reported)
        case = ended("files", seed, text, answer)
        return Case(case.part, seed, case.ending, case.how, {**case.files, **files})


def spoilt(rng: random.Random, content: bytes) -> bytes:
    """A file with some numbers and words replaced, or truncated."""
    draw = rng.random()
    if draw < 0.25:
        return torn(rng, content)
    if content.startswith(b"{") and draw < 0.8:
        return json.dumps(_other(rng, json.loads(content))).encode()
    found = content
    for _ in range(rng.choice([1, 1, 2, 3])):
        words = list(re.finditer(rb"-?\d[\d.e+]*|\w+|\"[^\"]*\"|[\[{][^\[\]{}]*[\]}]", found))
        if not words:
            break
        here = rng.choice(words)
        found = found[: here.start()] + rng.choice(_PIECES) + found[here.end() :]
    return found


def _other(rng: random.Random, held: Any) -> Any:
    """A JSON value with one of its parts replaced or removed."""
    if not isinstance(held, (dict, list)) or not held or rng.random() < 0.1:
        return rng.choice(_VALUES)
    if isinstance(held, dict):
        key = rng.choice(sorted(held))
        if rng.random() < 0.1:
            return {name: part for name, part in held.items() if name != key}
        return {**held, key: _other(rng, held[key])}
    i = rng.randrange(len(held))
    return [*held[:i], *[_other(rng, held[i])] * rng.choice([0, 1, 1, 1, 2]), *held[i + 1 :]]


class Threads:
    """The part that makes many calls in parallel."""

    name = "threads"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)
        #: Calls that draw figures are excluded: pyplot has a global current figure.
        self.sound = [text for text in SOUND if "plot" not in text]

    def case(self, rng: random.Random, seed: str) -> Case:
        """Several valid calls, most of them with a slightly changed number."""
        texts = [self._near(rng, rng.choice(self.sound)) for _ in range(rng.randint(4, 12))]
        # Repeated calls, so that shared objects are tested.
        texts += [rng.choice(texts) for _ in range(rng.randint(0, 4))]
        answer = self.worker.ask(job="threads", texts=texts, n=rng.choice([2, 3, 8]), patience=15)
        return ended("threads", seed, "\n".join(texts), answer)

    @staticmethod
    def _near(rng: random.Random, text: str) -> str:
        name, given = split(text)
        if name is None:
            return text
        numbers = [key for key, value in given.items() if _is_float(value)]
        if not numbers:
            return text
        key = rng.choice(numbers)
        given[key] = repr(float(given[key]) * rng.uniform(0.8, 1.2))
        inside = ", ".join(v if k.startswith("*") else f"{k}={v}" for k, v in given.items())
        return f"{name}({inside})"


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "." in text


def ended(part: str, seed: str, text: str, answer: dict[str, Any]) -> Case:
    """The case of an answer of a worker."""
    ending = Ending(answer["verdict"], str(answer.get("detail", "")))
    files = {"call.py": program(text), **{name: c.encode() for name, c in FILES.items()}}
    return Case(part, seed, ending, "python call.py", files)


def program(text: str) -> bytes:
    """A program that repeats calls; their text is in its last lines, below a mark."""
    head = (
        "from decimal import Decimal\nfrom fractions import Fraction\n"
        "from math import inf, nan\nfrom pathlib import Path\n\n"
        "import numpy as np\nimport viscovib as vv\nimport xarray as xr\n\n"
    )
    return f"{head}# call\n{text}\n".encode()


def text_of(program: bytes) -> str:
    """The text of a call in a program."""
    return program.decode().partition("# call\n")[2].strip()


def parts(folder: Path, builds: list[str]) -> list[Any]:
    """Parts of the fuzzer in this module."""
    del builds
    return [
        Calls(folder / "api"), Threads(folder / "threads"), Files(folder / "files"),
        Interrupts(folder / "interrupts"),
    ]  # fmt: skip
