"""Modules loaded by importing the package, and locations of public names."""

import ast
import fcntl
import json
import subprocess
import sys
from pathlib import Path

import pytest
import viscovib

SOURCE = Path(viscovib.__file__).read_text(encoding="utf-8")
ROOT = Path(__file__).parents[2]
HEAVY = ("scipy", "xarray", "pandas", "tqdm", "matplotlib", "zarr", "dask", "distributed")
MOUNT = "mass=1, inertia=1, offset=0.1, stiffness_x=1, stiffness_phi=1"


def loaded(code: str, among: tuple[str, ...]) -> list[str]:
    """Return the modules that a new interpreter has loaded after some code."""
    code = f"import sys\n{code}\nimport json\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = json.loads(done.stdout.splitlines()[-1])
    return [name for name in among if name in modules]


def test_import_loads_nothing_that_computes() -> None:
    assert loaded("import viscovib", ("numpy", *HEAVY)) == []


def test_version_is_reported_without_numpy() -> None:
    code = "from viscovib.__main__ import main\nmain(['--version'])"
    assert loaded(code, ("numpy", "argparse", *HEAVY)) == []
    command = [sys.executable, "-m", "viscovib", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"viscovib {viscovib.__version__}\n"


@pytest.mark.parametrize(
    "code",
    [
        "import viscovib\nfor name in viscovib.__all__: getattr(viscovib, name)",
        "import viscovib.cli.commands",
        f"import viscovib as vv\nmount = vv.Mount({MOUNT})\n"
        "vv.forced_response(mount, [0.5, 0.9], load=0.01)",
    ],
    ids=["every public name", "the command", "a response"],
)
def test_heavy_packages_wait_until_they_are_needed(code: str) -> None:
    assert loaded(code, HEAVY) == []


def test_table_says_what_the_imports_say() -> None:
    block = next(node for node in ast.parse(SOURCE).body if isinstance(node, ast.If))
    said = {
        name.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    assert said == {name: f"viscovib.{module}" for name, module in viscovib._MODULE.items()}
    assert set(viscovib.__all__) == set(said)
    for name in viscovib.__all__:
        assert getattr(viscovib, name).__name__ == name
        assert name in dir(viscovib)


def test_public_functions_do_not_share_a_name_with_a_module() -> None:
    modules = {path.stem for path in Path(viscovib.__file__).parent.iterdir()}
    assert modules & set(viscovib.__all__) == set()


def test_unknown_names_are_refused_as_everywhere() -> None:
    with pytest.raises(AttributeError, match="'viscovib' has no attribute 'Responze'"):
        viscovib.Responze  # noqa: B018
    assert viscovib.errors.InputError is viscovib.InputError


@pytest.mark.skipif(not (ROOT / ".venv/bin/ninja").exists(), reason="no checkout of ./run")
def test_builds_of_two_imports_wait_for_each_other() -> None:
    """A process that imports an outdated checkout waits for the build of another process."""
    with open(ROOT / "build" / "ninja.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command = [ROOT / "packaging" / "ninja", "--version"]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as second:
            with pytest.raises(subprocess.TimeoutExpired):
                second.wait(timeout=0.5)
            fcntl.flock(lock, fcntl.LOCK_UN)
            assert second.wait(timeout=60) == 0
