"""Texts of the help of `viscovib` and of the standalone driver: the only definition.

The build reads this file alone and makes constants of the driver of it (`fortran/fill_notes.py`).
"""

#: Texts by name.
NOTES = {
    "paths": "let the scene read files outside its folder",
    "seconds": "stop after S seconds, keep what is done; exit status 1",
    "memory": "stop if more than GB gigabytes are needed; exit status 1",
    "most_memory": "(default: three quarters of the memory of the machine)",
    "status": "exit status: 0 done; 1 some points have no solution (the tables say which), or a "
    "limit was\nreached; 2 bad input; 3 a file cannot be read or written. With several scenes each "
    "one is\ntried, and the largest status is returned.",
    "same_names": ": its tables would have the same names as those of ",
    "apart": ": run each by a call of its own",
}
