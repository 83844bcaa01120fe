"""The command ``viscovib``, also as ``python -m viscovib``."""

import sys


def main(arguments: list[str] | None = None) -> int:
    """Run one command; the version alone is told without loading what computes."""
    if (sys.argv[1:] if arguments is None else arguments) == ["--version"]:
        from viscovib import __version__

        print(f"viscovib {__version__}")
        return 0
    from viscovib.cli.commands import main as run

    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
