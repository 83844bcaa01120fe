"""The command ``viscovib``, also as ``python -m viscovib``."""

import os
import sys
from contextlib import suppress


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return the exit status of the standalone driver."""
    try:
        status = _run(arguments)
        sys.stdout.flush()
    except OSError as error:
        if not isinstance(error, BrokenPipeError):
            why = error.strerror or error
            print(f"viscovib: standard output: cannot be written ({why})", file=sys.stderr)
        # Discard the rest of the output, or Python would try to write it again at exit.
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 3
    return status


def _run(arguments: list[str] | None) -> int:
    # Print the version without loading the other modules.
    if (sys.argv[1:] if arguments is None else arguments) == ["--version"]:
        from viscovib import __version__

        print(f"viscovib {__version__}")
        return 0
    from viscovib.cli.commands import main as run

    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
