"""The command ``viscovib explore``: a scene in the browser, with a slider for each number."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from viscovib.errors import FileError, InputError, one_line
from viscovib.scene.scene import Scene

if TYPE_CHECKING:
    from types import ModuleType


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    command.add_argument(
        "--keys", metavar="KEY,KEY", help="numbers with a slider, such as mount.stiffness_x"
    )
    command.add_argument("--port", type=int, default=0, help="port of the server (any free one)")
    command.add_argument(
        "--no-browser", action="store_true", help="only print the address of the page"
    )
    command.add_argument(
        "--sheet", action="store_true",
        help="no page: a figure with the effect of each number, in the folder of --out",
    )  # fmt: skip


def run_explore(options: argparse.Namespace) -> int:
    """Serve the page until it is interrupted, or save the sheet; return the exit status."""
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    keys = options.keys.split(",") if options.keys else None
    if options.sheet:
        _save_sheet(options, scene, keys)
        return 0
    if not 0 <= options.port <= 65535:
        raise InputError(f"--port {options.port}: must be 0 to 65535")
    _server().serve(scene, keys, port=options.port, browser=not options.no_browser)
    return 0


def _server() -> "ModuleType":
    try:
        from viscovib.explorer import server
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in ("bokeh", "jinja2", "tornado"):
            raise
        raise InputError(
            "explore: needs the package bokeh: pip install 'viscovib[explore]'; without it, --sheet"
        ) from None
    return server


def _save_sheet(options: argparse.Namespace, scene: Scene, keys: Sequence[str] | None) -> None:
    from viscovib.explorer.sheet import save_sheet

    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{options.out}: cannot be made a folder ({error.strerror})") from None
    path = options.out / f"{options.scene.stem}_explore.png"
    save_sheet(scene, path, keys)
    if not options.quiet:
        print(one_line(str(path)))
