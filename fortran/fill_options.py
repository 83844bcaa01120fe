"""Fill the options of curves into their module: fill_options.py TABLE TEMPLATE MODULE."""

import runpy
import sys
from pathlib import Path

table, template, module = map(Path, sys.argv[1:])
known = runpy.run_path(str(table))
lines: dict[str, list[str]] = {"table": [], "components": [], "values": [], "set": []}
for i, (name, option) in enumerate(known["OPTIONS"].items(), 1):
    whole = name in known["WHOLE"]
    bounds = (option.default or 0, option.lowest, option.highest)
    numbers = [f"{float(one)!r}_wp" for one in bounds]
    comma = ", &" if i < len(known["OPTIONS"]) else " &"
    flag = ".true." if whole else ".false."
    lines["table"].append(f"option_type('{name}', {', '.join(numbers)}, {flag}){comma}")
    kind, default = ("integer", option.default) if whole else ("real(wp)", numbers[0])
    lines["components"].append(f"{kind} :: {name} = {default}")
    lines["values"].append(f"values({i}) = {f'real(self%{name}, wp)' if whole else f'self%{name}'}")
    lines["set"].append(f"self%{name} = {f'nint(values({i}))' if whole else f'values({i})'}")
text = template.read_text(encoding="utf-8")
for place, filled in lines.items():
    text = text.replace(f"@{place}@", "\n".join(f"    {line}" for line in filled))
# A file that is the same keeps its time, or every configuration would compile all that uses it.
if not module.exists() or module.read_text(encoding="utf-8") != text:
    module.write_text(text, encoding="utf-8")
