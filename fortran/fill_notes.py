"""Write the module of lines above tables: fill_notes.py NOTES MODULE."""

import runpy
import sys
from pathlib import Path

notes, module = map(Path, sys.argv[1:])
lines = [
    "!> Lines above the columns of tables, from `python/viscovib/common/column_notes.py`.",
    "module viscovib_column_notes",
    "  implicit none",
    "  private",
]
for name, note in runpy.run_path(str(notes))["NOTES"].items():
    parts = [note[i : i + 60].replace("'", "''") for i in range(0, len(note), 60)]
    lines.append(f"  character(len=*), parameter, public :: {name}_note = &")
    lines += [f"    {'//' if i else ''}'{part}' &" for i, part in enumerate(parts)]
    lines[-1] = lines[-1][:-2]
text = "\n".join([*lines, "end module viscovib_column_notes", ""])
# A file that is the same keeps its time.
if not module.exists() or module.read_text(encoding="utf-8") != text:
    module.write_text(text, encoding="utf-8")
