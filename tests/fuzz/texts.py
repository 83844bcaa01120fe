"""User texts in generated code, pages, tables and figures: quotes, line ends, markup.

Run by a worker. Code and pages with a random text must have the same structure as with a plain
word: the same syntax tree except for constants, and the same tags and attributes.
"""

import ast
import csv
import io
import random
import tempfile
import warnings
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import viscovib as vv
from verdicts import Case, Ending
from worker import Worker

#: Pieces of random texts.
PIECES = (
    "'", '"', "'''", '"""', "\\", "\\\\", "\n", "\r", "\t", "\0", "\x1b[2J", "\x7f", "\x9b",
    "\u2028", "\u202e", "<b>", "</pre>", "</h1>", "<script>alert(1)</script>", "<!--", "-->",
    "]]>", "&lt;", "&", "<img src=x onerror=alert(1)>", "' onmouseover='alert(1)", "javascript:",
    "$", "$$", "$\\frac{", "$$\\href{javascript:alert(1)}{x}$$", "\\(", "\\)", "\\[", "{", "}",
    "{0}", "{{ x }}", "{% x %}", "%s", "%(x)s", "`id`", "$(id)", ";", "|", "#", ",", "=", "!", "/",
    "&mount /", " /\n&load /", "\n/\n&scene title='x' /", "eval('1')", "__import__('os')", "\xe9",
    "x", "a b", "12:x", "_", "", " ", "\ud800", "\U0001f600", "\N{COMBINING ACUTE ACCENT}",
)  # fmt: skip
_SCENE = (
    "&scene title='{title}' /\n&system mass=1 stiffness=1 damping=0.1 coordinates='q' "
    "units='{unit}' /\n&load on='q' amplitude=0.1 /\n"
    "&response nu_from=0.5 nu_to=2 nu_count=5 method='linear' /\n"
)
_BODY = (
    "vv.Body(mass=10, inertia=(0.1, 0.1, 0.1), mounts=[vv.MountPoint(name='foot', "
    "position=(0, 0, -0.1), stiffness=(1e5, 1e5, 2e5), rotational_stiffness=(1e3, 1e3, 1e3))])"
)
#: Tags and attributes that must not occur in a figure.
_ODD = {"script", "img", "b", "h1", "onmouseover", "onerror"}
_MADE: dict[str, Any] = {}


class Tags(HTMLParser):
    """The tags of a page with their attributes; for styles and sources only the names."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.found: list[tuple[str, ...]] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record a tag."""
        self.found.append((tag, *(name for name, _ in attrs)))

    def handle_comment(self, data: str) -> None:
        """Record a comment."""
        self.found.append(("comment", data))


def text_of(rng: random.Random) -> str:
    """A random text of a few pieces."""
    return "".join(rng.choice(PIECES) for _ in range(rng.choice([1, 1, 2, 3, 6])))


def shape_of(code: str) -> str:
    """The syntax tree of Python lines without the values of constants."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant):
            node.value = type(node.value).__name__
    return ast.dump(tree)


def scene_of(title: str = "plain", unit: str = "m", name: str = "scene.nml") -> vv.Scene:
    """A scene from a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        words = {"title": title.replace("'", "''"), "unit": unit.replace("'", "''")}
        path.write_text(_SCENE.format(**words), encoding="utf-8")
        return vv.Scene.read(path)


def in_python(text: str) -> str:
    """A title and a file name in the Python lines of the explorer."""
    from viscovib.explorer.state import State

    faults = []
    for scene, typed in ((_scene(title=text), True), (_scene(name=f"{text}.nml"), False)):
        if scene is None:
            continue
        state, plain = State(scene), State(scene_of())
        if typed:
            for one in (state, plain):
                one.read_text(one.scene_text())
        lines = state.python_lines()
        constants = [
            node.value for node in ast.walk(ast.parse(lines)) if isinstance(node, ast.Constant)
        ]
        wanted = state.scene_text() if typed else str(state.now.scene.path)
        if wanted not in constants:
            faults.append(f"lines lack {wanted!r}")
        if shape_of(lines) != shape_of(plain.python_lines()):
            faults.append(f"lines are other code: {lines!r}")
    return "; ".join(faults)


def _scene(**given: str) -> vv.Scene | None:
    try:
        return scene_of(**given)
    except (vv.ViscovibError, UnicodeError, OSError, ValueError):
        # Refused, or a file name that the system does not allow.
        return None


def in_page(text: str) -> str:
    """A title, a unit and a file name in the page of the explorer."""
    from bokeh.models.widgets.markups import Markup
    from viscovib.explorer.page import Page
    from viscovib.explorer.state import State

    def tags(scene: vv.Scene) -> list[tuple[str, ...]]:
        page = Page(State(scene))
        page.complain(text)
        marked = [model for model in page.view.references() if isinstance(model, Markup)]
        if not all(model.disable_math for model in marked):
            raise ValueError("the page draws formulas")
        return [tag for one in sorted(marked, key=lambda m: m.id) for tag in Tags(one.text).found]

    if "page" not in _MADE:
        _MADE["page"] = sorted(tags(scene_of()))
    for given in ({"title": text}, {"unit": text}, {"name": f"{text}.nml"}):
        scene = _scene(**given)
        if scene is not None and sorted(tags(scene)) != _MADE["page"]:
            return f"the page has other tags with {given}"
    return ""


def in_report(text: str) -> str:
    """The title of a report."""
    return _same_tags("report", text, lambda title: _written(vv.report, title))


def _written(report: Callable[..., None], title: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.html"
        if "body" not in _MADE:
            _MADE["body"] = eval(_BODY)
        report(_MADE["body"], path, title=title, hz=[1.0, 2.0])
        return path.read_text()


def _same_tags(kind: str, text: str, made: Callable[[str], str]) -> str:
    if kind not in _MADE:
        _MADE[kind] = Tags(made("plain")).found
    try:
        found = Tags(made(text)).found
    except (vv.ViscovibError, UnicodeError):
        return ""
    return "" if found == _MADE[kind] else f"the {kind} has other tags"


def in_notebook(text: str) -> str:
    """Names and units of a structure in notebook output, tables and figures."""
    try:
        structure = vv.Structure(
            mass=[1.0, 1.0], stiffness=[[2.0, -1.0], [-1.0, 2.0]], names=[text, "q"],
            units=[text, "m"], rayleigh=(0.01, 0.01),
        )  # fmt: skip
    except vv.InputError:
        return ""
    found = vv.forced_response(structure, [0.5, 1.5], load=[1.0, 0.0], method="linear")
    page = found._repr_html_()
    odd = {word for tag in Tags(page).found for word in tag} & _ODD
    if odd:
        return f"the notebook has {odd}"
    with tempfile.TemporaryDirectory() as folder:
        found.to_csv(Path(folder) / "a.csv")
        content = (Path(folder) / "a.csv").read_text()
        rows = list(csv.reader(line for line in io.StringIO(content) if not line.startswith("#")))
        again = vv.Structure(
            mass=[1.0, 1.0], stiffness=[[2.0, -1.0], [-1.0, 2.0]], names=structure.dof_names
        )
        again.write(Path(folder) / "a.npz")
        if vv.Structure.read(Path(folder) / "a.npz").dof_names != structure.dof_names:
            return "a file gives other names"
    if not any(cell.startswith(f"{text}_1_re") for cell in rows[0]):
        return f"the table has columns {rows[0]}"
    return "rows of other lengths" if len({len(row) for row in rows}) > 1 else ""


def in_namelist(text: str) -> str:
    """A title that is set: the scene returns the same title, or refuses it."""
    try:
        scene = scene_of().override({"scene.title": text})
    except vv.InputError:
        return ""
    plain = scene_of().override({"scene.title": "plain"})
    if scene.groups != plain.groups | {"scene": {"title": text}}:
        return f"the scene has the title {scene.groups['scene']!r}"
    return ""


def in_picture(text: str) -> str:
    """Titles and units in figures, which interpret formulas."""
    from viscovib.plots.pictures import save_picture

    for given in ({"title": text}, {"unit": text}):
        scene = _scene(**given)
        if scene is not None:
            with tempfile.TemporaryDirectory() as folder:
                save_picture(vv.run(scene).value, Path(folder) / "a.svg", title=scene.title)
    return ""


#: Destinations of user texts; fast ones occur more often.
PLACES = (
    *(in_python, in_namelist) * 6, *(in_notebook, in_picture, in_page) * 2, in_report,
)  # fmt: skip


def texts(seed: str) -> dict[str, Any]:
    """One text at one destination."""
    rng = random.Random(seed)
    place, text = rng.choice(PLACES), text_of(rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            fault = place(text)
        except vv.ViscovibError as error:
            return {"verdict": "refused with a line", "detail": str(error)}
        except Exception as error:
            what = f"{type(error).__name__}: {str(error)[:300]}"
            return {"verdict": "exception", "detail": f"{place.__name__}({text!r}): {what}"}
    detail = f"{place.__name__}({text!r}): {fault}"
    return {"verdict": "not the same" if fault else "done", "detail": detail}


class Texts:
    """The part that inserts texts into generated code and pages."""

    name = "texts"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)

    def case(self, rng: random.Random, seed: str) -> Case:
        """One text."""
        mark = f"{rng.getrandbits(64):x}"
        answer = self.worker.ask(job="texts", seed=mark, patience=15)
        ending = Ending(answer["verdict"], str(answer.get("detail", "")))
        how = f"python -c 'import texts; print(texts.texts(\"{mark}\"))'  in tests/fuzz"
        return Case(self.name, seed, ending, how, {"seed.txt": mark.encode()})


def parts(folder: Path, builds: list[str]) -> list[Any]:
    """Parts of the fuzzer in this module."""
    del builds
    return [Texts(folder / "texts")]
