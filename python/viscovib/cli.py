"""The command ``viscovib``: run, plan, plot, sweep, explore and time scenes."""

import argparse
import sys
import warnings
from pathlib import Path

from viscovib import __version__, bench, cli_explore, cli_sweep
from viscovib.cli_sweep import run_sweep
from viscovib.errors import ConvergenceWarning, FileError, StabilityWarning, ViscovibError
from viscovib.limits import StoppedError, limit_memory, limited_seconds
from viscovib.pendulum import Pendulum
from viscovib.pictures import save_picture
from viscovib.results import Result
from viscovib.scene import Scene
from viscovib.scene_job import SceneResult, plan
from viscovib.scene_run import run
from viscovib.trajectory import Trajectory

_UNSOLVED, _BAD_INPUT, _BAD_FILE, _INTERRUPTED = 1, 2, 3, 130


def main(arguments: list[str] | None = None) -> int:
    """Run one command; the exit status is that of the standalone driver."""
    options = _parser().parse_args(arguments)
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", StabilityWarning)
    warnings.simplefilter("ignore", ConvergenceWarning)
    memory = 0.0
    try:
        memory = limit_memory(options.max_memory)
        return int(options.action(options))
    except StoppedError as stopped:
        print(f"viscovib: stopped: {stopped}", file=sys.stderr)
        return _UNSOLVED
    except MemoryError:
        print(
            f"viscovib: stopped: more than {memory:.3g} GB of memory are needed (--max-memory)",
            file=sys.stderr,
        )
        return _UNSOLVED
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
    extras = {
        "sweep": cli_sweep.add_options,
        "explore": cli_explore.add_options,
        "bench": bench.add_options,
    }
    for name, action, text in (
        ("run", _run, "compute a scene; write its table and picture"),
        ("plan", _plan, "say what a scene would compute and what is skipped, and why"),
        ("plot", _plot, "compute a scene and write only its picture"),
        ("sweep", run_sweep, "compute a scene at every point of a grid; stopped, it goes on later"),
        (
            "explore",
            cli_explore.run_explore,
            "open a scene in the browser, with a slider for each number",
        ),
        ("bench", bench.run_bench, "time a scene on this machine, its error beside it"),
    ):
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument("scene", type=Path, help="scene file (*.nml)")
        command.add_argument(
            "--allow-paths", action="store_true",
            help="files that the scene names may be anywhere, not only in its folder or below",
        )  # fmt: skip
        command.add_argument(
            "--max-seconds", type=float, metavar="S",
            help="end after so many seconds with what is done, exit status 1",
        )  # fmt: skip
        command.add_argument(
            "--max-memory", type=float, metavar="GB",
            help="end, exit status 1, where more memory is needed (3/4 of the machine's)",
        )  # fmt: skip
        command.set_defaults(action=action)
        if name not in ("plan", "bench"):
            command.add_argument("--out", type=Path, default=Path("out"), help="folder (out)")
            command.add_argument("--quiet", action="store_true", help="only warnings and errors")
        if name in extras:
            extras[name](command)
    return parser


def _run(options: argparse.Namespace) -> int:
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    if scene.groups["sweep"]:
        return run_sweep(options)
    result = _compute(options, scene)
    assert isinstance(result.value, Result)
    table = options.out / f"{options.scene.stem}_{result.kind}.csv"
    result.to_csv(table)
    for i in range(1, len(result.switched) + 1):
        result.to_csv(options.out / f"{options.scene.stem}_{result.kind}_{i}.csv", i)
    wanting = "spectrum" in scene.groups and result.spectrum is None
    if result.spectrum is not None:
        result.spectrum_to_csv(options.out / f"{options.scene.stem}_spectrum.csv")
    _picture(options, result)
    if not options.quiet:
        print(f"{table}: " + result.value.summary().replace("\n", "\n  "))
    return 0 if result.value.complete and not wanting else _UNSOLVED


def _plan(options: argparse.Namespace) -> int:
    print(plan(Scene.read(options.scene, allow_paths=options.allow_paths)))
    return 0


def _plot(options: argparse.Namespace) -> int:
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    if scene.groups["sweep"]:
        return run_sweep(options)
    _picture(options, _compute(options, scene))
    return 0


def _compute(options: argparse.Namespace, scene: Scene) -> SceneResult:
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{options.out}: cannot be made a folder ({error.strerror})") from None
    with limited_seconds(options.max_seconds, partial=True):
        return run(scene, progress=not options.quiet)


def _picture(options: argparse.Namespace, result: SceneResult) -> None:
    assert isinstance(result.value, Result)
    pictures: list[Result] = [result.value]
    bases = None
    if isinstance(result.value, Trajectory) and isinstance(result.value.system, Pendulum):
        body = result.value.system
        loads = {"p1": (body.f0, body.p1), "p2": (body.m01, body.p2), "p3": (body.m02, body.p3)}
        bases = {name: p for name, (size, p) in loads.items() if size and p} or None
    if result.spectrum is not None:
        pictures.append(result.spectrum)
    for shown in pictures:
        path = options.out / f"{options.scene.stem}_{shown.kind}.png"
        save_picture(shown, path, bases=bases, others=result.switched)
        if not options.quiet:
            print(path)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"warning: {message}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
