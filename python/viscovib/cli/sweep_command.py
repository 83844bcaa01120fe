"""The command ``viscovib sweep``: a scene over a grid of its parameters."""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viscovib import _native
from viscovib.cli.words import as_json
from viscovib.common.files import whole_file
from viscovib.common.limits import StoppedError, limited_seconds
from viscovib.errors import FileError, InputError, one_line
from viscovib.plots.maps import save_map
from viscovib.scene.scene import Scene
from viscovib.sweeps.sweeping import sweep

if TYPE_CHECKING:
    import xarray as xr

_MAX_COUNT = 10**6


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options that only this command has."""
    command.add_argument(
        "--over", action="append", metavar="KEY=FROM:TO:COUNT",
        help="a parameter and its values (or KEY=A,B,C), instead of the scene's &sweep groups; "
        "may be given several times",
    )  # fmt: skip
    command.add_argument(
        "--checkpoint", type=Path, metavar="FOLDER",
        help="folder of the results, from which a sweep resumes (OUT/SCENE_sweep.zarr)",
    )  # fmt: skip
    command.add_argument(
        "--errors", choices=("raise", "keep"), default="raise",
        help="treatment of a point that fails: end the sweep, or leave a gap",
    )  # fmt: skip
    command.add_argument("--all", action="store_true", help="keep whole curves, not a few numbers")
    command.add_argument("--threads", type=int, help="threads (as many as processors)")
    command.add_argument("--scheduler", metavar="ADDRESS", help="a Dask cluster to compute on")


def run_sweep(options: argparse.Namespace) -> int:
    """Compute, write the table and the picture; return the exit status."""
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    grid = _grid(options.over) if getattr(options, "over", None) else None
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{options.out}: cannot be made a folder ({error.strerror})") from None
    stem = options.out / f"{options.scene.stem}_sweep"
    checkpoint = getattr(options, "checkpoint", None) or stem.with_suffix(".zarr")
    keep_all = getattr(options, "all", False)
    shown = sys.stderr.isatty() and not options.quiet and not options.json
    client = _client(getattr(options, "scheduler", None))
    try:
        # Unfinished points at the end of the time are omitted.
        with limited_seconds(options.max_seconds, partial=False):
            data = sweep(
                scene, grid, client, checkpoint, shown,
                errors=getattr(options, "errors", "raise"),
                extract="all" if keep_all else "summary",
                n_threads=getattr(options, "threads", None),
            )  # fmt: skip
    except (KeyboardInterrupt, StoppedError):
        held = one_line(str(checkpoint))
        print(f"{held}: contains the finished points, the same command continues from there",
              file=sys.stderr)  # fmt: skip
        raise
    finally:
        if client is not None:
            client.close()
    lines = [f"{checkpoint}: {' x '.join(f'{n} {d}' for d, n in data.sizes.items())}"]
    failed = 0
    if "point_outcome" in data:
        failed = int((data.point_outcome != "completed").sum())
        lines.append(
            f"{failed} of {data.point_outcome.size} points failed, point_error contains the reasons"
        )
    if not keep_all:
        table, picture = stem.with_suffix(".csv"), stem.with_suffix(".png")
        write_table(data, table)
        picture_line = save_map(data, picture)
        drawn = not picture_line.startswith("no")
        lines += [f"{table}", f"{picture}" if drawn else "", picture_line]
    status = 1 if failed else 0
    if options.json:
        info = {"scene": options.scene, "status": status, "kind": "sweep", "checkpoint": checkpoint,
                "sizes": dict(data.sizes), "failed": failed}  # fmt: skip
        files = {} if keep_all else {"tables": [table], "pictures": [picture] * drawn}
        print(as_json(info | files))
    elif not options.quiet:
        print(*map(one_line, filter(None, lines)), sep="\n")
    return status


def write_table(data: xr.Dataset, path: Path) -> None:
    """Write the numbers as CSV, one row per point; the last parameter varies fastest."""
    names = [str(name) for name in data.data_vars]
    dims = [str(d) for d in data[names[0]].dims]
    columns = [data[name].values.ravel() for name in names]
    meshes = np.meshgrid(*(data[d].values for d in dims), indexing="ij")
    # A file name may contain a line break.
    swept = one_line(data.attrs["swept"])
    with whole_file(path) as file:
        file.write(f"# viscovib {data.attrs['viscovib']}, sweep of {swept}\n")
        units = [f"{d} ({u})" for d in dims if (u := data[d].attrs.get("units"))]
        if units:
            file.write(f"# {', '.join(units)}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*dims, *names])
        for row in zip(*(mesh.ravel() for mesh in meshes), *columns, strict=True):
            writer.writerow([f"{v:.16e}" if isinstance(v, float) else v for v in row])


def _grid(given: list[str]) -> dict[str, Any]:
    """Return values from KEY=FROM:TO:COUNT or KEY=A,B,C."""
    grid: dict[str, Any] = {}
    for text in given:
        key, _, values = text.partition("=")
        if not key or not values:
            raise InputError(f"--over {text}: must be KEY=FROM:TO:COUNT or KEY=A,B,C")
        if key in grid:
            raise InputError(f"--over {text}: {key} is swept already")
        try:
            grid[key] = _values(values)
        except ValueError:
            raise InputError(f"--over {text}: must be KEY=FROM:TO:COUNT or KEY=A,B,C") from None
    return grid


def _values(text: str) -> Any:
    if ":" in text:
        first, last, count = text.split(":")
        n = _native.integer("COUNT", int(count), 2, _MAX_COUNT)
        return np.linspace(float(first), float(last), n)
    words = text.split(",")
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        return words


def _client(address: str | None) -> Any:
    if address is None:
        return None
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler: needs the package distributed: pip install 'viscovib[sweep]'"
        ) from None
    try:
        return Client(address, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: cannot be reached ({error})") from None
