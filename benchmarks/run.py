"""Run every benchmark; write tables (CSV, Markdown) and pictures.

Times are medians, ratios are measured in one run: machines are noisy.
"""

import argparse
import csv
from pathlib import Path

import kernel_transforms
import response_curve
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from timing import machine, show_time


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


def markdown(kernels: list[dict[str, object]], jobs: list[dict[str, object]]) -> str:
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
    page = markdown(kernels, jobs)
    (out / "benchmarks.md").write_text(page, encoding="utf-8")
    print("\n" + page + f"\nTables and picture: {out}")


if __name__ == "__main__":
    main()
