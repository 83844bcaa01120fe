#!/usr/bin/env python3
"""Run the first example of the README with the installed viscovib."""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Figures are drawn, not shown."""
    import matplotlib

    matplotlib.use("Agg")
    found = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    if found is None:
        sys.exit("first_example.py: README.md has no block of Python")
    exec(compile(found[1], "README.md", "exec"), {})
    import viscovib

    print(f"viscovib {viscovib.__version__} of {viscovib.__file__}")


if __name__ == "__main__":
    main()
