"""Kernels and fits as JSON files, also for scenes (``kind = 'fitted'``)."""

import dataclasses
import json
import os
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from viscovib import _native
from viscovib.common.files import bytes_of, whole_file
from viscovib.common.parameters import FilePath
from viscovib.errors import InputError
from viscovib.kernels.relaxation import (
    AbelKernel,
    Kernel,
    PronyKernel,
    RabotnovKernel,
    RzhanitsynKernel,
)
from viscovib.kernels.sum_kernel import SumKernel
from viscovib.kernels.tabulated import TabulatedKernel
from viscovib.kernels.time_temperature import WLF, Arrhenius, ShiftLaw, ThermalKernel
from viscovib.rubber.data import CreepData, ModulusData, RelaxationData
from viscovib.rubber.fit import KernelFit, Optimum
from viscovib.rubber.measured import LOSS_SHARE, SHARE, Measured
from viscovib.rubber.models import PARTS, Model
from viscovib.rubber.parametric_fit import ParametricFit
from viscovib.rubber.prony_fit import PronyFit
from viscovib.rubber.shift_fit import ShiftTable

_Made = TypeVar("_Made")
_FORMAT, _VERSION = "viscovib kernel", 1
_LARGEST = 64 * 2**20
#: Largest unknown of a fit; most are logarithms of numbers up to 1e304.
_FARTHEST = 700.0
_KERNELS: dict[str, tuple[type[Kernel], tuple[str, ...]]] = {
    "rzhanitsyn": (RzhanitsynKernel, ("amplitude", "alpha", "beta")),
    "rabotnov": (RabotnovKernel, ("amplitude", "alpha", "beta")),
    "abel": (AbelKernel, ("amplitude", "alpha")),
    "prony": (PronyKernel, ("weights", "rates")),
    "tabulated": (TabulatedKernel, ("interpolation", "times", "values")),
}
_LAWS: dict[str, tuple[type[ShiftLaw], tuple[str, ...]]] = {
    "wlf": (WLF, ("reference", "c1", "c2")),
    "arrhenius": (Arrhenius, ("reference", "activation_energy")),
    "table": (ShiftTable, ("temperatures", "decades")),
}
_DATA: dict[str, type] = {
    "modulus": ModulusData, "relaxation": RelaxationData, "creep": CreepData,
}  # fmt: skip


def write_kernel(kernel: Kernel, path: str | os.PathLike[str]) -> None:
    """Write a kernel, with its shift law and temperature if it has them, as JSON.

    Examples
    --------
    >>> rubber = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> vv.write_kernel(rubber, "rubber.json")
    >>> vv.read_kernel("rubber.json") == rubber
    True
    """
    _native.check_instance("kernel", kernel, Kernel)
    _write(path, _head(kernel))


def read_kernel(path: str | os.PathLike[str]) -> Kernel:
    """Read the kernel from a file of `write_kernel` or ``fit.to_json``.

    Raises
    ------
    FileError
        If the file cannot be read.
    InputError
        If it contains no kernel: one line with the error.

    Examples
    --------
    >>> vv.write_kernel(vv.AbelKernel(amplitude=0.02, alpha=0.1), "rubber.json")
    >>> vv.read_kernel("rubber.json")
    AbelKernel(amplitude=0.02, alpha=0.1)
    """
    name, content = _read(path)
    return _with_path(name, lambda: _kernel_of(content))


def write_fit(fit: KernelFit, path: str | os.PathLike[str]) -> None:
    """Write a fit and its data as JSON."""
    _native.check_instance("fit", fit, KernelFit)
    data = fit.measured.data
    kind = next(name for name, one in _DATA.items() if isinstance(data, one))
    columns = {
        key: value.tolist() if isinstance(value := getattr(data, key), np.ndarray) else value
        for key in data.__dataclass_fields__
    }
    shares = fit.measured.shares
    content = _head(fit.kernel) | {
        "modulus": fit.modulus,
        "quantity": fit.quantity,
        "kind": fit.kind,
        "parameters": _plain(fit.parameters),
        "interval": _plain(fit.interval),
        "weights": fit.weights,
        "shares": [float(shares[0]), float(shares[-1])],
        "optima": [{"cost": one.cost, "parameters": dict(one.parameters)} for one in fit.optima],
        "fit": fit._saved(),
        "data": {"kind": kind, **columns},
    }
    _write(path, content)


def read_fit(path: str | os.PathLike[str]) -> KernelFit:
    """Read a fit from a file of ``fit.to_json``, with its data and its uncertainty.

    Raises
    ------
    FileError
        If the file cannot be read.
    InputError
        If it contains no fit.

    Examples
    --------
    >>> t = np.geomspace(0.01, 100, 30)
    >>> rubber = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> fit = vv.fit_kernel(vv.RelaxationData(times=t, modulus=2e6 * rubber.relaxation(t)))
    >>> fit.to_json("rubber.json")
    >>> vv.read_fit("rubber.json").modulus == fit.modulus
    True
    """
    name, content = _read(path)
    return _with_path(name, lambda: _fit_of(content))


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers for JSON; non-finite numbers become null."""

    def one(value: Any) -> Any:
        if isinstance(value, tuple):
            return [one(part) for part in value]
        return value if np.isfinite(value) else None

    return {key: one(value) for key, value in values.items()}


def _head(kernel: Kernel) -> dict[str, Any]:
    content: dict[str, Any] = {"format": _FORMAT, "version": _VERSION}
    if isinstance(kernel, ThermalKernel):
        content["shift"] = _law_out(kernel.shift)
        content["temperature"] = kernel.temperature
        kernel = kernel.kernel
    content["kernel"] = _kernel_out(kernel)
    return content


def _kernel_out(kernel: Kernel) -> dict[str, Any]:
    if isinstance(kernel, SumKernel):
        return {"kind": "sum", "parts": [_kernel_out(part) for part in kernel.parts]}
    for kind, (one, names) in _KERNELS.items():
        if isinstance(kernel, one):
            values = {key: getattr(kernel, key) for key in names}
            plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}
            return {"kind": kind, **plain}
    if isinstance(kernel, ThermalKernel):
        raise InputError("kernel: a part of a sum has a temperature; give the sum one instead")
    raise InputError(f"kernel: a {type(kernel).__name__} has no form in a file")


def _law_out(law: ShiftLaw) -> dict[str, Any]:
    for kind, (one, names) in _LAWS.items():
        if isinstance(law, one):
            values = {key: getattr(law, key) for key in names}
            plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}
            return {"kind": kind, **plain}
    raise InputError(f"shift: a {type(law).__name__} has no form in a file")


def _kernel_of(content: Any) -> Kernel:
    kernel = _kernel_in(_entry(content, "kernel"))
    law = content.get("shift")
    if law is None:
        return kernel
    kind, values = _kind(law, "shift", tuple(_LAWS))
    one, names = _LAWS[kind]
    made = one(**{key: _entry(values, key) for key in names})
    return ThermalKernel(kernel=kernel, shift=made, temperature=content.get("temperature"))


def _kernel_in(content: Any, depth: int = 0) -> Kernel:
    kind, values = _kind(content, "kernel", (*_KERNELS, "sum"))
    if kind == "sum":
        parts = _entry(values, "parts")
        if depth or not isinstance(parts, list):
            raise InputError("parts: must be a list of kernels that are not sums")
        return SumKernel(parts=[_kernel_in(part, depth + 1) for part in parts])
    one, names = _KERNELS[kind]
    return one(**{key: _entry(values, key) for key in names})


def _kind(content: Any, what: str, allowed: tuple[str, ...]) -> tuple[str, Mapping[str, Any]]:
    if not isinstance(content, dict):
        raise InputError(f"{what}: must be an object with a kind")
    return _native.choice(f"{what}: kind", content.get("kind"), allowed), content


def _entry(content: Mapping[str, Any], key: str) -> Any:
    if key not in content:
        raise InputError(f"lacks {key!r}")
    return content[key]


def _fit_of(content: Mapping[str, Any]) -> KernelFit:
    if "fit" not in content:
        raise InputError("contains a kernel without a fit: use read_kernel")
    saved, given = _entry(content, "fit"), _entry(content, "data")
    if not isinstance(saved, dict) or not isinstance(given, dict):
        raise InputError("fit, data: must be objects")
    kind = _native.choice("data: kind", given.get("kind"), tuple(_DATA))
    columns = {key: value for key, value in given.items() if key in _fields(_DATA[kind])}
    data = _DATA[kind](**columns)
    shares = _entry(content, "shares")
    measured = Measured.of(data, (SHARE.check(shares[0]), LOSS_SHARE.check(shares[-1])))
    kernel = _kernel_of(content)
    law = kernel.shift if isinstance(kernel, ThermalKernel) else None
    weights = _native.choice("weights", _entry(content, "weights"), ("model", "data"))
    if "grid" in saved:
        return PronyFit(
            measured=measured,
            grid=_native.real_array("grid", saved["grid"], ndim=1),
            found=_native.real_array("found", _entry(saved, "found"), ndim=1),
            weights=weights,
            smooth=float(_entry(saved, "smooth")),
            given=_entry(saved, "given_modulus"),
            shift=law,
        )
    parts = tuple(_native.choice("parts", one, PARTS) for one in _entry(saved, "parts"))
    model = Model(
        parts,
        bool(_entry(saved, "allow_creep")),
        _entry(saved, "given_modulus"),
        _native.number("unit", _entry(saved, "unit")),
    )
    theta = _native.real_array("unknowns", _entry(saved, "unknowns"), ndim=1)
    if theta.size != model.size:
        raise InputError(f"unknowns: has {theta.size} numbers, must have {model.size}")
    if np.abs(theta).max(initial=0.0) > _FARTHEST:
        raise InputError(
            f"unknowns: {np.abs(theta).max():g} is the largest, must be at most {_FARTHEST:g}"
        )
    return ParametricFit(
        model=model,
        measured=measured,
        theta=theta,
        weights=weights,
        shift=law,
        kind=str(_entry(content, "kind")),
        optima=tuple(Optimum(one["cost"], one["parameters"]) for one in content.get("optima", [])),
    )


def _fields(one: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(one))


def _write(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with whole_file(path) as file:
        file.write(text)


def _read(path: str | os.PathLike[str]) -> tuple[str, dict[str, Any]]:
    name = FilePath("path").check(path)
    try:
        content = json.loads(bytes_of(name, _LARGEST, "a fitted kernel").decode())
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{name}: is not JSON ({error})") from None
    except ValueError as error:
        raise InputError(f"{name}: cannot be read ({error})") from None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise InputError(f"{name}: is not a fitted kernel: format must be {_FORMAT!r}")
    if content.get("version") != _VERSION:
        raise InputError(
            f"{name}: version = {_native.shown(content.get('version'))}: must be {_VERSION}"
        )
    return name, content


def _with_path(name: str, make: Callable[[], _Made]) -> _Made:
    try:
        return make()
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    except (TypeError, ValueError, KeyError, IndexError, OverflowError) as error:
        raise InputError(f"{name}: {error}") from None
