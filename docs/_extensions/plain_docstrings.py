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


def _escape(app, what, name, obj, options, lines):
    lines[:] = [escaped(line) for line in lines]


def setup(app):
    """Sphinx calls this; before the sections of a docstring are read."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _escape, priority=100)
    return {"version": "1", "parallel_read_safe": True}
