"""Files of measured rubber data: columns by name, converted to SI units."""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.column_tables import Column, Table, read_columns
from viscovib.errors import InputError

if TYPE_CHECKING:
    pass
from viscovib.rubber.data import QUANTITIES, CreepData, ModulusData, RelaxationData

_Data = TypeVar("_Data")
_FREQUENCY = Column(
    "frequency",
    "frequency",
    ("f", "freq", "frequency", "nu", "omega", "w", "ω", "angularfrequency", "circularfrequency"),
)
_TIME = Column("time", "time", ("t", "time"))
_TEMPERATURE = Column("temperature", "temperature", ("t", "temp", "temperature"))
_SET = Column("set", "label", ("set", "sweep", "setnumber", "run"))
_MODULI = {
    "storage": ("estor", "gstor", "e'", "g'", "storage", "storagemodulus", "m'"),
    "loss": ("eloss", "gloss", "e''", "g''", "loss", "lossmodulus", "m''"),
    "magnitude": ("e*", "g*", "|e*|", "|g*|", "complexmodulus", "m*", "|m*|"),
}
_STIFFNESSES = {
    "storage": ("k'", "kstor", "storagestiffness", "storage", "elasticstiffness"),
    "loss": ("k''", "kloss", "lossstiffness", "loss"),
    "magnitude": ("k*", "|k*|", "k", "kdyn", "dynamicstiffness", "stiffness"),
}
_TANGENT = Column("tangent", "ratio", ("tan", "tand", "tandelta", "tanδ", "lossfactor", "eta", "η"))
_ANGLE = Column("angle", "angle", ("angle", "phase", "lossangle", "phaseangle", "delta", "δ"))
_AMPLITUDE = Column("amplitude", "length", ("amplitude", "displacement", "x0", "x"))


def read_dma(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    quantity: str | None = None,
) -> ModulusData:
    """Read storage and loss moduli over frequency.

    Parameters
    ----------
    path : path
        CSV (semicolons, tabs or commas between columns; decimal points or commas), or a spreadsheet
        if pandas is installed. Columns are found by their names: frequency (``f``, ``freq``,
        ``omega``), two of storage, loss, magnitude and ``tan_delta`` (``E_stor``, ``G'``, ``E''``,
        ``|E*|``, ``loss factor``), optionally temperature (``T``) and ``Set``. Units are in the
        line below or in the names: Hz or rad/s (1/s is rad/s for ``omega`` and angular frequencies,
        Hz for ``f``), Pa to GPa, C or K.
    columns : mapping, optional
        {"frequency": "name in the file", ...} for other names: "frequency", "storage", "loss",
        "magnitude", "tangent", "angle", "temperature", "set".
    quantity : {"E", "G"}, optional
        Required if the names do not contain it.

    Raises
    ------
    InputError
        ``file:line: column 'name': what is wrong``.
    FileError
        If the file cannot be read.

    Examples
    --------
    >>> vv.read_dma("data/rubber/pyvisco_freq_user_master.csv")
    ModulusData(206 rows of E, 6.283e-12 to 6.283e+14 rad/s, storage 8.88e+07 to 9.58e+09)
    """
    return _read_dynamic(path, columns, quantity, "modulus", _MODULI)


def read_dynamic_stiffness(
    path: str | os.PathLike[str], *, columns: Mapping[str, str] | None = None
) -> ModulusData:
    r"""Read the dynamic stiffness of a mount over frequency: |K*| and angle, or K' and K''.

    As `read_dma`, with names ``K'``, ``K''``, ``|K*|``, ``angle`` (deg or rad), ``loss factor`` and
    ``amplitude`` (m, mm), and units N/m, N/mm, kN/mm or N m/rad.

    Examples
    --------
    >>> text = "f [Hz];K* [N/mm];phase [deg]\n1;200;10\n2;220;12\n"
    >>> with open("mount.csv", "w") as file:
    ...     n = file.write(text)
    >>> vv.read_dynamic_stiffness("mount.csv").loss_factor.round(3)
    array([0.176, 0.213])
    """
    return _read_dynamic(path, columns, "K", "stiffness", _STIFFNESSES)


def _read_dynamic(
    path: str | os.PathLike[str],
    columns: Mapping[str, str] | None,
    quantity: str | None,
    kind: str,
    names: Mapping[str, tuple[str, ...]],
) -> ModulusData:
    wanted = [_FREQUENCY, *(Column(role, kind, known) for role, known in names.items())]
    wanted += [_TANGENT, _ANGLE, _TEMPERATURE, _SET]
    if kind == "stiffness":
        wanted.append(_AMPLITUDE)
    table = read_columns(path, wanted, _mapping(columns))
    nu = _needed(table, "frequency")
    given = [role for role in ("storage", "loss", "magnitude") if role in table]
    turned = [role for role in ("tangent", "angle") if role in table]
    if "storage" in table and "loss" in table:
        storage, loss = table["storage"], table["loss"]
    elif given and turned:
        angle = table["angle"] if turned[-1] == "angle" else np.arctan(table["tangent"])
        if given[0] == "magnitude":
            storage, loss = table["magnitude"] * np.cos(angle), table["magnitude"] * np.sin(angle)
        elif given[0] == "storage":
            storage, loss = table["storage"], table["storage"] * np.tan(angle)
        else:
            storage, loss = table["loss"] / np.tan(angle), table["loss"]
    else:
        raise InputError(
            f"{table.path}: has {' and '.join([*given, *turned]) or 'no modulus'}, must have "
            "storage and loss, or one of them or the magnitude with a loss factor or angle; "
            "give other names by columns={'storage': ...}"
        )
    measured = _checked_quantity(quantity) or _quantity(table, given)
    _refuse(table, "frequency", nu <= 0, "greater than 0")
    _refuse(table, given[0], storage <= 0, "that of a positive storage modulus")
    _refuse(
        table,
        (given + turned)[-1 if turned else 1],
        loss < 0,
        "that of a loss that is not negative",
    )
    return _with_path(
        table,
        lambda: ModulusData(
            frequencies=nu, storage=storage, loss=loss, quantity=measured, **_common(table)
        ),
    )


def read_relaxation(
    path: str | os.PathLike[str],
    *,
    ramp: float = 0.0,
    columns: Mapping[str, str] | None = None,
    quantity: str | None = None,
) -> RelaxationData:
    """Read a modulus over time after a step of strain.

    As `read_dma`, with columns of time (``t``, ``time``; s, ms, min, h) and of the modulus
    (``E_relax``, ``E(t)``, ``G``); ``ramp`` is the duration of the increase of the strain (s).

    Examples
    --------
    >>> vv.read_relaxation("data/rubber/pyvisco_time_user_raw.csv")
    RelaxationData(210 rows in 21 sets of E, 0.01 to 10 s, -49.99 to 100 deg C, ...)
    """
    names = ("erelax", "grelax", "e", "g", "et", "gt", "relaxationmodulus", "modulus")
    table = read_columns(
        path,
        [_TIME, Column("modulus", "modulus", names), _TEMPERATURE, _SET],
        _mapping(columns),
    )
    times, modulus = _needed(table, "time"), _needed(table, "modulus")
    _refuse(table, "time", times <= 0, "greater than 0")
    _refuse(table, "modulus", modulus <= 0, "greater than 0")
    measured = _checked_quantity(quantity) or _quantity(table, ["modulus"])
    return _with_path(
        table,
        lambda: RelaxationData(
            times=times, modulus=modulus, ramp=ramp, quantity=measured, **_common(table)
        ),
    )


def read_creep(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    quantity: str | None = None,
) -> CreepData:
    r"""Read a compliance over time after a step of stress.

    As `read_dma`, with columns of time and of the compliance (``D`` of E, ``J`` of G; 1/Pa to
    1/GPa).

    Examples
    --------
    >>> with open("creep.csv", "w") as file:
    ...     n = file.write("t,J\nmin,1/MPa\n1,2\n2,3\n")
    >>> vv.read_creep("creep.csv")
    CreepData(2 rows of 1/G, 60 to 120 s, 2e-06 to 3e-06)
    """
    names = ("j", "d", "jt", "dt", "jcreep", "dcreep", "creepcompliance", "compliance")
    table = read_columns(
        path,
        [_TIME, Column("compliance", "compliance", names), _TEMPERATURE, _SET],
        _mapping(columns),
    )
    times, compliance = _needed(table, "time"), _needed(table, "compliance")
    _refuse(table, "time", times <= 0, "greater than 0")
    _refuse(table, "compliance", compliance <= 0, "greater than 0")
    letters = {"J": "G", "D": "E"}
    measured = _checked_quantity(quantity) or letters.get(
        table.named["compliance"].strip()[:1].upper()
    )
    if measured is None:
        raise InputError(f"{table.path}: quantity: must be given, 'E' or 'G'")
    return _with_path(
        table,
        lambda: CreepData(times=times, compliance=compliance, quantity=measured, **_common(table)),
    )


def _mapping(columns: Any) -> Mapping[str, str]:
    return {} if columns is None else _native.mapping("columns", columns)


def _needed(table: Table, role: str) -> FloatArray:
    if role not in table:
        raise InputError(
            f"{table.path}: has no column of {role}: select one by columns={{{role!r}: ...}}"
        )
    return table[role]


def _checked_quantity(quantity: str | None) -> str | None:
    """Return the given quantity; None: determined by the file."""
    return None if quantity is None else _native.choice("quantity", quantity, QUANTITIES)


def _quantity(table: Table, roles: Sequence[str]) -> str:
    """E or G, by the first letter of a name."""
    for role in roles:
        letter = table.named[role].strip().lstrip("|")[:1].upper()
        if letter in ("E", "G"):
            return letter
    raise InputError(f"{table.path}: names do not distinguish E and G: quantity must be given")


def _refuse(table: Table, role: str, wrong: npt.NDArray[np.bool_], allowed: str) -> None:
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        value = table[role][row]
        raise InputError(f"{table.where(row, role)}: {value:g} (SI units): must be {allowed}")


def _common(table: Table) -> dict[str, Any]:
    return {role: table[role] for role in ("temperature", "set", "amplitude") if role in table}


def _with_path(table: Table, make: Callable[[], _Data]) -> _Data:
    """Create the data; add the file to error messages."""
    try:
        return make()
    except InputError as error:
        raise InputError(f"{table.path}: {error}") from None
