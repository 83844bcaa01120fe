"""Checkpoints of sweeps: flipped bits, swapped, truncated and deleted files, killed sweeps."""

import random
from pathlib import Path
from typing import Any

from verdicts import Case, Ending
from worker import Worker


class Checkpoints:
    """The part that damages checkpoints; see damage.py."""

    name = "checkpoints"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)

    def case(self, rng: random.Random, seed: str) -> Case:
        """One checkpoint."""
        mark = f"{rng.getrandbits(64):x}"
        answer = self.worker.ask(job="checkpoint", seed=mark, patience=15)
        ending = Ending(answer["verdict"], str(answer.get("detail", "")))
        how = f"python -c 'import damage; print(damage.checkpoint(\"{mark}\"))'  in tests/fuzz"
        return Case(self.name, seed, ending, how, {"seed.txt": mark.encode()})


def parts(folder: Path, builds: list[str]) -> list[Any]:
    """Parts of the fuzzer in this module."""
    del builds
    return [Checkpoints(folder / "checkpoints")]
