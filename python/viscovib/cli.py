"""The command ``viscovib``: run, plan and plot scenes."""

import argparse
import sys
import warnings
from pathlib import Path

from viscovib import __version__
from viscovib.errors import ConvergenceWarning, FileError, StabilityWarning, ViscovibError
from viscovib.plots import save_response
from viscovib.response import Response
from viscovib.scene import Scene, plan, run

_UNSOLVED, _BAD_INPUT, _BAD_FILE, _INTERRUPTED = 1, 2, 3, 130


def main(arguments: list[str] | None = None) -> int:
    """Run one command; the exit status is that of the standalone driver."""
    options = _parser().parse_args(arguments)
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", StabilityWarning)
    warnings.simplefilter("ignore", ConvergenceWarning)
    try:
        return int(options.action(options))
    except FileError as error:
        print(f"viscovib: {error}", file=sys.stderr)
        return _BAD_FILE
    except ViscovibError as error:
        print(f"viscovib: {error}", file=sys.stderr)
        return _BAD_INPUT
    except KeyboardInterrupt:
        print("viscovib: interrupted", file=sys.stderr)
        return _INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="viscovib", description=__doc__)
    parser.add_argument("--version", action="version", version=f"viscovib {__version__}")
    commands = parser.add_subparsers(required=True, metavar="command")
    for name, action, text in (
        ("run", _run, "compute a scene; write its table and picture"),
        ("plan", _plan, "say what a scene would compute and what is skipped, and why"),
        ("plot", _plot, "compute a scene and write only its picture"),
    ):
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument("scene", type=Path, help="scene file (*.nml)")
        command.set_defaults(action=action)
        if name != "plan":
            command.add_argument("--out", type=Path, default=Path("out"), help="folder (out)")
            command.add_argument("--quiet", action="store_true", help="only warnings and errors")
    return parser


def _run(options: argparse.Namespace) -> int:
    response = _compute(options)
    table = options.out / f"{options.scene.stem}_response.csv"
    response.to_csv(table)
    _picture(options, response)
    if not options.quiet:
        print(f"{table}: {response.converged.sum()} of {response.nu.size} frequencies solved")
        if response.converged.any():
            for name, unit in zip(response.dof_names, response.dof_units, strict=True):
                peak = response.peak(name)
                print(f"  largest |{name}_1| = {peak.amplitude:.6g} {unit} at nu = {peak.nu:.6g}")
    return 0 if response.converged.all() else _UNSOLVED


def _plan(options: argparse.Namespace) -> int:
    print(plan(options.scene))
    return 0


def _plot(options: argparse.Namespace) -> int:
    _picture(options, _compute(options))
    return 0


def _compute(options: argparse.Namespace) -> Response:
    scene = Scene.read(options.scene)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{options.out}: cannot be made a folder ({error.strerror})") from None
    return run(scene, progress=not options.quiet).response


def _picture(options: argparse.Namespace, response: Response) -> None:
    path = options.out / f"{options.scene.stem}_response.png"
    save_response(response, path)
    if not options.quiet:
        print(path)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"warning: {message}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
