"""Options of every curve of steady motions: this table is the one place that names them.

From its rows come, without another line anywhere: the component of `curve_options` in Fortran and
its bounds (`fortran/fill_options.py`, in the build), the key of `&branch` and
`&backbone`, the keyword of `trace_response` and `backbone` for editors and at run time, its check,
its documentation there and on the page of scenes, and the tests that hold for all of them.

The build reads this file alone, so it imports nothing of the package.
"""

from dataclasses import dataclass
from typing import Annotated, TypedDict, get_args, get_type_hints


@dataclass(frozen=True)
class Option:
    """What an option is if it is not given, what it may be, and what is said of it.

    ``other`` is a value that changes the curve of a Duffing oscillator, by which tests see that
    the option has an effect. Without ``text`` the functions document it themselves.
    """

    default: float
    lowest: float
    highest: float
    other: float
    text: str = ""


class CurveKeywords(TypedDict, total=False):
    """The options: a whole number is an int, any other a float."""

    tolerance: Annotated[float, Option(1e-10, 1e-14, 0.1, 1e-4)]
    max_points: Annotated[int, Option(2000, 2, 100000, 9, "Points at most.")]
    max_step: Annotated[
        float, Option(0.1, 1e-4, 1, 0.01, "Largest step as a part of the present point.")
    ]
    max_folds: Annotated[
        int,
        Option(
            100000, 1, 100000, 1,
            'Folds behind which the curve ends with "fold limit"; the highest is no limit.',
        ),
    ]  # fmt: skip
    angle: Annotated[
        float,
        Option(
            0.12, 0.01, 0.3, 0.03,
            "Angle between the curve's directions at two points that steps aim at (rad): a smaller "
            "one gives finer curves where they bend.",
        ),
    ]  # fmt: skip
    atol: Annotated[float, Option(0.0, 0, 1e30, 1e-3)]


#: The rows by name, and which are whole numbers.
OPTIONS: dict[str, Option] = {}
WHOLE: set[str] = set()
for _name, _hint in get_type_hints(CurveKeywords, include_extras=True).items():
    _type, OPTIONS[_name] = get_args(_hint)
    if _type is int:
        WHOLE.add(_name)
