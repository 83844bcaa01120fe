"""Steady motions of any system: one name for oscillators, as a mount, and for the pendulum."""

from collections.abc import Mapping
from typing import Any, overload

import numpy.typing as npt

from viscovib.backbone import Backbone, BackbonePoint
from viscovib.backbone import oscillator_backbone as _oscillator_backbone
from viscovib.branch import Branch
from viscovib.branch import trace_response as _trace_mount
from viscovib.curves import BranchPoint
from viscovib.driven import DrivenResponse, pendulum_response
from viscovib.driven_branch import DrivenBranch, trace_pendulum
from viscovib.load import LoadLike
from viscovib.oscillators import Oscillator
from viscovib.parameters import Form
from viscovib.pendulum import Pendulum
from viscovib.pendulum_backbone import pendulum_backbone as _pendulum_backbone
from viscovib.response import forced_response as _mount_response
from viscovib.response_result import Response


@overload
def forced_response(
    mount: Oscillator,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    method: str = "successive",
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    max_iterations: int = 200,
    relaxation: float | str = 1.0,
    stability: bool = False,
    progress: bool = False,
) -> Response: ...
@overload
def forced_response(
    pend: Pendulum,
    *,
    p1: npt.ArrayLike | None = None,
    p2: npt.ArrayLike | None = None,
    p3: npt.ArrayLike | None = None,
    f0: npt.ArrayLike | None = None,
    m01: npt.ArrayLike | None = None,
    m02: npt.ArrayLike | None = None,
    nu: npt.ArrayLike | None = None,
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    stability: bool = True,
    duration: float = 3000.0,
    subharmonic: int = 1,
    max_denominator: int = 12,
) -> DrivenResponse: ...
def forced_response(*args: Any, **options: Any) -> Response | DrivenResponse:
    """Steady response of a mount, of a polynomial system or of a pendulum to its loads.

    forced_response(mount, nu, *, load=None, base=None, method="successive", harmonics="auto", ...)
    forced_response(pend, *, p1=None, ..., m02=None, nu=None, harmonics="auto", ...)
    """
    return (_OF_PENDULUM if _is_pendulum(args, options) else _OF_MOUNT)(args, options)


@overload
def trace_response(
    mount: Oscillator,
    nu_range: tuple[float, float] | None = None,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    nu: float | None = None,
    load_range: tuple[float, float] | None = None,
    vary: str | None = None,
    vary_range: tuple[float, float] | None = None,
    at: npt.ArrayLike = (),
    leave: BranchPoint | None = None,
    opposite: bool = False,
    symmetric: bool = True,
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    max_points: int = 2000,
    max_step: float = 0.1,
    stability: bool = True,
) -> Branch: ...
@overload
def trace_response(
    pend: Pendulum,
    *,
    p1: tuple[float, float] | None = None,
    p2: tuple[float, float] | None = None,
    p3: tuple[float, float] | None = None,
    f0: tuple[float, float] | None = None,
    m01: tuple[float, float] | None = None,
    m02: tuple[float, float] | None = None,
    nu: tuple[float, float] | None = None,
    at: npt.ArrayLike = (),
    leave: BranchPoint | None = None,
    opposite: bool = False,
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    max_points: int = 2000,
    max_step: float = 0.1,
    stability: bool = True,
    duration: float | None = None,
    symmetric: bool = False,
    subharmonic: int = 1,
    max_denominator: int = 12,
) -> DrivenBranch: ...
def trace_response(*args: Any, **options: Any) -> Branch | DrivenBranch:
    """Follow a branch of steady motions of a mount, a polynomial system or a pendulum.

    trace_response(mount, nu_range=None, *, load=None, nu=None, load_range=None, ...)
    trace_response(pend, *, p1=None, ..., m02=None, nu=None, leave=None, harmonics="auto", ...)
    """
    return (_TRACE_PENDULUM if _is_pendulum(args, options) else _TRACE_MOUNT)(args, options)


@overload
def backbone(
    system: Oscillator,
    mode: int,
    amplitude_range: tuple[float, float],
    *,
    dof: str | None = None,
    harmonics: int = 9,
    tolerance: float = 1e-10,
    max_points: int = 2000,
    max_step: float = 0.1,
) -> Backbone: ...
@overload
def backbone(
    pend: Pendulum,
    mode: int,
    amplitude_range: tuple[float, float] | None = None,
    *,
    energy_range: tuple[float, float] | None = None,
    dof: str | None = None,
    harmonics: int = 15,
    tolerance: float = 1e-10,
    max_points: int = 2000,
    max_step: float = 0.1,
    stability: bool = True,
    symmetric: bool = False,
    subharmonic: int = 1,
    leave: BackbonePoint | None = None,
    opposite: bool = False,
) -> Backbone: ...
def backbone(*args: Any, **options: Any) -> Backbone:
    """Follow the free motions that grow from a linear mode: frequency against amplitude.

    backbone(system, mode, amplitude_range, *, dof=None, harmonics=9, ...)
    backbone(pend, mode, amplitude_range=None, *, energy_range=None, leave=None, ...)
    """
    return (_FREE_PENDULUM if _is_pendulum(args, options) else _FREE_OSCILLATOR)(args, options)


def _is_pendulum(args: tuple[Any, ...], options: Mapping[str, Any]) -> bool:
    return "pend" in options or bool(args and isinstance(args[0], Pendulum))


_MOUNT, _PENDULUM = "a mount or a polynomial system", "a pendulum"
_OF_MOUNT = Form(_mount_response, "forced_response", _MOUNT)
_OF_PENDULUM = Form(pendulum_response, "forced_response", _PENDULUM)
_TRACE_MOUNT = Form(_trace_mount, "trace_response", _MOUNT)
_TRACE_PENDULUM = Form(trace_pendulum, "trace_response", _PENDULUM)
_FREE_OSCILLATOR = Form(_oscillator_backbone, "backbone", _MOUNT)
_FREE_PENDULUM = Form(_pendulum_backbone, "backbone", _PENDULUM)


forced_response.__doc__ = f"{forced_response.__doc__}\nFor a mount: {_mount_response.__doc__}\n" \
    f"For a pendulum: {pendulum_response.__doc__}"  # fmt: skip
trace_response.__doc__ = f"{trace_response.__doc__}\nFor a mount: {_trace_mount.__doc__}\n" \
    f"For a pendulum: {trace_pendulum.__doc__}"  # fmt: skip
backbone.__doc__ = f"{backbone.__doc__}\nFor a mount or a polynomial system: " \
    f"{_oscillator_backbone.__doc__}\nFor a pendulum: {_pendulum_backbone.__doc__}"  # fmt: skip
