"""Tables of the keys of scenes, from the table that the reader of scenes uses."""

import runpy
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SPEC = ROOT / "fortran" / "spec"
HEAD = ["| key | default | meaning |", "| --- | --- | --- |"]


def read_groups() -> list[dict[str, Any]]:
    """Return the groups of scenes with their rows."""
    read = runpy.run_path(str(SPEC / "fill_scenes.py"))["read_groups"]
    return read(SPEC / "scenes.toml", ROOT / "python" / "viscovib" / "common" / "curve_options.py")


def _default(row: dict[str, Any]) -> str:
    default = row.get("otherwise", row.get("default", ""))
    if "otherwise" in row or default == "":
        return default or ("none" if "default" in row else "")
    return f"'{default}'" if isinstance(default, str) else f"{default:g}"


def _meaning(row: dict[str, Any], group: dict[str, Any]) -> str:
    allowed = row["must"].replace("must not be negative", "must be at least 0")[len("must be ") :]
    if "words" in row:
        words = [f"'{word}'" for word in row["words"]]
        allowed = " or ".join([", ".join(words[:-1]), words[-1]])
    unit = f" ({row['unit']})" if "unit" in row else ""
    sentences = [row["text"].rstrip(".") + unit + "."]
    if allowed:
        sentences.append(f"Allowed: {allowed}.")
    if "when" in row:
        sentences.append(f"Only: {row['when']}.")
    if row["systems"] != group["systems"]:
        systems = [f"`&{name}`" for name in row["systems"]]
        sentences.append(f"Of {', '.join(systems)}.")
    return " ".join(sentences)


def tables() -> dict[str, str]:
    """Return the table of each group as `keys_NAME`, and of the options of curves."""
    made, curve = {}, []
    for group in read_groups():
        if group["name"] == "parameters":
            continue
        own = []
        for row in group["rows"]:
            line = f"| `{row['name']}` | {_default(row)} | {_meaning(row, group)} |"
            if row.get("set") != "curve":
                own.append(line)
            elif line not in curve:
                curve.append(line)
        made[f"keys_{group['name']}"] = "\n".join([group["text"], "", *(HEAD if own else []), *own])
    made["keys_curve"] = "\n".join([*HEAD, *curve])
    return made
