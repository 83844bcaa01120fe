"""Run all benchmarks or those of --only; write tables (CSV, Markdown) and figures.

Times are medians, and ratios are measured in one run, because machines are noisy. Peers that are
not installed are skipped with a message; `./run bench --peers` installs them first. Each part runs
in a separate process, which is stopped at its time limit; then the next part runs.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bodies
import branch
import combined
import explorer
import floors
import kernel_transforms
import laws
import memory
import motion
import multiple_scales
import orders
import peaks
import phases
import response_curve
import rubber
import skips
import steady
import structures
import switches
from combined import draw_methods
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from results import Part, keep, run_parts, write_csv
from timing import machine, show_time, versions

Row = dict[str, Any]


def draw_error_against_time(path: Path, rows: list[Row]) -> None:
    """Draw error of the curve against run time, one line per number of harmonics."""
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
    """Return the lines of a table: time at each error."""
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
    """Format an error; empty if it is not known."""
    return "" if value != value else f"{value:.1e}"


def of_kernels(out: Path) -> Part:
    """Transforms of kernels."""
    rows = kernel_transforms.run()
    write_csv(out / "kernel_transforms.csv", rows)
    lines = ["", "| transforms of a kernel | a pair (R_c, R_s) | relative error |"]
    lines += ["| --- | --- | --- |"]
    return lines + [
        f"| {row['method']} | {show_time(row['seconds'])} | {row['error']:.1e} |" for row in rows
    ], {}


def of_response(out: Path) -> Part:
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


def of_orders(out: Path) -> Part:
    """Automatic harmonics at each frequency."""
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


def of_branch(out: Path) -> Part:
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


def of_steady(out: Path) -> Part:
    """Steady motions of the pendulum."""
    rows = steady.run()
    write_csv(out / "steady.csv", rows)
    lines = ["", "| steady motions of the pendulum | time | error |", "| --- | --- | --- |"]
    return lines + [
        f"| {row['job']} | {show_time(row['seconds'])} | {show_error(row['error'])} |"
        for row in rows
    ], {}


def of_motion(out: Path) -> Part:
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


def of_memory(out: Path) -> Part:
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
    switched = switches.run()
    write_csv(out / "memory_switches.csv", switched)
    lines += ["", "| switches with memory to t = 20 | setting | error | time |"]
    lines += ["| --- | --- | --- | --- |"]
    lines += [
        f"| {row['method']} | {row['setting']} | "
        f"{'the judge' if row['error'] is None else show_error(row['error'])} | "
        f"{show_time(row['seconds'])} |"
        for row in switched
    ]
    lines += ["", "| steps of a motion with memory | a step |", "| --- | --- |"]
    lines += [f"| {row['steps']} | {show_time(row['seconds_a_step'])} |" for row in growth]
    return lines, {"motion with memory to t = 100": rows, "motion with memory to t = 1": short}


def of_scales(out: Path) -> Part:
    """Multiple scales, with the peer."""
    rows = multiple_scales.run()
    theirs = multiple_scales.peer()
    if theirs is None:
        print("OSCILATE is not installed: left out")
    else:
        rows.append({"job": "OSCILATE, formulas for the two oscillators", "seconds": theirs})
    write_csv(out / "multiple_scales.csv", rows)
    lines = ["", "| multiple scales | time | times ours |", "| --- | --- | --- |"]
    for row in rows:
        peer = row["job"].startswith("OSCILATE")
        ratio = f"{row['seconds'] / rows[-2]['seconds']:.0f}" if peer else ""
        lines.append(f"| {row['job']} | {show_time(row['seconds'])} | {ratio} |")
    return lines, {}


def of_floors(out: Path) -> Part:
    """Distance of every hot path from its floor."""
    rows, kernels = floors.run()
    write_csv(out / "floors.csv", rows)
    write_csv(out / "plain_kernels.csv", [{"kernel": k, "seconds": v} for k, v in kernels.items()])
    lines = ["", "| path | what it needs | floor | reached | ratio |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    lines += [
        f"| {row['path']} | {row['needed']} | {show_time(row['floor'])} | "
        f"{show_time(row['reached'])} | {row['ratio']:.1f} |"
        for row in rows
    ]
    return [
        *lines,
        "",
        f"A multiply-add of a register of eight takes {show_time(kernels['multiply_add'])} here, a "
        f"quotient of eight {show_time(kernels['division'])}, sine and cosine of eight "
        f"{show_time(kernels['sine_cosine'])}; a byte from or to memory "
        f"{show_time(kernels['memory'])}.",
    ], {}


def of_phases(out: Path) -> Part:
    """Distribution of the time of a point, and growth of the cost."""
    costs, growth = phases.run()
    write_csv(out / "growth.csv", growth)
    lines = []
    if costs:
        write_csv(out / "phases.csv", costs)
        lines += ["", "| one | takes | of that |", "| --- | --- | --- |"]
        for job in dict.fromkeys(row["job"] for row in costs):
            own = [row for row in costs if row["job"] == job]
            parts = "; ".join(
                f"{row['phase']} {100 * row['part']:.0f} %" for row in own if row["part"] >= 0.02
            )
            lines.append(f"| {job} | {show_time(own[0]['seconds'])} | {parts} |")
    lines += ["", "| job | grows with | times | exponent of the last two |"]
    lines += ["| --- | --- | --- | --- |"]
    for job in dict.fromkeys(row["job"] for row in growth):
        own = [row for row in growth if row["job"] == job]
        times = ", ".join(f"{row['n']}: {show_time(row['seconds'])}" for row in own)
        lines.append(f"| {job} | {own[0]['of']} | {times} | {own[-1]['exponent']:.2f} |")
    phases.draw(out / "phases.png", costs, growth)
    return lines, {}


def of_peaks(out: Path) -> Part:
    """Peak memory of every kind of job."""
    rows = peaks.run()
    write_csv(out / "peaks.csv", rows)
    lines = ["", "| peak memory of | grows with | short | long | one more takes | flat |"]
    lines += ["| --- | --- | --- | --- | --- | --- |"]
    return lines + [
        f"| {row['job']} | {row['of']} | {row['short']}: {row['low'] / 2**20:.1f} MiB | "
        f"{row['long']}: {row['high'] / 2**20:.1f} MiB | {row['each']:.0f} bytes | "
        f"{'yes' if row['flat'] else ''} |"
        for row in rows
    ], {}


def of_laws(out: Path) -> Part:
    """Branch points under force laws that are not polynomials."""
    rows, ratios = laws.run()
    write_csv(out / "laws.csv", rows)
    write_csv(out / "law_ratios.csv", ratios)
    lines = ["", "| law, orders to 15 | a branch point | target | pyHarm |"]
    lines += ["| --- | --- | --- | --- |"]
    lines += [
        f"| {row['law']} | {show_time(row['seconds'])} | "
        f"{show_time(row['target']) if row['target'] else ''} | "
        f"{show_time(row['peer']) if row['peer'] == row['peer'] else ''} |"
        for row in rows
    ]
    varying = laws.varying_loads()
    write_csv(out / "varying_loads.csv", varying)
    lines += ["", "| load by a formula | a point, constant load | formula | ratio | target |"]
    lines += ["| --- |" + " --- |" * 4]
    lines += [
        f"| {row['system']}, {row['load']} | {show_time(row['constant'])} | "
        f"{show_time(row['seconds'])} | {row['ratio']:.2f} | {laws.MOST_OF_LOAD:g} |"
        for row in varying
    ]
    many = laws.ensembles()
    write_csv(out / "law_ensembles.csv", many)
    lines += ["", "| ensembles to t = 200 | method, step | error | a motion | a step |"]
    lines += ["| --- |" + " --- |" * 4]
    lines += [
        f"| {row['law']} | {row['method']}, {row['dt']:g} | {row['error']:.0e} | "
        f"{show_time(row['seconds'])} | {show_time(row['seconds'] * row['dt'] / 200)} |"
        for row in many
    ]
    beside = laws.beside_heyoka()
    if beside:
        write_csv(out / "law_ensembles_peer.csv", beside)
        head = "| ensembles of 128 to t = 200, one core | error at most "
        lines += ["", head + "| viscovib | heyoka, batch of 8 | heyoka / viscovib |"]
        lines += ["| --- |" + " --- |" * 4]
        lines += [
            f"| {row['law']} | {row['error']:.0e} | {show_time(row['viscovib_seconds'])} "
            f"({row['viscovib']}) | {show_time(row['heyoka_seconds'])} ({row['heyoka']}) | "
            f"{row['ratio']:.2f} |"
            for row in beside
        ]
    single = laws.one_motion()
    write_csv(out / "law_motion.csv", single)
    lines += ["", "| one motion under tanh and sin to t = 200 | setting | error | time |"]
    lines += ["| --- |" + " --- |" * 3]
    lines += [
        f"| {row['method']} | {row['setting']} | {row['error']:.0e} | {show_time(row['seconds'])} |"
        for row in single
    ]
    lines += ["", "| a polynomial | a branch point | as a text that is one | ratio | target |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    return lines + [
        f"| {row['law']} | {show_time(row['seconds'])} | {show_time(row['text'])} | "
        f"{row['ratio']:.2f} | {laws.MOST_RATIO:g} |"
        for row in ratios
    ], {}


def of_bodies(out: Path) -> Part:
    """A body in space on its mounts."""
    rows = bodies.run()
    write_csv(out / "bodies.csv", rows)
    lines = ["", "| a body on three mounts | time | NumPy, SciPy | differ by |"]
    lines += ["| --- | --- | --- | --- |"]
    return lines + [
        f"| {row['job']} | {show_time(row['seconds'])} | "
        f"{show_time(row['other']) if row['other'] == row['other'] else ''} | "
        f"{row['difference']:.0e} |"
        for row in rows
    ], {}


def of_rubber(out: Path) -> Part:
    """Fits of kernels to measured data."""
    rows = rubber.run()
    write_csv(out / "rubber.csv", rows)
    lines = ["", "| rubber from data | time | target | residual of storage | of loss |"]
    lines += ["| --- |" + " --- |" * 4]

    def part(value: float) -> str:
        return f"{100 * value:.2g} %" if value == value else ""

    return lines + [
        f"| {row['job']} | {show_time(row['seconds'])} | "
        f"{show_time(row['target']) if row['target'] else ''} | {part(row['storage'])} | "
        f"{part(row['loss'])} |"
        for row in rows
    ], {}


def of_structures(out: Path) -> Part:
    """Branches of structures condensed to their nonlinear coordinates."""
    rows = structures.run()
    write_csv(out / "structures.csv", rows)
    lines = [
        "",
        "| branch of a structure | time | points | a point | target | times whole | error |",
    ]
    lines += ["| --- |" + " --- |" * 6]
    return lines + [
        f"| {row['job']} | {show_time(row['seconds'])} | {row['points'] or ''} | "
        f"{show_time(row['seconds'] / row['points']) if row['points'] else ''} | "
        f"{show_time(row['target']) if row['target'] else ''} | "
        f"{'' if row['ratio'] != row['ratio'] else format(row['ratio'], '.3g')} | "
        f"{show_error(row['error'])} |"
        for row in rows
    ], {}


def of_explorer(out: Path) -> Part:
    """From a key on a slider to the curve in the browser."""
    rows = explorer.run()
    write_csv(out / "explorer.csv", rows)
    lines = ["", "| explorer: from a key to the curve | least | median | the core alone |"]
    lines += ["| --- | --- | --- | --- |"]
    return lines + [
        f"| {row['scene']} | {show_time(row['least'])} | {show_time(row['median'])} | "
        f"{show_time(row['core'])} |"
        for row in rows
    ], {}


def of_skips(out: Path) -> tuple[list[str], dict[str, list[Row]]]:
    """Time saved by each skip of a plan."""
    rows = skips.run()
    write_csv(out / "skips.csv", rows)
    lines = [
        "",
        "| what is skipped | in | time | of its twin | gain | results differ by |",
        "| --- |" + " --- |" * 5,
    ]
    return lines + [
        f"| {row['skip']} | {row['job']} | {show_time(row['seconds'])} | "
        f"{show_time(row['twin'])} | {row['gain']:.2g} | {row['difference']:.0e} |"
        for row in rows
    ], {}


#: Name, job and time limit in seconds (four times the time on an idle machine).
PARTS: dict[str, tuple[Callable[[Path], Part], float]] = {
    "kernels": (of_kernels, 300),
    "response": (of_response, 600),
    "orders": (of_orders, 600),
    "branch": (of_branch, 1200),
    "steady": (of_steady, 600),
    "motion": (of_motion, 1200),
    "memory": (of_memory, 900),
    "scales": (of_scales, 600),
    "body": (of_bodies, 600),
    "structures": (of_structures, 900),
    "rubber": (of_rubber, 600),
    "floors": (of_floors, 600),
    "phases": (of_phases, 900),
    "laws": (of_laws, 300),
    "peaks": (of_peaks, 300),
    "skips": (of_skips, 900),
    "explorer": (of_explorer, 300),
}


def chosen(text: str) -> list[str]:
    """Parts named in --only, in the order of PARTS."""
    wanted = {name.strip() for name in text.split(",")}
    unknown = sorted(wanted - set(PARTS))
    if unknown:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not one of {', '.join(PARTS)}")
    return [name for name in PARTS if name in wanted]


def main() -> int:
    """Run the selected parts and write the results; return 1 if a part gave no result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    parser.add_argument(
        "--only", type=chosen, default=list(PARTS), help=f"some of {','.join(PARTS)}, with commas"
    )
    parser.add_argument(
        "--patience", type=float, default=1.0, help="factor of the time limits of the parts"
    )
    parser.add_argument("--part", choices=list(PARTS), help=argparse.SUPPRESS)
    options = parser.parse_args()
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    if options.part:
        keep(out, options.part, PARTS[options.part][0](out))
        return 0
    print(f"{machine()}\n{versions()}", flush=True)
    limits = {name: options.patience * PARTS[name][1] for name in options.only}
    found, lost = run_parts(Path(__file__), out, limits)
    lines = [machine(), "", versions()]
    problems: dict[str, list[Row]] = {}
    for more, of_part in found.values():
        lines += more
        problems |= of_part
    lines += [f"\n{line}" for line in lost]
    if problems:
        write_csv(out / "all.csv", combined.flat(problems))
        combined.draw(out / "all.png", problems)
        lines += combined.table(problems)
    page = "\n".join(lines) + "\n"
    (out / "benchmarks.md").write_text(page, encoding="utf-8")
    print("\n" + page + f"\nTables and pictures: {out}")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
