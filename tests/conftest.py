"""Order of the files, and objects that live as long as the tests do."""

import gc
from pathlib import Path

#: Files that take longest, first: where files are run side by side, none of these is begun when the
#: others are done. Times change; a name that is missing costs a part of a minute, no more.
LONGEST = (
    "test_explorer_browser",
    "test_guide",
    "test_stops",
    "test_scales_random",
    "test_memory",
    "test_multiple_scales",
    "test_scales_choice",
    "test_fuzz",
    "test_results",
    "test_driver",
    "test_branch",
    "test_kernel_fit",
    "test_commands",
    "test_interrupts",
)


def pytest_collection_modifyitems(items):
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(Path(item.path).stem, len(place)))


def pytest_collection_finish():
    # Modules and tests: looked through again and again by the collector they take 3 % of the time.
    gc.freeze()
