#!/usr/bin/env python3
"""Copy the module files of the library where programs look for them: BUILD_DIR INCLUDE_DIR."""

import os
import shutil
import sys
from pathlib import Path


def main() -> None:
    """Copy those of the library; other targets of the folder have none of its names."""
    here, there = sys.argv[1:]
    target = Path(os.environ["MESON_INSTALL_DESTDIR_PREFIX"]) / there
    target.mkdir(parents=True, exist_ok=True)
    modules = [path for path in Path(here).glob("libviscovib*.p/*.*mod") if path.is_file()]
    if not modules:
        sys.exit(f"install_modules.py: no module files in {here}")
    for path in modules:
        shutil.copy2(path, target)


if __name__ == "__main__":
    main()
