"""All methods and peers in one figure and one table: run time against error.

Rows of a method are in the order from coarse to fine, in which its line is drawn.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from timing import show_time

TARGETS = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
Row = dict[str, Any]


def draw_methods(axis: Axes, rows: list[Row], title: str) -> None:
    """Draw error against run time, one line per method; peers dashed."""
    peers = 0
    for i, method in enumerate(dict.fromkeys(row["method"] for row in rows)):
        # In the order of the settings, from coarse to fine.
        line = [(r["seconds"], r["error"]) for r in rows if r["method"] == method]
        own = method.startswith("viscovib")
        peers += not own
        axis.loglog(
            [1e6 * time for time, _ in line],
            [max(error, 1e-16) for _, error in line],
            marker="osD^vP*X<>dh"[i % 12],
            color=str(0.55 * i / 12) if own else ("#c8452e", "#2e6fc8", "#3c8c3c")[peers % 3],
            linestyle="-" if own else "--",
            linewidth=1,
            markersize=4,
            label=method,
        )
    axis.set(title=title, xlabel="run time (us)")
    axis.grid(color="0.9")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=7)


def draw(path: Path, problems: dict[str, list[Row]]) -> None:
    """Draw a panel for each problem."""
    across = 2 if len(problems) > 1 else 1
    down = -(-len(problems) // across)
    figure = Figure(figsize=(6 * across, 4.6 * down), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, (title, rows) in zip(axes, problems.items(), strict=False):
        draw_methods(axis, rows, title)
        axis.set_ylabel("error")
    for axis in axes[len(problems) :]:
        axis.set_visible(False)
    figure.savefig(path, dpi=160)


def quickest(rows: list[Row], target: float) -> float:
    """Time of the fastest setting that reaches the target error; not interpolated."""
    return min((r["seconds"] for r in rows if r["error"] <= target), default=math.nan)


def table(problems: dict[str, list[Row]]) -> list[str]:
    """Lines of a table: time at each error and, for peers, the ratio to our fastest time."""
    lines = [
        "",
        f"| time at an error of at most | {' | '.join(f'{t:g}' for t in TARGETS)} |",
        "| --- |" + " --- |" * len(TARGETS),
    ]
    for title, rows in problems.items():
        lines.append(f"| **{title}** |" + " |" * len(TARGETS))
        ours = [row for row in rows if row["method"].startswith("viscovib")]
        for method in dict.fromkeys(row["method"] for row in rows):
            own, cells = method.startswith("viscovib"), []
            for target in TARGETS:
                time = quickest([r for r in rows if r["method"] == method], target)
                ratio = time / quickest(ours, target)
                cell = "" if np.isnan(time) else show_time(time)
                cells.append(cell if own or np.isnan(ratio) else f"{cell} ({ratio:.2g}x)")
            lines.append(f"| {method} | {' | '.join(cells)} |")
    return lines


def flat(problems: dict[str, list[Row]]) -> list[Row]:
    """All rows as one table for a file."""
    return [
        {"problem": title, **{k: row[k] for k in ("method", "setting", "seconds", "error")}}
        for title, rows in problems.items()
        for row in rows
    ]
