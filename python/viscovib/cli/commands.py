"""The command ``viscovib``: run, plan, plot, sweep, explore and time scenes."""

import argparse
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from viscovib import __version__
from viscovib.cli import bench, explore_command, sweep_command
from viscovib.cli.help_texts import NOTES
from viscovib.cli.sweep_command import run_sweep
from viscovib.cli.words import SHELLS, as_json, script
from viscovib.common.limits import StoppedError, limit_memory, limited_seconds
from viscovib.common.progress import counted_pieces
from viscovib.common.results import Result
from viscovib.errors import (
    ConvergenceWarning,
    FileError,
    InputError,
    StabilityWarning,
    ViscovibError,
    one_line,
)
from viscovib.plots.pictures import save_picture
from viscovib.scene.job import SceneResult, plan
from viscovib.scene.scene import Scene
from viscovib.sweeps.run_scene import run

_EXAMPLES = """examples:
  viscovib run mount.nml                    table and picture in out/
  viscovib run scenes/*.nml --json          a line of JSON for each scene
  viscovib plan mount.nml                   what would be computed
  viscovib explore mount.nml                sliders in the browser
  viscovib sweep mount.nml --over mount.stiffness_x=6:14:33
"""
_UNSOLVED, _BAD_INPUT, _BAD_FILE, _INTERRUPTED = 1, 2, 3, 130


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return the same exit status as the standalone driver."""
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


def _examples(name: str) -> list[str]:
    """Return examples of a subcommand."""
    return {
        "run": ["viscovib run mount.nml", "viscovib run scenes/*.nml --out tables --quiet",
                "viscovib run mount.nml --json | jq .numbers.peak_x.value"],
        "plan": ["viscovib plan mount.nml", "viscovib plan scenes/*.nml --json"],
        "plot": ["viscovib plot mount.nml --out pictures"],
        "sweep": ["viscovib sweep map.nml",
                  "viscovib sweep mount.nml --over mount.mass=1:2:11 --over load.amplitude=1,2"],
        "explore": ["viscovib explore mount.nml", "viscovib explore mount.nml --keys mount.mass",
                    "viscovib explore mount.nml --port 5006 --no-browser"],
        "bench": ["viscovib bench mount.nml", "viscovib bench scenes/*.nml --json"],
        "completion": ["source <(viscovib completion bash)", "source <(viscovib completion zsh)",
                       "viscovib completion fish > ~/.config/fish/completions/viscovib.fish"],
    }[name]  # fmt: skip


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="viscovib",
        description="Compute vibrations that scenes (*.nml) describe.",
        epilog=_EXAMPLES + "\n" + NOTES["status"],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"viscovib {__version__}")
    commands = parser.add_subparsers(required=True, metavar="command")
    extras = {
        "sweep": sweep_command.add_options,
        "explore": explore_command.add_options,
        "bench": bench.add_options,
    }
    for name, action, text in _COMMANDS:
        command = commands.add_parser(
            name,
            help=text,
            description=f"{text[0].upper()}{text[1:]}.",
            epilog="examples:\n" + "\n".join(f"  {line}" for line in _examples(name)),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(action=action, max_memory=None, json=False)
        if name == "completion":
            command.add_argument("shell", choices=SHELLS, help="whose completion")
            continue
        if name == "explore":
            command.add_argument("scene", type=Path, help="scene file (*.nml)")
        else:
            command.add_argument("scenes", type=Path, nargs="+", metavar="scene",
                                 help="scene files (*.nml)")  # fmt: skip
            command.add_argument(
                "--json",
                action="store_true",
                help="print a line of JSON per scene instead of text",
            )
        command.add_argument(
            "--allow-paths", action="store_true",
            help=NOTES["paths"],
        )  # fmt: skip
        command.add_argument(
            "--max-seconds", type=float, metavar="S",
            help=NOTES["seconds"],
        )  # fmt: skip
        command.add_argument(
            "--max-memory", type=float, metavar="GB",
            help=f"{NOTES['memory']} {NOTES['most_memory']}",
        )  # fmt: skip
        if name not in ("plan", "bench"):
            command.add_argument("--out", type=Path, default=Path("out"), help="folder (out)")
            command.add_argument("--quiet", action="store_true", help="only warnings and errors")
        if name in extras:
            extras[name](command)
    return parser


def _each(one: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    """Return an action for all scenes of a call; it returns the largest status."""

    def action(options: argparse.Namespace) -> int:
        scenes: list[Path] = options.scenes
        for i, scene in enumerate(scenes):
            for other in scenes[:i]:
                if hasattr(options, "out") and other.stem == scene.stem:
                    raise InputError(f"{scene}{NOTES['same_names']}{other}{NOTES['apart']}")
        worst = 0
        for scene in scenes:
            options.scene = scene
            if len(scenes) == 1 and not options.json:
                return one(options)
            try:
                worst = max(worst, one(options))
            except ViscovibError as error:
                status = _BAD_FILE if isinstance(error, FileError) else _BAD_INPUT
                worst = max(worst, status)
                print(f"viscovib: {error}", file=sys.stderr)
                if options.json:
                    _print_json(options, status, error=str(error))
        return worst

    return action


def _print_json(options: argparse.Namespace, status: int, **found: Any) -> None:
    """Print a line with the result of a scene."""
    print(as_json({"scene": str(options.scene), "status": status, **found}))


def _run(options: argparse.Namespace) -> int:
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    if scene.groups["sweep"]:
        return run_sweep(options)
    result = _compute(options, scene)
    value = _value(result)
    table = options.out / f"{options.scene.stem}_{result.kind}.csv"
    tables = [table]
    result.to_csv(table)
    for i in range(1, len(result.switched) + 1):
        tables.append(options.out / f"{options.scene.stem}_{result.kind}_{i}.csv")
        result.to_csv(tables[-1], i)
    wanting = "spectrum" in scene.groups and result.spectrum is None
    if result.spectrum is not None:
        wanting = not result.spectrum.complete
    further = {
        "spectrum": (result.spectrum, result.spectrum_to_csv),
        "event": (result.events, result.events_to_csv),
        "free_decay": (result.decay, result.decay_to_csv),
        "shock_spectrum": (result.shock_spectrum, result.shock_spectrum_to_csv),
        "forces": (result.forces, result.forces_to_csv),
        "reactions": (result.reactions, result.reactions_to_csv),
        "peaks": (result.peaks, result.peaks_to_csv),
    }
    for name, (found, write) in further.items():
        if found is not None:
            tables.append(options.out / f"{options.scene.stem}_{name}.csv")
            write(tables[-1])
    pictures = _picture(options, result)
    status = 0 if value.complete and not wanting else _UNSOLVED
    if options.json:
        _print_json(options, status, **_summary_values(result), tables=tables, pictures=pictures)
    elif not options.quiet:
        print(f"{one_line(str(table))}: " + value.summary().replace("\n", "\n  "))
        if wanting and result.spectrum is not None:
            print("spectrum: " + result.spectrum.summary().replace("\n", "\n  "))
    elif status:
        shown_text = result.spectrum if value.complete and result.spectrum is not None else value
        summary = shown_text.summary().splitlines()[0]
        print(f"warning: {one_line(str(table))}: {summary}", file=sys.stderr)
    return status


def _value(result: SceneResult) -> Result:
    return result._single("run: must be a single result, not a sweep")


def _summary_values(result: SceneResult) -> dict[str, Any]:
    """Return the JSON form of a result."""
    value = _value(result)
    try:
        numbers = {
            name: {"value": number.value, "unit": number.unit}
            for name, number in value.numbers().items()
        }
    except InputError:
        # This kind of result has no summary.
        numbers = {}
    return {
        "kind": result.kind,
        "complete": bool(value.complete),
        "summary": value.summary(),
        "numbers": numbers,
    }


def _plan(options: argparse.Namespace) -> int:
    planned = plan(Scene.read(options.scene, allow_paths=options.allow_paths))
    if options.json:
        _print_json(options, 0, computes=planned.computes, skips=dict(planned.skips))
        return 0
    if len(options.scenes) > 1:
        print(f"{one_line(str(options.scene))}:")
    print(planned)
    return 0


def _plot(options: argparse.Namespace) -> int:
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    if scene.groups["sweep"]:
        return run_sweep(options)
    pictures = _picture(options, _compute(options, scene))
    if options.json:
        _print_json(options, 0, pictures=pictures)
    return 0


def _complete(options: argparse.Namespace) -> int:
    print(script(options.shell, _parser()), end="")
    return 0


#: Subcommands: name, function, description.
_COMMANDS: tuple[tuple[str, Callable[[argparse.Namespace], int], str], ...] = (
    ("run", _each(_run), "compute scenes and write their tables and figures"),
    ("plan", _each(_plan), "print what scenes compute and what is skipped, and why"),
    ("plot", _each(_plot), "compute scenes and write their figures only"),
    ("sweep", _each(run_sweep), "compute a scene over a grid; an interrupted sweep continues"),
    (
        "explore",
        explore_command.run_explore,
        "open a scene in the browser, with a slider for each number",
    ),
    ("bench", _each(bench.run_bench), "measure times and errors of scenes on this machine"),
    ("completion", _complete, "print the completion script of a shell"),
)


def _compute(options: argparse.Namespace, scene: Scene) -> SceneResult:
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{options.out}: cannot be made a folder ({error.strerror})") from None
    with limited_seconds(options.max_seconds, partial=True):
        shown = sys.stderr.isatty() and not options.quiet and not options.json
        with counted_pieces(shown):
            return run(scene, progress=shown)


def _picture(options: argparse.Namespace, result: SceneResult) -> list[Path]:
    value = _value(result)
    further = (result.spectrum, result.shock_spectrum)
    pictures: list[Result] = [value, *(one for one in further if one is not None)]
    bases = value._base_frequencies()
    # Additional tables are not separate curves.
    curves: Any = () if value._form == "table" else result.switched
    paths = []
    for shown in pictures:
        kind = shown.kind.replace("shock_response", "shock")
        path = options.out / f"{options.scene.stem}_{kind}.png"
        save_picture(shown, path, bases=bases, switched=curves, title=result.scene.title)
        paths.append(path)
        if not options.quiet and not options.json:
            print(one_line(str(path)))
    return paths


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"warning: {message}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
