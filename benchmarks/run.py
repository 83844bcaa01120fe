"""Run every benchmark; write tables (CSV, Markdown) and pictures.

Times are medians, ratios are measured in one run: machines are noisy.
"""

import argparse
import csv
from pathlib import Path
from typing import TYPE_CHECKING

import branch
import kernel_transforms
import memory
import motion
import response_curve
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from timing import machine, show_time

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def write_csv(path: Path, rows: list[dict[str, object]]) -> None:
    """Write rows with a head line about the machine."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        file.write(f"# {machine()}\n")
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def draw_error_against_time(path: Path, rows: list[dict[str, object]]) -> None:
    """Draw error of the curve against run time, a line for each number of harmonics."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    orders = sorted({row["harmonics"] for row in rows})
    for i, highest in enumerate(orders):
        line = [row for row in rows if row["harmonics"] == highest]
        axis.loglog(
            [1e3 * row["seconds"] for row in line],
            [max(row["error"], 1e-17) for row in line],
            marker="osD^vP*X"[i % 8],
            color=str(0.75 * i / len(orders)),
            linewidth=1,
            markersize=4,
            label=f"orders up to {highest}",
        )
    axis.set_xlabel("run time of 1000 frequencies (ms)")
    axis.set_ylabel(r"largest relative error of $\varphi_1$")
    axis.grid(color="0.9")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=160)


def draw_methods(axis: "Axes", rows: list[dict[str, object]], title: str) -> None:
    """Draw error against run time, a line a method."""
    for i, method in enumerate(dict.fromkeys(row["method"] for row in rows)):
        line = sorted((r["seconds"], r["error"]) for r in rows if r["method"] == method)
        own = method.startswith("viscovib")
        axis.loglog(
            [1e6 * time for time, _ in line],
            [max(error, 1e-16) for _, error in line],
            marker="osD^vP*X<>dh"[i % 12],
            color=str(0.55 * i / 12) if own else "#c8452e",
            linestyle="-" if own else "--",
            linewidth=1,
            markersize=4,
            label=method,
        )
    axis.set(title=title, xlabel="run time (us)")
    axis.grid(color="0.9")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=7)


def draw_motion(path: Path, one: list[dict[str, object]], many: list[dict[str, object]]) -> None:
    """Draw error against run time of one trajectory and of many."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2, sharey=True)
    draw_methods(axes[0], one, "one trajectory")
    draw_methods(axes[1], many, "an ensemble, time a trajectory")
    axes[0].set_ylabel("error of the last state at t = 200")
    figure.savefig(path, dpi=160)


def draw_memory(path: Path, rows: list[dict[str, object]]) -> None:
    """Draw error against run time of a motion with memory."""
    figure = Figure(figsize=(7, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    draw_methods(axis, rows, "motion with memory, alpha = 0.1, to t = 100")
    axis.set_ylabel("error of the last displacements")
    figure.savefig(path, dpi=160)


def motion_table(title: str, rows: list[dict[str, object]]) -> list[str]:
    """Return lines of a table: time at each wanted error."""
    targets = [f"{target:g}" for target in motion.TARGETS]
    lines = [
        "",
        f"| {title} | {' | '.join(targets)} |",
        "| --- |" + " --- |" * len(targets),
    ]
    for row in motion.at_errors(rows):
        cells = [show_time(row[t]) if row[t] == row[t] else "" for t in targets]
        lines.append(f"| {row['method']} | {' | '.join(cells)} |")
    return lines


def markdown(
    kernels: list[dict[str, object]],
    jobs: list[dict[str, object]],
    one: list[dict[str, object]],
    many: list[dict[str, object]],
    curves: list[dict[str, object]],
    hereditary: list[dict[str, object]],
    growth: list[dict[str, object]],
) -> str:
    """Return the tables as a page."""
    lines = [
        machine(),
        "",
        "| transforms of a kernel | a pair (R_c, R_s) | relative error |",
        "| --- | --- | --- |",
    ]
    lines += [
        f"| {row['method']} | {show_time(row['seconds'])} | {row['error']:.1e} |" for row in kernels
    ]
    lines += ["", "| response of the mount | time | target |", "| --- | --- | --- |"]
    lines += [
        f"| {row['job']} | {show_time(row['seconds'])} | "
        f"{show_time(row['target']) if row['target'] else ''} |"
        for row in jobs
    ]
    lines += ["", "| branch of the mount through two folds | time | points | error of the folds |"]
    lines += ["| --- | --- | --- | --- |"]
    lines += [
        f"| {row['job']} | {show_time(row['seconds'])} | {row['points']} | "
        f"{'' if row['fold_error'] != row['fold_error'] else format(row['fold_error'], '.1e')} |"
        for row in curves
    ]
    lines += motion_table("one motion to t = 200, time at an error of", one)
    lines += motion_table("an ensemble, time a trajectory at an error of", many)
    lines += ["", "| motion with memory to t = 100 | setting | error | time |"]
    lines += ["| --- | --- | --- | --- |"]
    lines += [
        f"| {row['method']} | {row['setting']} | {row['error']:.1e} | {show_time(row['seconds'])} |"
        for row in hereditary
    ]
    lines += ["", "| steps of a motion with memory | a step |", "| --- | --- |"]
    lines += [f"| {row['steps']} | {show_time(row['seconds_a_step'])} |" for row in growth]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run all and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    print(machine())
    kernels = kernel_transforms.run()
    rows, jobs = response_curve.run()
    write_csv(out / "kernel_transforms.csv", kernels)
    write_csv(out / "error_against_time.csv", rows)
    write_csv(out / "response_jobs.csv", jobs)
    draw_error_against_time(out / "error_against_time.png", rows)
    curves = branch.run()
    write_csv(out / "branch.csv", curves)
    one, many = motion.run()
    write_csv(out / "motion.csv", one)
    write_csv(out / "ensemble.csv", many)
    draw_motion(out / "motion.png", one, many)
    hereditary, growth = memory.run()
    write_csv(out / "memory.csv", hereditary)
    write_csv(out / "memory_growth.csv", growth)
    draw_memory(out / "memory.png", hereditary)
    page = markdown(kernels, jobs, one, many, curves, hereditary, growth)
    (out / "benchmarks.md").write_text(page, encoding="utf-8")
    print("\n" + page + f"\nTables and picture: {out}")


if __name__ == "__main__":
    main()
