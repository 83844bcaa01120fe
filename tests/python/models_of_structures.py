"""Finite-element models for tests: the plate of the examples, and files of matrices."""

import importlib.util
from pathlib import Path

from scipy.io import mmwrite
from scipy.sparse import coo_array, csc_array, save_npz

_PATH = Path(__file__).parents[2] / "docs" / "examples" / "plate_on_mounts.py"
_SPEC = importlib.util.spec_from_file_location("plate_on_mounts", _PATH)
assert _SPEC is not None
assert _SPEC.loader is not None
_MODULE = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_MODULE)
plate = _MODULE.plate


def write_matrix(path, matrix):
    """Write a matrix with all digits as Matrix Market or .npz."""
    if path.suffix == ".npz":
        save_npz(path, csc_array(matrix))
    else:
        mmwrite(path, coo_array(matrix), precision=17)
