"""Write a module of texts that Python has too: fill_notes.py NOTES MODULE."""

import runpy
import sys
from pathlib import Path

notes, module = map(Path, sys.argv[1:])
lines = [
    f"!> Texts of `{notes.name}` of the Python package.",
    f"module viscovib_{module.stem}",
    "  implicit none",
    "  private",
]
for name, note in runpy.run_path(str(notes))["NOTES"].items():
    parts = [note[i : i + 60].replace("'", "''") for i in range(0, len(note), 60)]
    parts = [part.replace("\n", "'//new_line('a')//'") for part in parts]
    lines.append(f"  character(len=*), parameter, public :: {name}_note = &")
    lines += [f"    {'//' if i else ''}'{part}' &" for i, part in enumerate(parts)]
    lines[-1] = lines[-1][:-2]
text = "\n".join([*lines, f"end module viscovib_{module.stem}", ""])
# A file that is the same keeps its time.
if not module.exists() or module.read_text(encoding="utf-8") != text:
    module.write_text(text, encoding="utf-8")
