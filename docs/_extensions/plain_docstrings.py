"""Docstrings hold formulas as a program writes them: here `|x|` and `a * b` keep their signs."""

import re

# Text in double or single backquotes stands as it is.
CODE = re.compile(r"(``.*?``|`[^`]*`)")


def escaped(line):
    """The line with bars and stars escaped outside of code."""
    if line.lstrip().startswith((">>>", "...", "..")):
        return line
    parts = CODE.split(line)
    parts[::2] = [re.sub(r"(?<!\\)([|*])", r"\\\1", part) for part in parts[::2]]
    return "".join(parts)


SECTION = re.compile(
    r" +(Parameters|Returns|Raises|Warns|Notes|Examples|Yields|Attributes|See Also)$"
)


def flattened(lines):
    """Lines without the indents of sections, where a function is documented per kind of system."""
    if not any(SECTION.match(line) for line in lines):
        return lines
    flat = []
    for line in lines:
        if line and not line.startswith(" "):
            flat += ["", f"**{line.replace('*', '')}**" if line.startswith("For ") else line, ""]
        else:
            flat.append(line[4:])
    return flat


def _escape(app, what, name, obj, options, lines):
    lines[:] = [line if line.startswith("**") else escaped(line) for line in flattened(lines)]


def setup(app):
    """Sphinx calls this; before the sections of a docstring are read."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _escape, priority=100)
    return {"version": "1", "parallel_read_safe": True}
