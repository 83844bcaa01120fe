"""Order of the test files; garbage collection."""

import gc
from pathlib import Path

#: Files with the longest run time, first, so that parallel workers do not wait for one of them at
#: the end. A missing name costs at most a part of a minute.
LONGEST = (
    "test_explorer_browser",
    "test_dask",
    "test_sweep_checkpoint",
    "test_fuzz",
    "test_guide",
    "test_stops",
    "test_examples",
    "test_kernel_fit",
    "test_python_laws",
    "test_damper_laws",
    "test_fluid_dampers",
    "test_branch",
    "test_cli",
    "test_explorer",
    "test_driver_limits",
    "test_amplitude_fit",
    "test_sparse_structure",
    "test_driven",
    "test_commands",
    "test_body",
    "test_steady_motion",
    "test_switches_with_memory",
    "test_multiple_scales",
    "test_turning_stability",
    "test_special_files",
)


def pytest_collection_modifyitems(items):
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(Path(item.path).stem, len(place)))


def pytest_collection_finish():
    # The garbage collector would scan modules and tests repeatedly (3 % of the run time).
    gc.freeze()
