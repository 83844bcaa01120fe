"""Options of all curves of steady motions: the only definition.

Each row defines: the component of `curve_options` in Fortran with its bounds
(`fortran/fill_options.py`, in the build), the key of `&branch` and `&backbone`, the keyword of
`trace_response` and `backbone` for editors and at run time, its check, its documentation there and
on the page of scenes, and its tests.

The build reads only this file, so it does not import the package.
"""

from dataclasses import dataclass
from typing import Annotated, TypedDict, get_args, get_type_hints


@dataclass(frozen=True)
class Option:
    """Default, bounds and description of an option.

    ``other``: a value that changes the curve of a Duffing oscillator, for tests of the effect. The
    default None means that the system selects the value; scenes use 0 for it. Options without
    ``text`` are documented by the functions.
    """

    default: float | None
    lowest: float
    highest: float
    other: float
    text: str = ""


class CurveKeywords(TypedDict, total=False):
    """The options. An integer has the type int, any other number float."""

    tolerance: Annotated[float | None, Option(None, 1e-14, 0.1, 1e-4)]
    max_points: Annotated[int, Option(2000, 2, 100000, 9, "Largest number of points.")]
    max_step: Annotated[
        float, Option(0.1, 1e-4, 1, 0.01, "Largest step relative to the present point.")
    ]
    max_folds: Annotated[
        int,
        Option(
            100000, 1, 100000, 1,
            'The curve ends with "fold limit" after so many folds; the highest value: no limit.',
        ),
    ]  # fmt: skip
    angle: Annotated[
        float,
        Option(
            0.12, 0.01, 0.3, 0.03,
            "Target angle between the curve's directions at successive points (rad). A smaller "
            "value gives more points where the curve bends.",
        ),
    ]  # fmt: skip
    atol: Annotated[float, Option(0.0, 0, 1e30, 1e-3)]


#: The options by name, and the names of integer options.
OPTIONS: dict[str, Option] = {}
WHOLE: set[str] = set()
for _name, _hint in get_type_hints(CurveKeywords, include_extras=True).items():
    _type, OPTIONS[_name] = get_args(_hint)
    if _type is int:
        WHOLE.add(_name)
