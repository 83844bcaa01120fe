"""Reference solutions in time, by compiled programs of SciPy where their results suffice."""

import warnings
from types import SimpleNamespace

import numpy as np
import scipy.integrate

#: More output times than this are interpolated by `scipy.integrate.solve_ivp`.
_TIMES = 500
#: Compiled programs of Hairer and Wanner with the formulas of these methods.
_PROGRAMS = {"DOP853": "dop853", "RK45": "dopri5"}


def solve_ivp(
    fun, t_span, y0, method="DOP853", t_eval=None, dense_output=False, events=None, args=None,
    **options,
):  # fmt: skip
    """Solve an initial value problem like `scipy.integrate.solve_ivp`, in a quarter of the time.

    The compiled programs have the formulas and tolerances of the methods in Python. The latter
    repeat the step with a terminal event and continue from there. They also compute interpolated
    values, and solutions that a compiled program abandons.
    """
    own = {"method": method, "dense_output": dense_output, "args": args, **options}
    own = {key: value for key, value in own.items() if value is not None}
    events = [] if events is None else [events] if callable(events) else list(events)
    y0 = np.asarray(y0)
    if (
        method not in _PROGRAMS
        or dense_output
        or options.keys() - {"rtol", "atol", "max_step", "first_step"}
        or np.iscomplexobj(y0)
        or t_span[1] <= t_span[0]
        or not all(getattr(event, "terminal", False) is True for event in events)
        or (t_eval is not None and (events or len(t_eval) > _TIMES))
    ):
        return scipy.integrate.solve_ivp(
            fun, t_span, y0, t_eval=t_eval, events=events or None, **own
        )
    found = _compiled(_PROGRAMS[method], fun, t_span, y0, t_eval, events, args or (), options)
    if found is None:
        return scipy.integrate.solve_ivp(
            fun, t_span, y0, t_eval=t_eval, events=events or None, **own
        )
    t, y, continues = found
    if continues:
        last = scipy.integrate.solve_ivp(fun, (t[-1], t_span[1]), y[-1], events=events, **own)
        last.t = np.concatenate([t[:-1], last.t])
        last.y = np.concatenate([np.array(y[:-1]).reshape(-1, y0.size).T, last.y], axis=1)
        return last
    nothing = [np.zeros(0) for _ in events]
    return SimpleNamespace(
        t=np.array(t), y=np.array(y).T, status=0, success=True,
        t_events=nothing if events else None, y_events=nothing if events else None,
    )  # fmt: skip


def _compiled(program, fun, t_span, y0, t_eval, events, args, options):
    """Return times, states, and whether SciPy's method in Python continues; None if it begins."""
    begin, end = (float(t) for t in t_span)
    settings = {"rtol": 1e-3, "atol": 1e-6, "nsteps": 1_000_000, **options}
    settings = {key: value for key, value in settings.items() if np.all(np.isfinite(value))}
    rest, raised = np.zeros(y0.size), []

    def slope(t, y):
        # The compiled program accepts neither exceptions nor tuples.
        try:
            value = rest if raised else fun(t, y, *args)
        except Exception as error:
            raised.append(error)
            value = rest
        return list(value) if isinstance(value, tuple) else value

    solver = scipy.integrate.ode(slope).set_integrator(program, **settings)
    times, states, continues = [], [], False
    signs = [np.sign(event(begin, y0, *args)) for event in events]

    def keep(t, y):
        nonlocal continues
        if raised:
            return -1
        try:
            now = [np.sign(event(t, y, *args)) for event in events]
        except Exception as error:
            raised.append(error)
            return -1
        for event, sign, before in zip(events, now, signs, strict=True):
            if sign != before and not getattr(event, "direction", 0) * (sign - before) < 0:
                continues = True
                return -1
        signs[:] = now
        times.append(t)
        states.append(y.copy())
        return 0

    if t_eval is None:
        solver.set_solout(keep)
    solver.set_initial_value(y0, begin)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for t in [end] if t_eval is None else t_eval:
            y = solver.y if t == solver.t else solver.integrate(t)
            if raised:
                raise raised[0]
            if not solver.successful():
                return (times, states, True) if t_eval is None and times else None
            if t_eval is not None:
                times.append(t)
                states.append(np.array(y))
    return times, states, continues
