"""The library as used by other programs: installed, then linked from C, Fortran and CMake."""

import ctypes
import fcntl
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
#: Build folder of the driver under test.
BUILD = Path(
    os.environ.get("VISCOVIB_SOLVE", ROOT / "build/release/fortran/viscovib-solve")
).parents[1]
PRINTED = re.search(
    r"It prints\n\n```\n(.*?)```", (ROOT / "docs/howto/c.md").read_text(), re.DOTALL
)[1]


def call(*command, **environment):
    """Run a program; return its output."""
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        env=os.environ | environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """Return the installation folder of the library, and the environment to use it."""
    root = tmp_path_factory.mktemp("installed")
    wanted = ("--no-rebuild", "--tags", "library,devel", "--destdir", root)
    # Meson allows one process per build folder; tests may run in several processes.
    with (tmp_path_factory.getbasetemp().parent / "installing").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        call("meson", "install", "-C", BUILD, *wanted)
    (pc,) = root.rglob("viscovib.pc")
    return {
        "root": root,
        "lib": pc.parent.parent,
        "environment": {
            "PKG_CONFIG_PATH": str(pc.parent),
            "PKG_CONFIG_SYSROOT_DIR": str(root),
            "LD_LIBRARY_PATH": str(pc.parent.parent),
        },
    }


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return a program with few calls."""
    path = tmp_path_factory.mktemp("small") / "small.c"
    path.write_text(
        """#include <stdio.h>
#include <viscovib.h>
int main(void) {
  double one = 1.0, two = 2.25;
  viscovib_system *system;
  viscovib_result *result;
  if (viscovib_system_new(1, &one, NULL, &two, &system) != VISCOVIB_OK) return 1;
  if (viscovib_analyse(system, "modes", NULL, &result) != VISCOVIB_OK) return 1;
  printf("%g", *viscovib_column(result, 0, viscovib_find_column(result, 0, "omega")));
  return 0;
}
"""
    )
    return path


def flags(prefix, *options):
    words = call("pkg-config", *options, "--cflags", "--libs", "viscovib", **prefix["environment"])
    # System libraries are not in this folder.
    root = prefix["root"]
    return [word for word in words.split() if word != f"-I{root}/usr/include"]


def test_a_program_in_c_gets_what_the_page_says(prefix, tmp_path):
    strict = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")
    call("gcc", *strict, ROOT / "examples/mount.c", *flags(prefix), "-lm", "-o", tmp_path / "mount")
    assert call(tmp_path / "mount", **prefix["environment"]) == PRINTED


def test_the_static_library_is_whole(prefix, small, tmp_path):
    archive = prefix["lib"] / "libviscovib.a"
    assert archive.read_bytes()[:8] == b"!<arch>\n"
    words = [
        word for word in flags(prefix, "--static") if not word.startswith(("-lviscovib", "-L"))
    ]
    call("gcc", small, archive, *words, "-lm", "-o", tmp_path / "small")
    assert call(tmp_path / "small") == "1.5"


def test_a_program_in_fortran_gets_what_the_page_says(prefix, tmp_path):
    call("gfortran", ROOT / "examples/first_response.f90", *flags(prefix), "-o", tmp_path / "first")
    said = call(tmp_path / "first", **prefix["environment"])
    assert said.strip() in (ROOT / "docs/howto/fortran.md").read_text()
    assert said.startswith("largest amplitude")


def test_cmake_finds_it(prefix, small, tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("no cmake")
    lines = [
        "cmake_minimum_required(VERSION 3.16)",
        "project(user C)",
        "find_package(viscovib 0.1.0 REQUIRED)",
        f"add_executable(user {small})",
        "target_link_libraries(user viscovib::viscovib)",
    ]
    (tmp_path / "CMakeLists.txt").write_text("\n".join(lines))
    config = f"-Dviscovib_DIR={prefix['lib']}/cmake/viscovib"
    call("cmake", "-S", tmp_path, "-B", tmp_path / "build", config)
    call("cmake", "--build", tmp_path / "build")
    assert call(tmp_path / "build/user", **prefix["environment"]) == "1.5"


def test_the_manifest_of_fpm_has_every_source(prefix):
    (manifest,) = prefix["root"].rglob("fpm.toml")
    here = {path.name for path in (manifest.parent / "src").iterdir()}
    folders = [path for path in (ROOT / "fortran").iterdir() if path.is_dir()]
    wanted = {
        path.name.removesuffix(".in")
        for folder in folders
        for path in folder.iterdir()
        if folder.name != "app" and path.suffix in (".f90", ".in", ".c")
        if not path.name.endswith("_binding.f90")
    }
    # Only the selected Fourier transforms.
    assert wanted - here <= {"fft_own.c", "fft_fftw.c"}
    # A user-defined element, built for the tests, and what the build makes from texts of Python.
    assert here - wanted <= {"ratchet.f90", "column_notes.f90", "help_texts.f90"}
    assert len(wanted - here) == 1


@pytest.fixture(scope="module")
def library(prefix):
    """Return the shared library for calls through ctypes."""
    opened = ctypes.CDLL(str(prefix["lib"] / "libviscovib.so"))
    for name in ("message", "version", "summary", "word", "column_name", "table_name"):
        getattr(opened, f"viscovib_{name}").restype = ctypes.c_char_p
    opened.viscovib_column.restype = ctypes.POINTER(ctypes.c_double)
    return opened


def table(library, result, which=0):
    """Return columns by name."""
    rows = library.viscovib_rows(result, which)
    names = [
        library.viscovib_column_name(result, which, j).decode()
        for j in range(library.viscovib_columns(result, which))
    ]
    return {
        name: np.array(library.viscovib_column(result, which, j)[:rows])
        for j, name in enumerate(names)
    }


def handle_of(library, call, *arguments):
    """Return the handle created by a call, which must succeed."""
    handle = ctypes.c_void_p()
    status = call(*arguments, ctypes.byref(handle))
    assert status == 0, library.viscovib_message()
    return handle


def numbers(*values):
    return (ctypes.c_double * len(values))(*values)


def test_linear_responses_solve_their_equations(library):
    """(K - nu^2 M + i nu C) X = P, solved by NumPy."""
    m, c, k = np.diag([1.0, 2.5]), np.diag([0.3, 0.1]), np.array([[7.0, -2.0], [-2.0, 3.0]])
    system = handle_of(
        library,
        library.viscovib_system_new,
        2,
        *(numbers(*matrix.ravel()) for matrix in (m, c, k)),
    )
    assert library.viscovib_system_add(system, b"load", b"on = 'x2', amplitude = 0.7") == 0
    nu = [0.3, 1.1 / 3, 2.0]
    result = handle_of(library, library.viscovib_response, system, b"linear", 3, numbers(*nu), None)
    library.viscovib_system_free(system)
    columns = table(library, result)
    assert columns["nu"].tolist() == nu
    for i, one in enumerate(nu):
        x = np.linalg.solve(k - one**2 * m + 1j * one * c, [0.0, 0.7])
        found = [columns[f"x{d}_1_re"][i] + 1j * columns[f"x{d}_1_im"][i] for d in (1, 2)]
        np.testing.assert_allclose(found, x, rtol=1e-12)
    column = library.viscovib_find_column(result, 0, b"outcome")
    assert library.viscovib_word(result, 0, column, 2) == b"converged"
    assert library.viscovib_word(result, 0, column, 3) is None
    assert library.viscovib_word(result, 0, 0, 0) is None
    assert library.viscovib_find_column(result, 0, b"x3_1_re") == -1
    assert not library.viscovib_column(result, 0, len(columns))
    assert library.viscovib_rows(result, 1) == 0
    library.viscovib_result_free(result)


MOUNT = b"""&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /
&kernel kind='rzhanitsyn', amplitude=0.048, alpha=0.1, beta=0.05 /
&load amplitude=0.1 /"""


@pytest.mark.parametrize(
    ("name", "keys", "made"),
    [
        ("branch", "nu_from = 2, nu_to = 4", lambda c, s: (c.viscovib_branch, s, 2.0, 4.0, None)),
        (
            "response",
            "nu = 2.5 3, method = 'newton', stability = 'yes'",
            lambda c, s: (
                c.viscovib_response,
                s,
                b"newton",
                2,
                numbers(2.5, 3.0),
                b"stability = 'yes'",
            ),
        ),
        (
            "transient",
            "nu = 3, t_end = 7, initial = 0.1 0 0 0.2, dt = 0.125",
            lambda c, s: (
                c.viscovib_motion,
                s,
                3.0,
                7.0,
                numbers(0.1, 0.0, 0.0, 0.2),
                b"dt = 0.125",
            ),
        ),
        ("modes", "", lambda c, s: (c.viscovib_analyse, s, b"modes", None)),
        (
            "characteristic_roots",
            "",
            lambda c, s: (c.viscovib_analyse, s, b"characteristic_roots", None),
        ),
    ],
)
def test_calls_give_the_tables_of_scenes(library, solve, tmp_path, name, keys, made):
    (tmp_path / "scene.nml").write_bytes(MOUNT + f"\n&{name} {keys} /\n".encode())
    done = solve(tmp_path / "scene.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / f"scene_{name}.csv").read_text()
    names, *rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    system = handle_of(library, library.viscovib_system_read, MOUNT)
    function, *arguments = made(library, system)
    function.argtypes = None
    arguments = [ctypes.c_double(one) if isinstance(one, float) else one for one in arguments]
    result = handle_of(library, function, *arguments)
    columns = table(library, result)
    assert list(columns) == names
    assert library.viscovib_table_name(result, 0).decode() == name
    for j, one in enumerate(names):
        for i, row in enumerate(rows):
            word = library.viscovib_word(result, 0, j, i)
            if word is None:
                np.testing.assert_equal(columns[one][i], float(row[j]))
            else:
                assert word.decode() == row[j]
    library.viscovib_result_free(result)
    library.viscovib_system_free(system)


def test_shocks_of_a_system_move_it_as_in_a_scene(library):
    body = b"&system coordinates='x' mass=2 stiffness=50 damping=1 base_direction=1 /\n"
    keys = b"kind='acceleration' shape='half_sine' amplitude=3 duration=0.1 unit='g'"
    system = handle_of(library, library.viscovib_system_read, body)
    assert library.viscovib_system_add(system, b"load", keys) == 0
    library.viscovib_motion.argtypes = None
    zero, end = ctypes.c_double(0.0), ctypes.c_double(1.0)
    wanted = b"dt=0.01 peaks='yes'"
    moved = handle_of(library, library.viscovib_motion, system, zero, end, None, wanted)
    scene = body + b"&load " + keys + b" /\n&transient t_end=1 " + wanted + b" /\n"
    scene += b"&shock_spectrum frequencies=1 5 20 /\n"
    whole = handle_of(library, library.viscovib_run, scene)
    one, other = table(library, moved), table(library, whole)
    assert np.abs(one["x"]).max() > 0.1
    assert all(np.array_equal(one[name], other[name]) for name in ("t", "x", "x_dot"))
    one, other = table(library, moved, 1), table(library, whole, 1)
    assert np.array_equal(one["value"], other["value"])
    names = [library.viscovib_table_name(whole, i).decode() for i in (1, 2)]
    assert names == ["peaks", "shock_spectrum"]
    library.viscovib_result_free(moved)
    library.viscovib_result_free(whole)
    library.viscovib_system_free(system)


def test_mistakes_are_reported_and_change_nothing(library):
    system = handle_of(library, library.viscovib_system_read, MOUNT)
    handle = ctypes.byref(ctypes.c_void_p())
    wrong = {
        "order = -1": lambda: library.viscovib_system_add(
            system, b"load", b"amplitude = 1, order = -1"
        ),
        "unknown group &bananas": lambda: library.viscovib_system_add(system, b"bananas", b""),
        "method": lambda: library.viscovib_response(
            system, b"magic", 1, numbers(1.0), None, handle
        ),
        "nu: must be one or more": lambda: library.viscovib_response(
            system, b"linear", 0, numbers(1.0), None, handle
        ),
        "mass": lambda: library.viscovib_system_new(1, numbers(-1.0), None, numbers(1.0), handle),
        "n = 65": lambda: library.viscovib_system_new(65, None, None, None, handle),
        "must not be NULL": lambda: library.viscovib_system_new(1, None, None, None, handle),
        "system: is NULL": lambda: library.viscovib_analyse(None, b"modes", None, handle),
        "window = 9": lambda: library.viscovib_spectrum(
            2, numbers(1.0, 2.0), 9, numbers(0.0, 0.0), numbers(0.0, 0.0)
        ),
        "stiffness": lambda: library.viscovib_system_add_spring(system, None, 0),
        "nan": lambda: library.viscovib_system_new(
            1, numbers(1.0), None, numbers(float("nan")), handle
        ),
    }
    for said, mistake in wrong.items():
        assert mistake() == 2
        message = library.viscovib_message().decode()
        assert said in message
        assert not message.startswith("call")
        assert "\n" not in message
    assert (
        table(library, handle_of(library, library.viscovib_analyse, system, b"modes", None))["mode"]
        is not None
    )


def test_misuse_never_crashes(prefix):
    """Null pointers, invalid counts, NaN, invalid texts."""
    program = Path(__file__).with_name("library_misuse.py")
    shared = prefix["lib"] / "libviscovib.so"
    done = subprocess.run(
        [sys.executable, program, shared], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) > 2000


@pytest.mark.parametrize("point", [",", "\u066b", "."])
def test_a_comma_of_the_locale_is_no_point(tmp_path, point):
    """A program that sets its locale gets the same numbers."""
    (tmp_path / "locale.c").write_text(
        f"""#include <stdio.h>
#include <string.h>
/* As printf writes where the point is another sign. */
static int local(char *text, size_t room, const char *form, double value) {{
  char plain[40], *dot;
  snprintf(plain, sizeof plain, form, value);
  dot = strchr(plain, '.');
  if (dot) *dot++ = 0;
  return snprintf(text, room, dot ? "%s{point}%s" : "%s%s", plain, dot ? dot : "");
}}
#define snprintf local
#include "{ROOT}/fortran/base/number_text.c"
"""
    )
    call("gcc", "-shared", "-fPIC", tmp_path / "locale.c", "-o", tmp_path / "locale.so")
    opened = ctypes.CDLL(str(tmp_path / "locale.so"))
    for value in (1.5, -0.1, 1e300, -5e-324, 0.0, float("inf"), float("nan")):
        text, length = ctypes.create_string_buffer(40), ctypes.c_int()
        opened.viscovib_format(ctypes.c_double(value), text, ctypes.byref(length))
        assert text.value[: length.value].decode() == f"{value:.16e}"


def test_spectra_of_a_tone(library):
    n = 64
    signal = 0.5 + 0.25 * np.cos(2 * np.pi * 5 * np.arange(n) / n + 0.3)
    x, y = numbers(*[0.0] * (n // 2 + 1)), numbers(*[0.0] * (n // 2 + 1))
    assert library.viscovib_spectrum(n, numbers(*signal), 2, x, y) == 0
    amplitudes = np.array(x) + 1j * np.array(y)
    assert amplitudes[0] == pytest.approx(0.5, abs=1e-13)
    assert amplitudes[5] == pytest.approx(0.25 * np.exp(0.3j), abs=1e-13)


def test_header_and_library_are_of_one_version(prefix, library):
    header = (prefix["root"] / "usr/local/include/viscovib.h").read_text()
    (header_version,) = re.findall(r'VISCOVIB_VERSION "(.*)"', header)
    (interface,) = re.findall(r"VISCOVIB_INTERFACE (\d+)", header)
    assert library.viscovib_version().decode() == header_version
    assert library.viscovib_interface() == int(interface)
    declared = set(re.findall(r"\b(viscovib_\w+)\(", header))
    page = (ROOT / "docs/reference/c.md").read_text()
    for name in declared:
        assert hasattr(library, name)
        assert f"{name}(" in page or f"`{name}`" in page
