"""Write the module of users' elements: list_elements.py TEMPLATE MODULE [ELEMENT.f90 ...]."""

import re
import sys
from pathlib import Path

template, module, *elements = map(Path, sys.argv[1:])
lines: dict[str, list[str]] = {"uses": [], "names": [], "odds": [], "faults": [], "makers": []}
for i, path in enumerate(elements, 1):
    name = path.stem
    if not re.fullmatch(r"[a-z]\w{0,39}", name) or path.suffix != ".f90":
        sys.exit(
            f"{path}: must be called NAME.f90, NAME being small letters, digits and _, at most 40"
        )
    if name in [other.stem for other in elements[: i - 1]]:
        sys.exit(f"{path}: another element is called {name}")
    text = re.sub(r"!.*", "", path.read_text(encoding="utf-8")).lower()
    of_module = (
        f"{name}_element",
        name,
        f"new_{name}",
        f"{name}_fault",
        f"{name}_odd",
        f"{name}_parameters",
    )
    if missing := [one for one in of_module if not re.search(rf"\b{one}\b", text)]:
        sys.exit(f"{path}: has no {missing[0]}; must have {', '.join(of_module)}")
    listed = f"type_{i} => {name}, new_{i} => new_{name}, fault_{i} => {name}_fault"
    lines["uses"] += [
        f"use {name}_element, only: {listed}, &",
        f"  parameters_{i} => {name}_parameters, odd_{i} => {name}_odd",
    ]
    lines["names"] += [f"case ({i})", f"  text = '{name} '//parameters_{i}"]
    lines["odds"] += [f"case ({i})", f"  odd = odd_{i}"]
    lines["faults"] += [f"case ({i})", f"  fault = fault_{i}(given)"]
    lines["makers"] += [
        f"case ({i})",
        "  block",
        f"    type(type_{i}) :: made",
        f"    call new_{i}(made, given)",
        "    allocate (element, source=made)",
        "  end block",
    ]
filled = template.read_text(encoding="utf-8").replace("@count@", str(len(elements)))
for place, found in lines.items():
    indent = {"uses": "  ", "names": "    ", "odds": "    "}.get(place, "      ")
    filled = filled.replace(f"@{place}@", "\n".join(indent + line for line in found))
filled = re.sub(r"\n{3,}", "\n\n", filled)
# A file that is the same keeps its time, or every configuration would compile all that uses it.
if not module.exists() or module.read_text(encoding="utf-8") != filled:
    module.write_text(filled, encoding="utf-8")
