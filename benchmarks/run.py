"""Run the benchmarks, or some (--only); write tables (CSV, Markdown) and pictures.

Times are medians, ratios are measured in one run: machines are noisy. Peers that are not installed
are left out with a line; `./run bench --peers` installs them first.
"""

import argparse
import csv
from pathlib import Path
from typing import Any

import branch
import combined
import kernel_transforms
import memory
import motion
import orders
import response_curve
import steady
from combined import draw_methods
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from timing import machine, show_time, versions

PARTS = ("kernels", "response", "orders", "branch", "steady", "motion", "memory")
Row = dict[str, Any]


def write_csv(path: Path, rows: list[Row]) -> None:
    """Write rows with a head line about the machine."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        file.write(f"# {machine()}\n# {versions()}\n")
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)


def draw_error_against_time(path: Path, rows: list[Row]) -> None:
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


def draw_motion(path: Path, one: list[Row], many: list[Row]) -> None:
    """Draw error against run time of one trajectory and of many."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2, sharey=True)
    draw_methods(axes[0], one, "one trajectory")
    draw_methods(axes[1], many, "an ensemble, time a trajectory")
    axes[0].set_ylabel("error of the last state at t = 200")
    figure.savefig(path, dpi=160)


def draw_memory(path: Path, rows: list[Row]) -> None:
    """Draw error against run time of a motion with memory."""
    figure = Figure(figsize=(7, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    draw_methods(axis, rows, "motion with memory, alpha = 0.1, to t = 100")
    axis.set_ylabel("error of the last displacements")
    figure.savefig(path, dpi=160)


def motion_table(title: str, rows: list[Row]) -> list[str]:
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


def show_error(value: float) -> str:
    """Write an error; nothing for what is not known."""
    return "" if value != value else f"{value:.1e}"


def of_kernels(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Transforms of kernels."""
    rows = kernel_transforms.run()
    write_csv(out / "kernel_transforms.csv", rows)
    lines = ["", "| transforms of a kernel | a pair (R_c, R_s) | relative error |"]
    lines += ["| --- | --- | --- |"]
    return lines + [
        f"| {row['method']} | {show_time(row['seconds'])} | {row['error']:.1e} |" for row in rows
    ], {}


def of_response(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Response curves of the mount."""
    rows, jobs = response_curve.run()
    write_csv(out / "error_against_time.csv", rows)
    write_csv(out / "response_jobs.csv", jobs)
    draw_error_against_time(out / "error_against_time.png", rows)
    lines = ["", "| response of the mount | time | target |", "| --- | --- | --- |"]
    return lines + [
        f"| {row['job']} | {show_time(row['seconds'])} | "
        f"{show_time(row['target']) if row['target'] else ''} |"
        for row in jobs
    ], {}


def of_orders(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Orders chosen at each frequency."""
    rows = orders.run()
    write_csv(out / "orders.csv", rows)
    lines = [
        "",
        "| Newton response of 500 frequencies | tolerance | error | orders, median and most "
        "| a point | orders for all as accurate | a point | times ours |",
        "| --- |" + " --- |" * 7,
    ]
    return lines + [
        f"| {row['system']} | {row['tolerance']:.0e} | {row['error']:.1e} | {row['median']:g}, "
        f"{row['most']} | {show_time(row['seconds_a_point'])} | {row['fixed']} | "
        f"{show_time(row['fixed_seconds_a_point'])} | {row['ratio']:.1f} |"
        for row in rows
    ], {}


def of_branch(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Branch of the mount through its folds, with the peers."""
    rows, others = branch.run()
    write_csv(out / "branch.csv", rows)
    write_csv(out / "branch_others.csv", others)
    lines = [
        "",
        "| branch of the mount through two folds | setting | time | points | error of the folds "
        "| of the amplitudes | times ours |",
        "| --- |" + " --- |" * 6,
    ]
    lines += [
        f"| {row['method']} | {row['setting']} | {show_time(row['seconds'])} | {row['points']} | "
        f"{show_error(row['fold_error'])} | {show_error(row['error'])} | "
        f"{'' if row['ratio'] != row['ratio'] else format(row['ratio'], '.2g')} |"
        for row in rows
    ]
    lines += ["", "| further branches, orders to 9 | time | points |", "| --- | --- | --- |"]
    lines += [
        f"| {row['method']}{', with multipliers' if row['multipliers'] else ''} | "
        f"{show_time(row['seconds'])} | {row['points']} |"
        for row in others
    ]
    worst = [{**row, "error": max(row["error"], row["fold_error"])} for row in rows]
    return lines, {
        "branch through two folds": [row for row in worst if not row["multipliers"]],
        "the same with Floquet multipliers": [row for row in worst if row["multipliers"]],
    }


def of_steady(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Steady motions of the pendulum."""
    rows = steady.run()
    write_csv(out / "steady.csv", rows)
    lines = ["", "| steady motions of the pendulum | time | error |", "| --- | --- | --- |"]
    return lines + [
        f"| {row['job']} | {show_time(row['seconds'])} | {show_error(row['error'])} |"
        for row in rows
    ], {}


def of_motion(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Motions of the pendulum, with the peers."""
    one, many = motion.run()
    write_csv(out / "motion.csv", one)
    write_csv(out / "ensemble.csv", many)
    draw_motion(out / "motion.png", one, many)
    lines = motion_table("one motion to t = 200, time at an error of", one)
    lines += motion_table("an ensemble, time a trajectory at an error of", many)
    return lines, {
        "one motion of the pendulum to t = 200": one,
        "an ensemble of 1024, time a trajectory": many,
    }


def of_memory(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Motions with memory, with the peers."""
    rows, short, growth = memory.run()
    write_csv(out / "memory.csv", rows)
    write_csv(out / "memory_short.csv", short)
    write_csv(out / "memory_growth.csv", growth)
    draw_memory(out / "memory.png", rows)
    lines = []
    for title, part in (("100", rows), ("1", short)):
        lines += ["", f"| motion with memory to t = {title} | setting | error | time |"]
        lines += ["| --- | --- | --- | --- |"]
        lines += [
            f"| {row['method']} | {row['setting']} | {show_error(row['error'])} | "
            f"{show_time(row['seconds'])} |"
            for row in part
        ]
    lines += ["", "| steps of a motion with memory | a step |", "| --- | --- |"]
    lines += [f"| {row['steps']} | {show_time(row['seconds_a_step'])} |" for row in growth]
    return lines, {"motion with memory to t = 100": rows, "motion with memory to t = 1": short}


def chosen(text: str) -> list[str]:
    """Parts named in --only, in the order of PARTS."""
    wanted = {name.strip() for name in text.split(",")}
    unknown = sorted(wanted - set(PARTS))
    if unknown:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not one of {', '.join(PARTS)}")
    return [name for name in PARTS if name in wanted]


def main() -> None:
    """Run what is asked for and write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    parser.add_argument(
        "--only", type=chosen, default=list(PARTS), help=f"some of {','.join(PARTS)}, with commas"
    )
    options = parser.parse_args()
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    lines, problems = [machine(), "", versions()], {}
    print("\n".join(lines))
    jobs = (of_kernels, of_response, of_orders, of_branch, of_steady, of_motion, of_memory)
    for name, job in zip(PARTS, jobs, strict=True):
        if name in options.only:
            more, found = job(out)
            lines += more
            problems |= found
    if problems:
        write_csv(out / "all.csv", combined.flat(problems))
        combined.draw(out / "all.png", problems)
        lines += combined.table(problems)
    page = "\n".join(lines) + "\n"
    (out / "benchmarks.md").write_text(page, encoding="utf-8")
    print("\n" + page + f"\nTables and pictures: {out}")


if __name__ == "__main__":
    main()
