"""Call the library with wrong arguments: each call must return an error message.

`test_library.py` runs this program in a separate process, because a crash would end it.
"""

import ctypes
import itertools
import sys

library = ctypes.CDLL(sys.argv[1])
for name in (
    "message", "version", "summary", "warnings", "table_name", "table_notes", "column_name", "word",
):  # fmt: skip
    getattr(library, f"viscovib_{name}").restype = ctypes.c_char_p
library.viscovib_column.restype = ctypes.c_void_p

NAN, INF = float("nan"), float("inf")
TEXTS = (
    None, b"", b" ", b"modes", b"x" * 100_000, b"\xff\xfe", b"'", b'"', b"/", b"&", b"&mount",
    b"\n", b"!", b"nu = nan", b"dt = 1e999", b"initial = 400*1", b"keep = 'none'",
    b"/ &load amplitude=1 /",
    b"'" * 5001, b"a%b$c", b"=" * 300, b"mass = 1, mass = 2", b"%s%n",
)  # fmt: skip
COUNTS = (-(2**31), -1, 0, 1, 2, 3, 65, 2**31 - 1)
NUMBERS = (NAN, INF, -INF, 1e308, -1.0, 5e-324, 0.0, 1.0)
SYSTEM = b"&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /\n"
LOADED = SYSTEM + b"&load amplitude=0.1 /\n"


def doubles(*values):
    return (ctypes.c_double * 64)(*itertools.islice(itertools.cycle(values), 64))


ARRAYS = (None, *(doubles(one) for one in NUMBERS), doubles(2.0, -1.0, -1.0, 2.0))
calls = 0


def call(function, *arguments, makes=True):
    """Make a call; return the handle, if it created one."""
    global calls
    calls += 1
    handle = ctypes.c_void_p(1)
    passed = [ctypes.c_double(a) if isinstance(a, float) else a for a in arguments]
    if makes:
        # First without a pointer for the handle.
        assert function(*passed, None) == 2, (function.__name__, arguments)
        passed.append(ctypes.byref(handle))
    status = function(*passed)
    where = (function.__name__, arguments, status)
    assert status in (0, 2, 3), where
    if status:
        message = library.viscovib_message()
        assert message, where
        assert b"\n" not in message, where
        assert len(message) < 2000, where
    assert not makes or bool(handle) == (status == 0), where
    return handle if makes and handle else None


def look(result):
    """Read all values of a result, or of a null pointer, with invalid indices."""
    for ask in ("summary", "warnings", "complete", "tables"):
        getattr(library, f"viscovib_{ask}")(result)
    for i in (-1, 0, 1, 2**31 - 1, -(2**31)):
        for ask in ("table_name", "table_notes", "rows", "columns"):
            getattr(library, f"viscovib_{ask}")(result, i)
        for text in TEXTS:
            library.viscovib_find_column(result, i, text)
        for j in (-1, 0, 1, 2**31 - 1):
            library.viscovib_column_name(result, i, j)
            library.viscovib_column(result, i, j)
            for k in (-1, 0, 2**31 - 1):
                library.viscovib_word(result, i, j, k)
    library.viscovib_result_free(result)


def main():
    assert library.viscovib_message() == b""
    look(None)
    library.viscovib_system_free(None)
    for n, mass, damping, stiffness in itertools.product(COUNTS, ARRAYS, ARRAYS[:2], ARRAYS):
        library.viscovib_system_free(call(library.viscovib_system_new, n, mass, damping, stiffness))
    for text in TEXTS:
        library.viscovib_system_free(call(library.viscovib_system_read, text))
        look(call(library.viscovib_run, text))
    for text in (None, SYSTEM, LOADED):
        system = call(library.viscovib_system_read, text)
        for group, keys in itertools.product((None, b"", b"load", b"kernel", b"mount"), TEXTS):
            call(library.viscovib_system_add, system, group, keys, makes=False)
        for group, keys in itertools.product((None, b"", b"modes", b"response", *TEXTS), TEXTS):
            look(call(library.viscovib_analyse, system, group, keys))
        for array, kernel in itertools.product(ARRAYS, COUNTS):
            call(library.viscovib_system_add_spring, system, array, kernel, makes=False)
        library.viscovib_system_free(system)
        system = call(library.viscovib_system_read, text)
        for method, n, nu in itertools.product((None, b"linear", b"newton"), COUNTS[:6], ARRAYS):
            look(call(library.viscovib_response, system, method, n, nu, None))
        look(call(library.viscovib_response, system, b"linear", 2**31 - 1, ARRAYS[1], None))
        for keys in TEXTS:
            look(call(library.viscovib_response, system, b"linear", 1, ARRAYS[-1], keys))
            look(call(library.viscovib_motion, system, 1.0, 0.25, None, keys))
        for a, b in itertools.product((NAN, INF, -1.0, 0.0, 5e-324), NUMBERS[:4]):
            look(call(library.viscovib_branch, system, a, b, None))
        for nu, t_end in itertools.product((NAN, INF, -INF, -1.0, 1.0), (NAN, INF, -1.0, 0.0)):
            look(call(library.viscovib_motion, system, nu, t_end, None, None))
        for initial in ARRAYS:
            look(call(library.viscovib_motion, system, 1.0, 0.25, initial, b"dt = 0.125"))
        library.viscovib_system_free(system)
    for n, window in itertools.product(COUNTS, (-1, 0, 1, 2, 5, 2**31 - 1)):
        for signal, x, y in itertools.product(ARRAYS, ARRAYS[:1] + (doubles(0.0),), ARRAYS[-1:]):
            if n < 65 or n > 10**9:
                call(library.viscovib_spectrum, n, signal, window, x, y, makes=False)
    print(calls)


main()
