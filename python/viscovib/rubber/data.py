"""Measurements of rubber: moduli over frequency, relaxation, creep, dynamic stiffness.

All numbers are in SI units and frequencies circular (rad/s); readers turn the units of a file into
these. E is Young's modulus, G the shear modulus, K a stiffness; one becomes another only where a
Poisson ratio is stated.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.column_tables import Column, Table, read_columns
from viscovib.common.parameters import Number
from viscovib.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Data = TypeVar("_Data")
#: What was measured: E or G (Pa), K (N/m or N m/rad).
QUANTITIES = ("E", "G", "K")
#: Measured numbers and their inverses are at most this.
_FAR = 1e40
_POISSON = Number("poisson", -1, 0.5)
_RAMP = Number("ramp", lowest=0)

_FREQUENCY = Column(
    "frequency",
    "frequency",
    ("f", "freq", "frequency", "nu", "omega", "w", "ω", "angularfrequency"),
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


@dataclass(frozen=True, kw_only=True, eq=False)
class ModulusData:
    """Storage and loss over frequency, of one or several sets.

    Parameters
    ----------
    frequencies : array_like, shape (n,)
        Circular frequencies (rad/s), > 0; each once in a set.
    storage, loss : array_like, shape (n,)
        M' > 0 and M'' >= 0: moduli (Pa), or dynamic stiffness (N/m).
    temperature : array_like, shape (n,) or float, optional
        Degrees Celsius.
    set : array_like, shape (n,), optional
        Number of the set of each row. Without it a new set begins where the frequencies turn back.
    amplitude : array_like, shape (n,) or float, optional
        Amplitudes of the deflection (m).
    quantity : {"E", "G", "K"}
        Young's modulus, shear modulus, or a stiffness.

    Raises
    ------
    InputError
        For what no material has or no measurement gives: a line with the place.

    Examples
    --------
    >>> nu = np.geomspace(1, 1e3, 30)
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=stiff.imag)
    >>> data
    ModulusData(30 rows of E, 1 to 1000 rad/s, storage 9.59e+05 to 1.91e+06)
    """

    frequencies: npt.ArrayLike
    storage: npt.ArrayLike
    loss: npt.ArrayLike
    temperature: npt.ArrayLike | None = None
    set: npt.ArrayLike | None = None
    amplitude: npt.ArrayLike | None = None
    quantity: str = "E"

    def __post_init__(self) -> None:
        _native.choice("quantity", self.quantity, QUANTITIES)
        n = _columns(self, ("frequencies", "storage", "loss"), ("temperature", "set", "amplitude"))
        for name in ("frequencies", "storage"):
            _first_wrong(name, getattr(self, name), getattr(self, name) <= 0, "be greater than 0")
        for name in ("frequencies", "storage", "loss"):
            _in_range(name, getattr(self, name))
        _first_wrong("loss", self.loss, np.asarray(self.loss) < 0, "not be negative")
        if self.amplitude is not None:
            sizes = np.asarray(self.amplitude)
            _first_wrong("amplitude", sizes, sizes <= 0, "be greater than 0")
        if self.set is None:
            labels = _turns(np.asarray(self.frequencies))
            labels.setflags(write=False)
            object.__setattr__(self, "set", labels)
        _check_order(self, "frequencies", "rad/s")
        assert n == np.asarray(self.set).size

    def __repr__(self) -> str:
        nu, storage = np.asarray(self.frequencies), np.asarray(self.storage)
        return (
            f"ModulusData({_rows(self)} of {self.quantity}, {nu.min():.4g} to {nu.max():.4g} "
            f"rad/s{_warmth(self)}, storage {storage.min():.3g} to {storage.max():.3g})"
        )

    @property
    def modulus(self) -> ComplexArray:
        """M' + i M'', shape (n,)."""
        return np.asarray(self.storage) + 1j * np.asarray(self.loss)

    @property
    def loss_factor(self) -> FloatArray:
        """tan(delta) = M''/M', shape (n,)."""
        return np.asarray(np.asarray(self.loss) / np.asarray(self.storage))

    def sets(self) -> "list[ModulusData]":
        """Each set by itself, with ascending frequencies; from cold to warm, if that is known."""
        return _sets(self, "frequencies")

    def to_shear(self, *, poisson: float) -> "ModulusData":
        """G = E/(2 (1 + poisson)), the ratio taken as a real constant."""
        return self._converted("E", "G", 0.5 / (1 + _POISSON.check(poisson)))

    def to_young(self, *, poisson: float) -> "ModulusData":
        """E = 2 (1 + poisson) G, the ratio taken as a real constant."""
        return self._converted("G", "E", 2 * (1 + _POISSON.check(poisson)))

    def _converted(self, before: str, after: str, factor: float) -> "ModulusData":
        if self.quantity != before:
            raise InputError(f"quantity = {self.quantity!r}: must be {before!r} to become {after}")
        return replace(
            self,
            storage=np.asarray(self.storage) * factor,
            loss=np.asarray(self.loss) * factor,
            quantity=after,
        )

    def kramers_kronig(self) -> Any:
        """Say whether storage and loss belong together: see `kramers_kronig`."""
        # By name, since that module knows this one.
        return import_module("viscovib.rubber.kramers_kronig_pair").kramers_kronig(self)

    def plot(self, ax: "Axes | Sequence[Axes] | None" = None) -> "Sequence[Axes]":
        """Draw storage and loss over frequency: see `plot_modulus`."""
        # By name, since that module knows this one.
        return import_module("viscovib.plots.rubber").plot_modulus(self, ax)  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True, eq=False)
class RelaxationData:
    """A modulus over time after a step of strain, or after a ramp that ends in it.

    Parameters
    ----------
    times : array_like, shape (n,)
        From the beginning of the step or ramp (s), > 0; each once in a set.
    modulus : array_like, shape (n,)
        Stress over the final strain (Pa), or force over deflection (N/m), > 0.
    ramp : float
        Time that the ramp takes (s), 0 for a step; times must not be before its end. A ramp taken
        as a step gives an instantaneous modulus far too large, with hardly a residual.
    temperature, set, quantity
        As in `ModulusData`.

    Examples
    --------
    >>> t = np.geomspace(0.1, 100, 20)
    >>> rubber = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> vv.RelaxationData(times=t, modulus=2e6 * rubber.relaxation(t))
    RelaxationData(20 rows of E, 0.1 to 100 s, 6.92e+05 to 1.26e+06)
    """

    times: npt.ArrayLike
    modulus: npt.ArrayLike
    ramp: float = 0.0
    temperature: npt.ArrayLike | None = None
    set: npt.ArrayLike | None = None
    quantity: str = "E"

    def __post_init__(self) -> None:
        _native.choice("quantity", self.quantity, QUANTITIES)
        _check_times(self, "modulus")
        object.__setattr__(self, "ramp", _RAMP.check(self.ramp))
        first = float(np.min(np.asarray(self.times)))
        if first < self.ramp * (1 - 1e-12):
            raise InputError(
                f"times: {first:g} is before the end of the ramp, must be {self.ramp:g} or later"
            )

    def __repr__(self) -> str:
        return f"RelaxationData({_rows(self)} of {self.quantity}, {_times(self, self.modulus)})"

    def sets(self) -> "list[RelaxationData]":
        """Each set by itself, with ascending times."""
        return _sets(self, "times")


@dataclass(frozen=True, kw_only=True, eq=False)
class CreepData:
    """A compliance over time after a step of stress.

    Parameters
    ----------
    times : array_like, shape (n,)
        From the step on (s), > 0; each once in a set.
    compliance : array_like, shape (n,)
        Strain over stress (1/Pa), or deflection over force (m/N), > 0.
    temperature, set, quantity
        As in `ModulusData`; the quantity is the modulus whose compliance this is.

    Examples
    --------
    >>> vv.CreepData(times=[1, 10, 100], compliance=[1e-6, 1.2e-6, 1.5e-6])
    CreepData(3 rows of 1/E, 1 to 100 s, 1e-06 to 1.5e-06)
    """

    times: npt.ArrayLike
    compliance: npt.ArrayLike
    temperature: npt.ArrayLike | None = None
    set: npt.ArrayLike | None = None
    quantity: str = "E"

    def __post_init__(self) -> None:
        _native.choice("quantity", self.quantity, QUANTITIES)
        _check_times(self, "compliance")

    def __repr__(self) -> str:
        return f"CreepData({_rows(self)} of 1/{self.quantity}, {_times(self, self.compliance)})"

    def sets(self) -> "list[CreepData]":
        """Each set by itself, with ascending times."""
        return _sets(self, "times")


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
        where pandas is installed. Columns are found by their names: frequency (``f``, ``freq``,
        ``omega``), two of storage, loss, magnitude and ``tan_delta`` (``E_stor``, ``G'``, ``E''``,
        ``|E*|``, ``loss factor``), and if they are there temperature (``T``) and ``Set``. Units
        stand in the line below or in the names: Hz or rad/s, Pa to GPa, C or K.
    columns : mapping, optional
        {"frequency": "name in the file", ...} for other names: "frequency", "storage", "loss",
        "magnitude", "tangent", "angle", "temperature", "set".
    quantity : {"E", "G"}, optional
        Must be given if the names do not tell it.

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
            "storage and loss, or one of them or the magnitude with a loss factor or angle"
        )
    measured = quantity or _quantity(table, given)
    _refuse(table, "frequency", nu <= 0, "greater than 0")
    _refuse(table, given[0], storage <= 0, "that of a positive storage modulus")
    _refuse(
        table,
        (given + turned)[-1 if turned else 1],
        loss < 0,
        "that of a loss that is not negative",
    )
    return _told(
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
    (``E_relax``, ``E(t)``, ``G``); ``ramp`` is the time that the strain took to rise (s).

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
    measured = quantity or _quantity(table, ["modulus"])
    return _told(
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
    measured = quantity or letters.get(table.named["compliance"].strip()[:1].upper())
    if measured is None:
        raise InputError(f"{table.path}: quantity: must be given, 'E' or 'G'")
    return _told(
        table,
        lambda: CreepData(times=times, compliance=compliance, quantity=measured, **_common(table)),
    )


def _mapping(columns: Any) -> Mapping[str, str]:
    return {} if columns is None else _native.mapping("columns", columns)


def _needed(table: Table, role: str) -> FloatArray:
    if role not in table:
        raise InputError(
            f"{table.path}: has no column of {role}: say which by columns={{{role!r}: ...}}"
        )
    return table[role]


def _quantity(table: Table, roles: Sequence[str]) -> str:
    """E or G, by the first letter of a name."""
    for role in roles:
        letter = table.named[role].strip().lstrip("|")[:1].upper()
        if letter in ("E", "G"):
            return letter
    raise InputError(f"{table.path}: names do not tell E from G: quantity must be given")


def _refuse(table: Table, role: str, wrong: npt.NDArray[np.bool_], allowed: str) -> None:
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        value = table[role][row]
        raise InputError(f"{table.where(row, role)}: {value:g} (SI units): must be {allowed}")


def _common(table: Table) -> dict[str, Any]:
    return {role: table[role] for role in ("temperature", "set", "amplitude") if role in table}


def _told(table: Table, make: Callable[[], _Data]) -> _Data:
    """Make the data; what is wrong is told with the file."""
    try:
        return make()
    except InputError as error:
        raise InputError(f"{table.path}: {error}") from None


def _columns(data: Any, needed: Sequence[str], others: Sequence[str]) -> int:
    """Check and freeze the columns; all of one length."""
    n = -1
    for name in [*needed, *others]:
        given = getattr(data, name)
        if given is None and name in others:
            continue
        array = _native.real_array(name, given)
        if name in others and array.ndim == 0:
            array = np.full(max(n, 0), float(array))
        array = array.copy()
        if array.ndim != 1 or array.size == 0:
            raise InputError(f"{name}: must have shape (n,) with n > 0, got {array.shape}")
        if n < 0:
            n = array.size
        elif array.size != n:
            raise InputError(f"{name} has {array.size} numbers: must match {needed[0]}, {n}")
        array.setflags(write=False)
        object.__setattr__(data, name, array)
    return n


def _check_times(data: Any, values: str) -> None:
    _columns(data, ("times", values), ("temperature", "set"))
    for name in ("times", values):
        _first_wrong(name, getattr(data, name), getattr(data, name) <= 0, "be greater than 0")
        _in_range(name, getattr(data, name))
    if data.set is None:
        labels = _turns(data.times)
        labels.setflags(write=False)
        object.__setattr__(data, "set", labels)
    _check_order(data, "times", "s")


def _first_wrong(name: str, values: Any, wrong: npt.NDArray[np.bool_], allowed: str) -> None:
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise InputError(f"{name}[{i}] = {values[i]:g}: must {allowed}")


def _in_range(name: str, values: Any) -> None:
    """Refuse numbers whose ratios would leave the range of numbers; no unit makes such ones."""
    far = (values > _FAR) | ((values < 1 / _FAR) & (values > 0))
    _first_wrong(name, values, far, f"be {1 / _FAR:g} to {_FAR:g}")


def _turns(x: FloatArray) -> FloatArray:
    """Numbers of sets: a new one begins where the values turn back."""
    step = np.sign(np.diff(x))
    labels = np.zeros(x.size)
    number, way = 0, 0.0
    for i in range(1, x.size):
        if way not in (0.0, step[i - 1]) and step[i - 1] != 0:
            number, way = number + 1, 0.0
        elif step[i - 1] != 0:
            way = step[i - 1]
        labels[i] = number
    return labels


def _check_order(data: Any, name: str, unit: str) -> None:
    """Refuse what stands twice in a set, and sets that go up and down."""
    values, labels = np.asarray(getattr(data, name)), np.asarray(data.set)
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        step = np.diff(values[rows])
        wrong = np.flatnonzero(step == 0)
        if wrong.size:
            i = rows[wrong[0] + 1]
            raise InputError(
                f"{name}[{i}] = {values[i]:g} {unit} stands twice in set {label:g}: must be once"
            )
        turns = np.flatnonzero(np.sign(step[1:]) != np.sign(step[:-1]))
        if turns.size:
            i = rows[turns[0] + 2]
            raise InputError(
                f"{name}[{i}] = {values[i]:g} {unit} turns back in set {label:g}: a set must "
                "ascend or descend"
            )


def _sets(data: Any, name: str) -> list[Any]:
    labels = np.asarray(data.set)
    columns = [
        one for one in data.__dataclass_fields__ if isinstance(getattr(data, one), np.ndarray)
    ]
    found = []
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        rows = rows[np.argsort(np.asarray(getattr(data, name))[rows])]
        found.append(replace(data, **{one: getattr(data, one)[rows] for one in columns}))
    if data.temperature is not None:
        found.sort(key=lambda one: float(np.mean(one.temperature)))
    return found


def _rows(data: Any) -> str:
    sets = np.unique(np.asarray(data.set)).size
    return f"{np.asarray(data.set).size} rows" + (f" in {sets} sets" if sets > 1 else "")


def _warmth(data: Any) -> str:
    if data.temperature is None:
        return ""
    return f", {np.min(data.temperature):.4g} to {np.max(data.temperature):.4g} deg C"


def _times(data: Any, values: Any) -> str:
    t = np.asarray(data.times)
    return (
        f"{t.min():.4g} to {t.max():.4g} s{_warmth(data)}, "
        f"{np.min(values):.3g} to {np.max(values):.3g}"
    )
