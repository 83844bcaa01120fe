"""Steady motions of either system: one name for the mount and for the pendulum."""

from typing import Any, overload

from viscovib.branch import Branch
from viscovib.branch import trace_response as _trace_mount
from viscovib.driven import DrivenResponse, pendulum_response
from viscovib.driven_branch import DrivenBranch, trace_pendulum
from viscovib.mount import Mount
from viscovib.pendulum import Pendulum
from viscovib.response import Response
from viscovib.response import forced_response as _mount_response


@overload
def forced_response(system: Mount, *args: Any, **options: Any) -> Response: ...
@overload
def forced_response(system: Pendulum, *args: Any, **options: Any) -> DrivenResponse: ...
def forced_response(system: Any, *args: Any, **options: Any) -> Response | DrivenResponse:
    """Steady response of a mount or of a pendulum to its loads.

    forced_response(mount, nu, *, load=None, base=None, method="successive", harmonics=9, ...)
    forced_response(pend, *, p1=None, ..., m02=None, nu=None, harmonics="auto", ...)
    """
    if isinstance(system, Pendulum):
        return pendulum_response(system, *args, **options)
    return _mount_response(system, *args, **options)


@overload
def trace_response(system: Mount, *args: Any, **options: Any) -> Branch: ...
@overload
def trace_response(system: Pendulum, *args: Any, **options: Any) -> DrivenBranch: ...
def trace_response(system: Any, *args: Any, **options: Any) -> Branch | DrivenBranch:
    """Follow a branch of steady motions of a mount or of a pendulum through its folds.

    trace_response(mount, nu_range=None, *, load=None, nu=None, load_range=None, ...)
    trace_response(pend, *, p1=None, ..., m02=None, nu=None, leave=None, harmonics=None, ...)
    """
    if isinstance(system, Pendulum):
        return trace_pendulum(system, *args, **options)
    return _trace_mount(system, *args, **options)


forced_response.__doc__ = f"{forced_response.__doc__}\nFor a mount: {_mount_response.__doc__}\n" \
    f"For a pendulum: {pendulum_response.__doc__}"  # fmt: skip
trace_response.__doc__ = f"{trace_response.__doc__}\nFor a mount: {_trace_mount.__doc__}\n" \
    f"For a pendulum: {trace_pendulum.__doc__}"  # fmt: skip
