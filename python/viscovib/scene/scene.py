"""Scenes: a system, its load and the requested results as one namelist file.

The compiled reader of the standalone driver reads and checks the file. It
returns the scene with all defaults to Python.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.counts import things
from viscovib.common.parameters import CURVE_DEFAULTS, FilePath
from viscovib.errors import InputError
from viscovib.kernels.relaxation import (
    AbelKernel,
    Kernel,
    PronyKernel,
    RabotnovKernel,
    RzhanitsynKernel,
)
from viscovib.kernels.tabulated import TabulatedKernel
from viscovib.scene.keys import groups_of, named_in, namelist_text, with_key, with_numbers
from viscovib.systems.elements import Spring
from viscovib.systems.frequency_formulas import ONE, KnownTerms
from viscovib.systems.friction import BoucWen, Dahl, Iwan
from viscovib.systems.mount import Mount
from viscovib.systems.oscillators import Steady
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.series_dampers import Maxwell
from viscovib.systems.speed_matrices import OF_SPEED
from viscovib.systems.spring_groups import Monomial, Springs
from viscovib.systems.structure import Structure

if TYPE_CHECKING:
    from viscovib.analyses.backbones import Backbone
    from viscovib.analyses.driven_branch import DrivenBranch
    from viscovib.analyses.events import Event
    from viscovib.bodies.body import Body
    from viscovib.results.scales import ScalesResponse
    from viscovib.systems.shaft import DriveTorque

_KERNELS: dict[str, type[Kernel]] = {
    "rzhanitsyn": RzhanitsynKernel,
    "abel": AbelKernel,
    "prony": PronyKernel,
    "rabotnov": RabotnovKernel,
    "tabulated": TabulatedKernel,
}
#: Groups that a scene may contain several times.
_REPEATABLE = (
    "kernel", "load", "spring", "force", "element", "layer", "mount_point", "event", "sweep",
)  # fmt: skip
#: Groups that name coordinates of results.
_SHOWN = (
    "response", "branch", "backbone", "transient", "spectrum", "free_decay", "shock_spectrum",
)  # fmt: skip
_LISTS = ("weights", "rates", "times", "values")

#: Keys in &branch of a pendulum that are arguments of `trace_response` with the same names.
_DRIVEN = (
    "harmonics", *CURVE_DEFAULTS, "subharmonic", "max_denominator",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that was read and checked.

    Attributes
    ----------
    path : Path
        The file.
    title : str
    groups : mapping
        Every group with all defaults: {"mount": {...}, "kernel": [...], "load": [...], ...} or
        {"pendulum": {...}, "transient": {...}, ...}.
    canonical : str
        The same as namelist text.

    Examples
    --------
    >>> import viscovib as vv
    >>> scene = vv.Scene.read("data/scenes/mount_paper.nml")
    >>> heavier = scene.override({"mount.mass": 1.5})
    """

    path: Path
    title: str
    groups: Mapping[str, Any]
    canonical: str

    @classmethod
    def read(cls, path: str | os.PathLike[str], *, allow_paths: bool = False) -> Scene:
        """Read and check a scene file.

        Files in the scene, such as the table of a kernel, must be in its folder or below it, after
        following links. ``allow_paths`` removes this restriction, for your own scenes.

        Raises
        ------
        InputError
            One line ``file:line: error, allowed values``.
        FileError
            If the file cannot be read.
        """
        text = _canonical(path, _native.flag("allow_paths", allow_paths))
        groups: dict[str, Any] = {name: [] for name in _REPEATABLE}
        for name, group in groups_of(text):
            if name in _REPEATABLE:
                groups[name].append(group)
            else:
                groups[name] = group
        return cls(
            path=Path(path),
            title=groups.get("scene", {}).get("title", ""),
            groups=groups,
            canonical=text,
        )

    def override(self, values: Mapping[str, Any]) -> Scene:
        """Return the scene with changed keys, checked like a file.

        Keys are ``{"mount.stiffness_x": 12}``; for one of several groups ``"load(2).amplitude"``,
        for one entry of a list ``"transient.initial(3)"``, counted from 1. Groups &sweep are left
        out.
        """
        _native.mapping("values", values)
        groups: Mapping[str, Any] = {**self.groups, "sweep": []}
        for key, value in values.items():
            groups = with_key(groups, key, value)
        changes = ", ".join(
            f"{key} = {' '.join(f'{value}'.split())[:60]}" for key, value in values.items()
        )
        name = f"{self.path} with {changes}" if changes else f"{self.path}"
        try:
            text = _canonical_text(name, namelist_text(groups))
        except InputError as error:
            # A line number of this generated text would mislead.
            raise InputError(re.sub(r"^:\d+: ", ": ", f"{error}".removeprefix(name))[2:]) from None
        return replace(self, groups=groups, canonical=text)

    @property
    def is_pendulum(self) -> bool:
        """True if the system is a pendulum."""
        return "pendulum" in self.groups

    @property
    def _is_reduced(self) -> bool:
        """True if the system is a reduced structure, with coordinates by ``shapes``."""
        return "shapes" in self.groups.get("structure", {})

    def pendulum(self) -> Pendulum:
        """Build the pendulum."""
        return Pendulum(**self._group("pendulum"))

    def oscillator(self) -> Steady:
        """Build the mount, the polynomial system, the structure or the body."""
        if "structure" in self.groups:
            return self.structure()
        if "body" in self.groups:
            return self.body()
        return self.polynomial_system() if "system" in self.groups else self.mount()

    def polynomial_system(self) -> PolynomialSystem:
        """Build the polynomial system."""
        given = self._group("system")
        names = texts(given["coordinates"])
        direction = np.atleast_1d(given["base_direction"])
        kernels: list[Kernel | None] = [None, *(_kernel(group) for group in self.groups["kernel"])]
        springs = [
            Springs(
                stiffness=_matrix(group["stiffness"], len(names)), kernel=kernels[group["kernel"]]
            )
            for group in [given, *self.groups["spring"]]
        ]
        for group in self.groups["force"]:
            if "coefficient" not in group:
                # The core writes polynomials as monomials: this is another law, or none.
                if group["law"] != "0":
                    springs.append(
                        Springs(
                            forces={group.get("on", names[0]): group["law"].lower()},
                            kernel=kernels[group["kernel"]],
                        )
                    )
                continue
            monomial = Monomial(
                coefficient=group["coefficient"],
                powers=[int(p) for p in np.atleast_1d(group["powers"])],
                on=group["on"],
            )
            springs.append(Springs(forces=[monomial], kernel=kernels[group["kernel"]]))
        return PolynomialSystem(
            mass=_matrix(given["mass"], len(names)),
            damping=_matrix(given["damping"], len(names)),
            springs=springs,
            names=names,
            units=texts(given["units"]),
            base_direction=direction if direction.any() else None,
            parameters=self._parameters or None,
            **_of_speed(given, len(names)),
        )

    def structure(self) -> Structure:
        """Build the structure with its elements.

        A scene with ``shapes`` (a reduced structure, written by `Structure.write`) has the modal
        coordinates "q1", "q2", ...: its named coordinates are ``shapes`` times these.
        """
        given = self._group("structure")
        names, shapes = texts(given["coordinates"]), self._shapes()
        n = len(names) if shapes is None else shapes.shape[1]
        kernels: list[Kernel | None] = [None, *(_kernel(group) for group in self.groups["kernel"])]
        elements: list[Any] = []
        for group in self.groups["element"]:
            e = np.zeros(len(names))
            weights = np.atleast_1d(group["weights"])
            for name, weight in zip(texts(group["on"]), weights, strict=True):
                e[names.index(name.lower())] += weight
            along = e if shapes is None else shapes.T @ e
            elements += _elements(group, along, kernels[group["kernel"]], self._parameters)
        ratios = np.asarray(given["modal_damping"])
        more: dict[str, Any] = {"names": names, "units": texts(given["units"])}
        if shapes is not None:
            more = {"names": [f"q{i + 1}" for i in range(n)]}
        elif np.any(given["base_direction"]):
            more["base_direction"] = np.atleast_1d(given["base_direction"])
        if "supports" in given:
            more["supports"] = [name.lower() for name in texts(given["supports"])]
        layers, stiffness = [], _matrix(given["stiffness"], n)
        for group in self.groups["layer"]:
            kernel = kernels[group["kernel"]]
            matrix = _matrix(group["stiffness"], n)
            if kernel is None:
                stiffness = stiffness + matrix
            else:
                layers.append((matrix, kernel))
        rayleigh = (float(given["rayleigh"][0]), float(given["rayleigh"][1]))
        return Structure(
            mass=_matrix(given["mass"], n),
            stiffness=stiffness,
            damping=_matrix(given["damping"], n),
            layers=layers,
            modal_damping=ratios if ratios.any() else None,
            rayleigh=rayleigh if any(rayleigh) else None,
            loss_factor=given["loss_factor"],
            elements=elements,
            **_of_speed(given, n),
            **more,
        )

    def body(self) -> Body:
        """Build the body on its mounts."""
        from viscovib.scene.body import body_of

        kernels: list[Kernel | None] = [None, *(_kernel(group) for group in self.groups["kernel"])]
        points = [with_numbers(group, self._parameters) for group in self.groups["mount_point"]]
        return body_of(self._group("body"), points, kernels)

    @property
    def _parameters(self) -> dict[str, float]:
        """Parameters of laws and their values."""
        return {name: float(x) for name, x in self.groups.get("parameters", {}).items()}

    def _shapes(self) -> FloatArray | None:
        """Named coordinates of a reduced structure as combinations of its modes."""
        given = self.groups.get("structure", {})
        if "shapes" not in given:
            return None
        return np.reshape(np.asarray(given["shapes"], dtype=float), (len(self._names()), -1))

    def mount(self) -> Mount:
        """Build the mount."""
        given = dict(self._group("mount"))
        given["damping"] = np.reshape(given["damping"], (2, 2))
        kernels: dict[str, Kernel] = {}
        for group in self.groups["kernel"]:
            kernels[group["acts_on"]] = _kernel(group)
        if "both" in kernels:
            return Mount(**given, kernel=kernels["both"])
        return Mount(**given, kernel=kernels.get("x"), kernel_phi=kernels.get("phi", False))

    def loads(self) -> dict[str, Any]:
        """Fourier series of the force and the base motion, for `forced_response`."""
        force: dict[int, Any] = {}
        base: dict[int, Any] = {}
        # Base motion of single coordinates.
        apart: dict[int, Any] = {}
        # Coefficients of formulas in nu.
        varying: dict[int, dict[str, Any]] = {}
        names, shapes = self._names(), self._shapes()
        for group in self.groups["load"]:
            if "shape" in group:
                continue
            order, terms = group["order"], _amplitudes(with_numbers(group, self._parameters))
            if group["kind"] == "base":
                if "on" in group and "structure" in self.groups:
                    alone = base.setdefault(group["on"].lower(), {})
                    alone[order] = alone.get(order, 0.0) + terms[ONE]
                elif "on" in group:
                    on = np.array([group["on"] == name for name in self._base_names()])
                    apart[order] = apart.get(order, 0.0) + on * terms[ONE]
                else:
                    base[order] = base.get(order, 0.0) + terms[ONE]
                continue
            if "force" in group:
                on = self._built.load(group["force"], group["torque"], group["at"])
            else:
                on = np.array([group["on"] == name for name in names])
                on = on if shapes is None else shapes.T @ on
            own = varying.setdefault(order, {})
            for formula, term in terms.items():
                own[formula] = own.get(formula, 0.0) + on * term
        for order, own in varying.items():
            force[order] = own.get(ONE, 0.0)
            if set(own) - {ONE}:
                rows = zip(*own.values(), strict=True)
                force[order] = [KnownTerms(dict(zip(own, row, strict=True))) for row in rows]
        for order, moved in apart.items():
            along = 0.0
            if order in base:
                direction = self._built._base_direction
                along = base[order] * np.asarray(direction)[: moved.size]
            base[order] = moved + along
        return {"load": force, "base": base or None}

    def _base_names(self) -> tuple[str, ...]:
        if "body" in self.groups:
            from viscovib.bodies.checks import NAMES

            return NAMES
        return self._names()

    def nu(self) -> FloatArray:
        """Circular frequencies of the response (rad/s)."""
        group = self._group("response")
        if "nu" in group:
            return np.atleast_1d(np.asarray(group["nu"], dtype=float))
        log = group["nu_spacing"] == "log"
        return _grid(group["nu_from"], group["nu_to"], group["nu_count"], log)

    def _hz(self) -> FloatArray:
        """Frequencies of the shock response spectrum (Hz)."""
        group = self._group("shock_spectrum")
        if "frequencies" in group:
            return np.atleast_1d(np.asarray(group["frequencies"], dtype=float))
        return _grid(group["from"], group["to"], group["count"], group["spacing"] == "log")

    def sweep_grid(self) -> dict[str, FloatArray]:
        """Values of each parameter of the &sweep groups."""
        grid = {}
        for group in self.groups["sweep"]:
            if "values" in group:
                values = np.atleast_1d(np.asarray(group["values"], dtype=float))
            else:
                log = group["spacing"] == "log"
                values = _grid(group["min"], group["max"], group["count"], log)
            grid[group["key"].lower()] = np.asarray(values)
        if not grid:
            raise InputError(f"{self.path}: has no &sweep group, and no grid is given")
        return grid

    def _names(self) -> tuple[str, ...]:
        if self._is_reduced:
            return texts(self.groups["structure"]["coordinates"])
        return tuple(self._built.dof_names)

    @cached_property
    def _built(self) -> Any:
        """The system."""
        return self.pendulum() if self.is_pendulum else self.oscillator()

    def _group(self, name: str) -> Mapping[str, Any]:
        if name not in self.groups:
            raise InputError(f"{self.path}: has no &{name} group")
        group: Mapping[str, Any] = self.groups[name]
        if name != "multiple_scales" and group.get("tolerance") == 0:
            # 0 means: not given.
            return {**group, "tolerance": None}
        return group

    def _motion(self) -> dict[str, Any]:
        from viscovib.scene.shocks import loads_in_time
        from viscovib.systems.shaft import turns_shaft

        group = self._group("transient")
        more: dict[str, Any] = {}
        if self._has_memory:
            series = {name: terms or None for name, terms in self.loads().items()}
            more = {**series, "memory": group["memory"], "held": np.atleast_1d(group["held"])}
        elif "nu" in group:
            more = {"load": self.loads()["load"]}
        if "nu" in group:
            more["nu"] = group["nu"]
        accuracy = {name: group[name] or None for name in ("rtol", "atol")}
        if not any(accuracy.values()):
            accuracy = {"tolerance": group["tolerance"]}
        in_time = loads_in_time(self.groups["load"], self._names())
        if "drive_torque" in self.groups:
            group_of_motor = with_numbers(self._group("drive_torque"), self._parameters)
            in_time["force"] = _motor(group_of_motor)
        chosen = self._chosen()
        if turns_shaft(self._built, in_time.get("force")):
            # Its whole history is 0.
            more.pop("held", None)
            chosen = {name: [*names, "angle"] for name, names in chosen.items()}
        return {
            "system": self._built,
            **more,
            **in_time,
            **chosen,
            "t_end": group["t_end"],
            "initial": np.atleast_1d(group["initial"]),
            "dt": group["dt"] or "auto",
            **accuracy,
            "method": group["method"],
            "save_every": group["save_every"],
            "keep": group["keep"],
            "tail": group.get("tail"),
            "times": np.atleast_1d(group["times"]) if "times" in group else None,
            "events": self.events() or None,
        }

    def _chosen(self) -> dict[str, Any]:
        """The coordinates that the result of a structure has: all that the scene mentions."""
        # Steady motions of rotors at changing speeds have all coordinates.
        if not self._built._is_condensed or (
            self._built._depends_on_speed and "transient" not in self.groups
        ):
            return {}
        words: set[str] = set()
        for group in (self.groups.get(name, {}) for name in _SHOWN):
            words.update(texts(group.get("coordinates", ())), texts(group.get("coordinate", ())))
        for event in self.groups["event"]:
            words.update(re.findall(r"\w+", event["function"]))
        words = {word.lower() for word in words}
        named = ((name, f"{name}_dot", f"{name}_ddot") for name in self._names())
        return {"coordinates": [one[0] for one in named if not words.isdisjoint(one)]}

    def events(self) -> list[Event]:
        """Build the events of a motion in time."""
        from viscovib.analyses.events import Event

        return [
            Event(
                with_numbers(group, self._parameters)["function"].lower(),
                direction=group["direction"],
                terminal=group["terminal"] == "yes",
            )
            for group in self.groups["event"]
        ]

    @property
    def _has_memory(self) -> bool:
        """Whether the motion is that of a system that may have memory."""
        return "held" in self._group("transient")

    def _steady(self) -> ScalesResponse:
        from viscovib.analyses.multiple_scales import MultipleScales

        group = self._group("multiple_scales")
        values = _grid(group["from"], group["to"], group["count"], False)
        if self.is_pendulum:
            system = MultipleScales(self._built, tolerance=_band(group), ordering=group["ordering"])
        else:
            system = MultipleScales(
                self._built,
                load=np.real(self.loads()["load"][1]),
                nu=group.get("nu"),
                tolerance=_band(group),
            )
        return system.response(group["parameter"], values)

    def _driven(self) -> tuple[DrivenBranch, tuple[DrivenBranch, ...]]:
        """Compute the branch of a pendulum and the branches that leave it."""
        from viscovib.analyses.periodic import trace_response

        group = self._group("branch")
        same = {
            "system": self._built,
            group["parameter"]: (group["from"], group["to"]),
            "stability": group["stability"] == "yes",
            "symmetric": group["symmetry"] == "kept",
            **{key: group[key] for key in _DRIVEN},
        }
        first = trace_response(**same)
        return first, tuple(
            trace_response(**same, leave=leave, opposite=opposite)
            for leave, opposite in self._departures("branch", first.branch_points)
        )

    def _backbones(self) -> tuple[Backbone, tuple[Backbone, ...]]:
        """Compute the free motions of a mode and the families that leave them."""
        from viscovib.analyses.periodic import backbone

        group = self._group("backbone")
        ends = (group["from"], group["to"])
        same = {
            "system": self._built,
            **{key: group[key] for key in ("mode", "harmonics")},
            **{key: group[key] for key in (*CURVE_DEFAULTS, "dof") if key in group},
            **self._chosen(),
        }
        if not self.is_pendulum:
            return backbone(**same, amplitude_range=ends), ()
        same |= {
            f"{group['parameter']}_range": ends,
            "stability": group["stability"] == "yes",
            "symmetric": group["symmetry"] == "kept",
            "subharmonic": group["subharmonic"],
        }
        first = backbone(**same)
        return first, tuple(
            backbone(**same, leave=leave, opposite=opposite)
            for leave, opposite in self._departures("backbone", first.branch_points)
        )

    def _departures(self, name: str, points: Sequence[Any]) -> Iterator[tuple[Any, bool]]:
        """Branch points at which a group switches, and whether in the opposite direction."""
        for number in np.atleast_1d(self._group(name).get("switch", [])).tolist():
            if abs(number) > len(points):
                raise InputError(
                    f"{self.path}: switch = {number}: the {name} has "
                    f"{things(len(points), 'branch point')}"
                )
            yield points[abs(number) - 1], number < 0

    def _branch(self) -> dict[str, Any]:
        group = self._group("branch")
        where: dict[str, Any] = {}
        if group["vary"] == "nu":
            where["nu_range"] = (group["nu_from"], group["nu_to"])
        else:
            where["nu"], ends = group["nu"], (group["from"], group["to"])
            if group["vary"] == "load_factor":
                where["load_range"] = ends
            else:
                where |= {"vary": group["vary"], "vary_range": ends}
        return {
            "system": self._built,
            **where,
            **self.loads(),
            **self._chosen(),
            **{key: group[key] for key in ("harmonics", *CURVE_DEFAULTS)},
            "stability": group["stability"] == "yes",
        }

    def _job(self) -> dict[str, Any]:
        group = self._group("response")
        relaxation = group["relaxation"]
        return {
            "system": self._built,
            "nu": self.nu(),
            **self.loads(),
            **self._chosen(),
            **{
                key: group[key]
                for key in ("method", "harmonics", "tolerance", "atol", "max_iterations")
            },
            "relaxation": relaxation if relaxation > 0 else "auto",
            "stability": group["stability"] == "yes",
        }


def _motor(group: Mapping[str, Any]) -> DriveTorque:
    """The motor of a group &drive_torque."""
    from viscovib.systems.shaft import DriveTorque

    given = {name: group[name] for name in ("inertia", "speed", "phase")}
    size, turned = (np.atleast_1d(group[name]) for name in ("unbalance", "unbalance_phase"))
    return DriveTorque(
        torque=group["torque"].lower(), unbalance=size * np.exp(1j * turned), **given
    )


def _amplitudes(group: Mapping[str, Any]) -> dict[str, complex]:
    """Return the coefficient of each formula in nu of a load, as the core does."""
    order, by, turn = group["order"], group["amplitude"], group.get("phase", 0.5 * math.pi)
    size, factors = 1.0, []
    if isinstance(by, str):
        factors = [f"({by.lower()})"]
    else:
        size = float(by)
    if group["kind"] == "unbalance":
        size *= order**2
        factors.append("nu^2")
    if isinstance(turn, str):
        parts = ("cos", size), ("sin", 1j * size)
        return {"*".join([*factors, f"{f}({turn.lower()})"]): z for f, z in parts}
    unit = complex(math.cos(turn), math.sin(turn)) if order else 1j
    return {"*".join(factors) or ONE: size * unit}


def _band(group: Mapping[str, Any]) -> float | None:
    """Return the band of resonances in a group, None if the core chooses by influence.

    The core writes the lowest possible number for a band that is not given.
    """
    return None if group["tolerance"] < 0 else float(group["tolerance"])


def _canonical(path: str | os.PathLike[str], allow_paths: bool) -> str:
    encoded = os.fsencode(FilePath("path").check(path))
    text: str = _native.run("scene canonical", path=encoded, allow_paths=allow_paths)["text"]
    return text


def _canonical_text(name: str, text: str) -> str:
    given = {"path": _native.letters("scene", name), "text": _native.letters("scene", text)}
    canonical: str = _native.run("scene canonical", **given)["text"]
    return canonical


def _grid(first: float, last: float, n: int, logarithmic: bool) -> FloatArray:
    """Values with equal steps or equal factors, identical to those of the driver."""
    found = _native.run(
        "scene grid", first=float(first), last=float(last), n=n, logarithmic=logarithmic
    )
    return np.asarray(found["values"])


def texts(value: str | list[str]) -> tuple[str, ...]:
    """Return the one or several texts of a key."""
    return (value,) if isinstance(value, str) else tuple(value)


def _of_speed(given: Mapping[str, Any], n: int) -> dict[str, Any]:
    """Matrices that depend on the speed of a rotor, and the speed."""
    matrices = {name: _matrix(given[name], n) for name in OF_SPEED if name in given}
    return {**matrices, "speed": given.get("speed")}


def _matrix(value: Any, n: int) -> FloatArray:
    """Return a matrix: n numbers are its diagonal, n^2 numbers its rows."""
    values = np.atleast_1d(np.asarray(value, dtype=float))
    return np.diag(values) if values.size == n else values.reshape(n, n)


def _kernel(group: Mapping[str, Any]) -> Kernel:
    given = {key: value for key, value in group.items() if key not in ("kind", "acts_on")}
    for key in _LISTS:
        if key in given:
            given[key] = np.atleast_1d(given[key])
    if group["kind"] == "fitted":
        # Load the modules of a fitted kernel only if there is one.
        fitted: Kernel = import_module("viscovib.rubber.scene_kernel").fitted_kernel(given)
        return fitted
    return _KERNELS[group["kind"]](**given)


def _elements(
    group: Mapping[str, Any], on: Any, kernel: Kernel | None, parameters: Mapping[str, float]
) -> list[Any]:
    """Build an element of a structure, and the hysteresis in parallel with it."""
    law, damping = group["law"].lower(), group["damping"]
    c, a, limit = (group[f"fluid_{name}"] for name in ("coefficient", "exponent", "limit"))
    if group["series_stiffness"]:
        return [Maxwell(on=on, stiffness=group["series_stiffness"], coefficient=c, exponent=a)]
    damper = ""
    if c and limit:
        damper = f"relief(v, {c!r}, {a!r}, {limit!r}, {group['fluid_relief']!r})"
    elif c and a != 1:
        damper = f"{c!r}*sign(v)*abs(v)^{a!r}"
    elif c:
        damping += c
    if damper:
        law = damper if law == "0" else f"({law}) + {damper}"
    spring = Spring(
        on=on,
        stiffness=group["stiffness"],
        damping=damping,
        law=None if law == "0" else law,
        parameters=named_in(group["law"], parameters) or None,
        kernel=kernel,
    )
    if group["hysteresis"] == "none":
        return [spring]
    numbers = np.atleast_1d(group["hysteresis_numbers"]).tolist()
    if group["hysteresis"] == "jenkins":
        return [spring, Iwan(on=on, stiffness=numbers[::2], limit=numbers[1::2])]
    kind: type[Any] = Dahl if group["hysteresis"] == "dahl" else BoucWen
    names = "limit" if kind is Dahl else "ratio beta gamma"
    own = zip(f"stiffness {names} exponent".split(), numbers, strict=False)
    return [spring, kind(on=on, **dict(own))]
