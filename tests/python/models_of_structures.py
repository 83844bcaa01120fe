"""Finite-element models for tests: the plate of the examples."""

import importlib.util
from pathlib import Path

_PATH = Path(__file__).parents[2] / "docs" / "examples" / "plate_on_mounts.py"
_SPEC = importlib.util.spec_from_file_location("plate_on_mounts", _PATH)
assert _SPEC is not None
assert _SPEC.loader is not None
_MODULE = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_MODULE)
plate = _MODULE.plate
