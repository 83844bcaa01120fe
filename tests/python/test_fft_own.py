"""The built-in Fourier transforms (-Dfft=own), compiled here from their source, against NumPy."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

SOURCE = Path(__file__).parents[2] / "fortran" / "numerics" / "fft_own.c"
#: Error relative to the rms: some ulp for each doubling of the length.
BOUND = 4e-16

#: Lengths of one line: all small lengths, primes around the start of convolutions, products of two
#: primes, powers of each radix, and lengths of records.
LENGTHS = [
    *range(1, 201),
    211, 251, 509, 1009, 2003, 4999, 10007, 53 * 59, 61 * 67, 2 * 61, 4 * 67, 2 * 10007,
    *(2**k for k in range(8, 17)),
    *(3**k for k in range(5, 10)),
    *(5**k for k in range(4, 7)),
    *(7**k for k in range(3, 6)),
    11**3, 13**3, 31**2, 61**2, 67**2, 1000, 2310, 30030, 44100, 65535, 99991,
]  # fmt: skip


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler")
    made = tmp_path_factory.mktemp("fft") / "fft_own.so"
    subprocess.run(
        [compiler, "-O2", "-shared", "-fPIC", str(SOURCE), "-o", str(made), "-lm"], check=True
    )
    library = ctypes.CDLL(str(made))
    for name in ("line", "box", "box_back"):
        getattr(library, f"viscovib_plan_{name}").restype = ctypes.c_void_p
    return library


def forward(own, u):
    """Transform u of shape (n,) or (n_1, n_2, n_3): c of k = 0 ... n/2 along the last axis."""
    u = np.array(u, dtype=float)
    c = np.full((*u.shape[:-1], u.shape[-1] // 2 + 1), np.nan, dtype=complex)
    if u.ndim == 1:
        plan = ctypes.c_void_p(own.viscovib_plan_line(u.size, None, None))
    else:
        plan = ctypes.c_void_p(own.viscovib_plan_box(*u.shape, None, None))
    before = u.copy()
    for _ in range(2):  # A plan may be used repeatedly.
        own.viscovib_transform(plan, ctypes.c_void_p(u.ctypes.data), ctypes.c_void_p(c.ctypes.data))
    own.viscovib_free_plan(plan)
    np.testing.assert_array_equal(u, before)
    return c


def back(own, c, shape):
    c, u = np.array(c, dtype=complex), np.full(shape, np.nan)
    plan = ctypes.c_void_p(own.viscovib_plan_box_back(*shape, None, None))
    data = ctypes.c_void_p(c.ctypes.data), ctypes.c_void_p(u.ctypes.data)
    own.viscovib_transform_back(plan, *data)
    own.viscovib_free_plan(plan)
    return u


def away(found, true):
    """Error divided by the rms of the true values and log2 of their number."""
    size = np.sqrt(np.mean(np.abs(true) ** 2))
    return np.abs(found - true).max() / size / max(np.log2(true.size), 1)


def test_lines_of_all_lengths(own):
    rng = np.random.default_rng(1)
    for n in LENGTHS:
        u = rng.standard_normal(n)
        true = np.fft.rfft(u)
        assert away(forward(own, u), true) < 4 * BOUND, n
        # Backward: n u, independent of the imaginary parts that a real signal does not have.
        true[0] += 3j
        if n % 2 == 0:
            true[-1] -= 2j
        assert away(back(own, true, (1, 1, n)).ravel() / n, u) < 4 * BOUND, n


def test_one_sample_and_one_wave_of_a_line(own):
    """Transforms in closed form to the last bits: errors are not spread over all values."""
    for n in (1, 2, 3, 4, 7, 12, 67, 101, 128, 134, 360, 1009):
        k = np.arange(n // 2 + 1)
        for j in (0, 1 % n, n // 2, n - 1):
            u = np.zeros(n)
            u[j] = 1
            turns = j * k % n / n
            assert np.abs(forward(own, u) - np.exp(-2j * np.pi * turns)).max() < 8 * BOUND, n
        for m in sorted({0, min(1, n // 2), n // 2}):
            u = np.cos(2 * np.pi * (m * np.arange(n) % n) / n)
            line = np.zeros(n // 2 + 1)
            line[m] = n if m == 0 or 2 * m == n else n / 2
            assert np.abs(forward(own, u) - line).max() < 4 * BOUND * n, n


SHAPES = [
    (1, 1, 8), (1, 2, 8), (2, 1, 8), (1, 5, 9), (7, 1, 6), (3, 4, 5), (4, 3, 2), (16, 16, 16),
    (5, 9, 15), (9, 27, 3), (6, 67, 4), (67, 2, 6), (71, 3, 10), (2, 2, 67), (3, 5, 142),
    (8, 12, 18), (11, 13, 14), (31, 37, 2), (1, 64, 1), (64, 1, 1), (6, 10, 1), (2, 3, 1009),
]  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
def test_boxes(own, shape):
    """Complex transforms along the first axes, with long primes that use convolutions."""
    rng = np.random.default_rng(shape)
    u = rng.standard_normal(shape)
    true = np.fft.rfftn(u)
    assert away(forward(own, u), true) < 4 * BOUND
    assert away(back(own, true, shape) / u.size, u) < 4 * BOUND


def test_sizes_of_numbers(own):
    """Small and large signals keep their relative accuracy; NaN affects its whole line."""
    u = np.random.default_rng(2).standard_normal(134)
    for size in (1e-290, 1e290):
        assert away(forward(own, size * u) / size, np.fft.rfft(u)) < 4 * BOUND
    u[5] = np.nan
    assert np.isnan(forward(own, u)).all()
