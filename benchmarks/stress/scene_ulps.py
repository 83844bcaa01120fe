"""Change every number of every scene of data/scenes by an ulp, with the driver."""

import math
from collections.abc import Iterator
from pathlib import Path

from driven_scenes import ROOT, SCENES, changed, driver_of, moved, numbers_of, run_scene, text_of
from rounding import ALLOWED
from scenes import EPS
from steps import Job
from tally import Row, Tally

#: Relative changes for the measurement of the condition. The next one is used if a change alters
#: the shape of a table (number of points of a branch, of steps).
CHANGES = (1e-6, 1e-9, 1e-11)


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """One job per scene; the quick form runs three."""
    for scene in SCENES[:3] if quick else SCENES:
        yield f"ulp, {scene.name}", lambda scene=scene: by_ulp(scene)


def by_ulp(scene: Path) -> Row:
    """Change each number up and down; the change of the result relative to the condition."""
    text, driver = text_of(scene), driver_of(ROOT / "build" / "release")
    places = list(numbers_of(text))
    tally = Tally(
        "one ulp in scenes", scene.stem, ", ".join(dict.fromkeys(name for name, *_ in places)),
        ALLOWED, "change / (condition x epsilon)",
    )  # fmt: skip
    exact = run_scene(driver, text)
    condition, left = 1.0, []
    for name, start, end in places:
        value = float(text[start:end])
        for change in CHANGES:
            here = run_scene(driver, changed(text, start, end, value * (1 + change)))
            slope = moved(here, exact)[0] / change
            if math.isfinite(slope):
                condition += slope
                break
        else:
            left.append(name)
    for name, start, end in places:
        value = float(text[start:end])
        for to in (-math.inf, math.inf):
            label = f"{name} = {text[start:end]} {'+' if to > 0 else '-'} 1 ulp"
            near = changed(text, start, end, math.nextafter(value, to))
            made = tally.trial(label, lambda near=near: run_scene(driver, near))
            if made is not None:
                change, where = moved(made, exact)
                tally.measure(f"{label}, {where}", change / condition / EPS)
    tally.notes.append(f"condition {condition:.2g}")
    if left:
        tally.notes.append(f"shapes change with {', '.join(left)}: no part of the condition")
    return tally.row()
