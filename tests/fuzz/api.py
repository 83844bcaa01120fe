"""The whole public Python API: random calls, in a process with limits; and many calls at once."""

import random
from pathlib import Path
from typing import Any

from calls import FILES, SOUND, Caller, split
from verdicts import Case, Ending
from worker import Worker


class Calls:
    """The part that makes one call at a time."""

    name = "api"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)
        self._caller: Caller | None = None

    @property
    def caller(self) -> Caller:
        """Made at the first call: other parts may be all that is wanted."""
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


class Threads:
    """The part that makes many calls at once."""

    name = "threads"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)
        #: Those that draw pictures are left out: pyplot knows but one figure.
        self.sound = [text for text in SOUND if "plot" not in text]

    def case(self, rng: random.Random, seed: str) -> Case:
        """Some sound calls, most of them with a number changed a little."""
        texts = [self._near(rng, rng.choice(self.sound)) for _ in range(rng.randint(4, 12))]
        # The same call several times: what they share must not show.
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
    """A case from what a worker answered."""
    ending = Ending(answer["verdict"], str(answer.get("detail", "")))
    files = {"call.py": program(text), **{name: c.encode() for name, c in FILES.items()}}
    return Case(part, seed, ending, "python call.py", files)


def program(text: str) -> bytes:
    """A program that repeats calls; their text is its last lines, below a mark."""
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
    return [Calls(folder / "api"), Threads(folder / "threads")]
