"""Order of the files, and objects that live as long as the tests do."""

import gc
from pathlib import Path

#: Files that take longest, first: where files are run side by side, none of these is begun when the
#: others are done. Times change; a name that is missing costs a part of a minute, no more.
LONGEST = (
    "test_explorer_browser",
    "test_guide",
    "test_sweep_checkpoint",
    "test_stops",
    "test_fuzz",
    "test_structure_vary",
    "test_sweep_dask",
    "test_thin_layers",
    "test_steady_motion",
    "test_scales_random",
    "test_multiple_scales",
    "test_branch",
    "test_switches_beside_memory",
    "test_driver_limits",
)


def pytest_collection_modifyitems(items):
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(Path(item.path).stem, len(place)))


def pytest_collection_finish():
    # Modules and tests: looked through again and again by the collector they take 3 % of the time.
    gc.freeze()
