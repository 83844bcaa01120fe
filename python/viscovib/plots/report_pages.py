"""Report on a body and its mounts: one HTML page or PDF file."""

from __future__ import annotations

import base64
import html
import io
import math
import os
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.bodies.body import Body
from viscovib.common.files import whole_file
from viscovib.common.parameters import FilePath, Text
from viscovib.common.results import Axes, Figure
from viscovib.errors import InputError
from viscovib.kernels.relaxation import (
    AbelKernel,
    Kernel,
    PronyKernel,
    RabotnovKernel,
    RzhanitsynKernel,
)
from viscovib.kernels.time_temperature import ThermalKernel
from viscovib.plots.axes import plain_hertz
from viscovib.plots.bodies import (
    frequency_range,
    plot_body,
    plot_energy,
    plot_transmissibility,
)
from viscovib.plots.style import COLOURS, STYLES, plain
from viscovib.systems.laws import Law

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 64em; margin: 2em auto; padding: 0 1em }
table { border-collapse: collapse; margin: 0.5em 0 1.5em; font-size: 13px }
caption { text-align: left; font-weight: 600; padding: 0.3em 0; white-space: nowrap }
td.whole { white-space: nowrap }
th, td { border-bottom: 1px solid #ccc; padding: 0.2em 0.7em; text-align: right }
th:first-child, td:first-child { text-align: left }
img { max-width: 100% }
"""

#: Largest number of characters of kernel parameters; dots replace the rest.
_LONGEST = 110
#: Largest number of listed terms of a Prony series, and of real roots.
_TERMS, _REAL_ROOTS = 6, 6
#: A cell with at most this number of characters stays on one line.
_UNBROKEN = 48
#: A table: its caption, names of columns, and rows.
_Table = tuple[str, list[str], list[list[str]]]


def report(
    body: Body,
    path: str | os.PathLike[str],
    *,
    title: str = "A body on its mounts",
    load: npt.ArrayLike | None = None,
    hz: npt.ArrayLike | None = None,
    axis: str = "z",
    torque_about: str | npt.ArrayLike | None = None,
    variants: Sequence[Body] = (),
    orders: Mapping[float, npt.ArrayLike] | None = None,
    rpm: npt.ArrayLike | None = None,
) -> None:
    """Write data, modes, energies, static deflection, transmissibility and mount forces as a page.

    Parameters
    ----------
    body : Body
    path : str or path
        A file with the ending ``.html`` (one file with its pictures) or ``.pdf``.
    title : str
    load : array_like, shape (n,), optional
        Amplitudes of a harmonic load (`Body.load`), for the mount forces, linear; None: 1 N along
        ``axis``.
    hz : array_like, optional
        Frequencies (Hz); by default from a third of the lowest mode to four times the highest.
    axis : "x", "y" or "z"
        Direction of the floor's motion, for the transmissibility.
    torque_about : "x", "y", "z" or array_like, shape (3,), optional
        Axis of the torque, for the torque-roll axis.
    variants : sequence of Body, optional
        Bodies with other numbers, such as kernels of `KernelFit.samples`: the transmissibility has
        the band that contains 95 % of them.
    orders : mapping, optional
        Amplitudes of loads (`Body.load`) by engine order: {0.5: ..., 2: ...}.
    rpm : array_like, optional
        Speeds for ``orders`` (revolutions per minute).

    Raises
    ------
    InputError
        If the file has a different ending, or if the static equilibrium is unstable.

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, -0.1), stiffness=(1e5, 1e5, 2e5),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> vv.report(vv.Body(mass=10, inertia=(0.1, 0.1, 0.1), mounts=[foot]), "pump.html")
    """
    _native.check_instance("body", body, Body)
    place, title = Path(FilePath("path").check(path)), Text("title").check(title)
    if place.suffix.lower() not in (".html", ".pdf"):
        raise InputError(f"path = {str(place)!r}: must end in .html or .pdf")
    frequencies = frequency_range(body, hz)
    push = body.load(np.eye(3)["xyz".index(_native.choice("axis", axis, ("x", "y", "z")))])
    if load is not None:
        push = _native.complex_array("load", load)
        if push.shape != (len(body.dof_names),):
            raise InputError(f"load: must have shape ({len(body.dof_names)},), got {push.shape}")
    if not isinstance(variants, (list, tuple)):
        raise InputError(f"variants = {_native.shown(variants)}: must be a list of bodies")
    for i, one in enumerate(variants):
        _native.check_instance(f"variants[{i}]", one, Body)
    tables = _tables(body, torque_about)
    pictures: list[tuple[str, Callable[[Any], object], bool]] = [
        ("The body", lambda ax: plot_body(body, ax, torque_about=torque_about), True),
        ("Kinetic energies", lambda ax: plot_energy(body.modes(), ax), False),
        (
            "Transmissibility" + f", with the band of {len(variants)} variants" * bool(variants),
            lambda ax: _plot_transmissibility(body, ax, frequencies, axis, variants),
            False,
        ),
        (
            f"Mount forces under a load of {_load(body, push) or '0'}, linear",
            lambda ax: _plot_forces(body, ax, frequencies, push),
            False,
        ),
    ]
    if orders is not None or rpm is not None:
        speeds, loads = _orders(body, orders, rpm)
        pictures.append(
            (
                f"Engine orders: displacement along {axis}, linear",
                lambda ax: _plot_orders(body, ax, speeds, loads, "xyz".index(axis)),
                False,
            )
        )
    foot = f"viscovib {version('viscovib')}. SI units and rad unless stated."
    if place.suffix.lower() == ".html":
        _write_html(place, title, tables, pictures, foot)
    else:
        _write_pdf(place, title, tables, pictures, foot)


def _tables(body: Body, torque_about: str | npt.ArrayLike | None) -> list[_Table]:
    inertia = body.inertia
    data = [
        ["mass", f"{body.body_mass:.6g} kg"],
        ["moments of inertia xx, yy, zz", _row(np.diag(inertia)) + " kg m²"],
        [
            "products of inertia xy, xz, yz (as a tensor)",
            _row(inertia[[0, 0, 1], [1, 2, 2]]) + " kg m²",
        ],
        ["centre of mass", _row(body.center) + " m"],
    ]
    try:
        stiff, soft = body.centers()
        data.append(["centre of stiffness", _row(stiff, 4) + " m"])
        data.append(["centre of compliance", _row(soft, 4) + " m"])
    except InputError as error:
        data.append(["centres of stiffness and compliance", str(error)])
    if torque_about is not None:
        data.append(["torque-roll axis", _row(body.torque_roll_axis(torque_about), 4)])
    mounts = [
        [
            mount.name, _row(np.asarray(mount.position)), _row(np.rad2deg(_angles(mount.rotation))),
            _row(mount._elastic), _row(np.asarray(mount.damping)),
            ", ".join(dict.fromkeys(_kernel(kernel) for kernel in mount.kernels)),
            _law(mount.laws),
        ]
        for mount in body.mounts
    ]  # fmt: skip
    tables: list[_Table] = [
        ("Body", ["", ""], data),
        (
            "Mounts",
            ["name", "position (m)", "angles (degrees)", "stiffness (N/m)", "damping (N s/m)",
             "memory", "law (N, d in m)"],
            mounts,
        ),
    ]  # fmt: skip
    if memory := _memory(body):
        head = ["kernel", "relaxation kernel, t in s", "temperature", "integral", "mounts"]
        tables.append(("Memory of the mounts", head, memory))
    if further := _further(body):
        tables.append(("Further data of the mounts", ["", ""], further))
    if body.gravity is not None:
        sag = body.sag()
        rows = [
            [mount.name, _row(1e3 * d, 4), _row(f, 4)]
            for mount, d, f in zip(body.mounts, sag.deflections, sag.forces, strict=True)
        ]
        moved = (
            f"Sag: x, y, z {_row(1e3 * sag.displacement[:3], 4)} mm; "
            f"rx, ry, rz {_row(np.rad2deg(sag.displacement[3:6]), 4)} degrees"
        )
        tables.append((moved, ["mount", "deflection (mm)", "force on the body (N)"], rows))
    modes = body.modes()
    shares = (
        [] if torque_about is None else [f"{share:.1f}" for share in body.roll_share(torque_about)]
    )
    rows = [
        [
            f"{r + 1}", f"{modes.hz[r]:.4f}", f"{100 * modes.damping_ratio[r]:.2f}",
            f"{modes.loss_factor[r]:.4f}",
            *(f"{share:.2f}" for share in modes.energy[:, r]), f"{modes.decoupling[r]:.1f}",
            *shares[r : r + 1],
        ]
        for r in range(modes.omega.size)
    ]  # fmt: skip
    damped = np.iscomplexobj(modes.shapes)
    head = [
        "mode",
        "Hz",
        "damping (%)",
        "loss factor",
        *(f"{name} (%)" for name in modes.names),
        "decoupling (%)",
    ]
    caption = f"{'Damped modes' if damped else 'Modes'} and kinetic energies"
    tables.append((caption, head + ["roll (%)"] * bool(shares), rows))
    if damped or any(np.any(np.asarray(mount.damping)) for mount in body.mounts):
        head = ["root", "Re s (1/s)", "Im s (rad/s)", "Hz", "damping (%)", "log. decrement"]
        tables.append(("Damped roots s of free motions exp(s t)", head, _roots(body)))
    return tables


def _roots(body: Body) -> list[list[str]]:
    """Return a row for each damped root, oscillatory ones first."""
    found = body.characteristic_roots()
    rows = [
        [
            f"{j}", f"{s.real:.5g}", f"{s.imag:.5g}", f"{s.imag / (2 * math.pi):.4f}",
            f"{-100 * s.real / abs(s):.2f}", f"{-2 * math.pi * s.real / s.imag:.4g}",
        ]
        for j, s in enumerate(found.oscillatory, 1)
    ]  # fmt: skip
    return rows + [["real", f"{s:.5g}", "0", "", "", ""] for s in found.real[:_REAL_ROOTS]]


def _row(values: npt.ArrayLike, digits: int = 6) -> str:
    return ", ".join(f"{value:.{digits}g}" for value in np.asarray(values) + 0.0)


def _load(body: Body, load: Any) -> str:
    """Return the amplitudes of a load with their units."""
    turns = ("rx", "ry", "rz")
    return ", ".join(
        f"{name} {abs(push):.4g} {'N m' if name in turns else 'N'}"
        for name, push in zip(body.dof_names, np.asarray(load), strict=True)
        if push
    )


def _angles(rotation: npt.NDArray[np.float64]) -> list[float]:
    """Return the angles of Rz Ry Rx about x, y and z (rad)."""
    return [
        math.atan2(rotation[2, 1], rotation[2, 2]),
        -math.asin(max(-1.0, min(1.0, float(rotation[2, 0])))),
        math.atan2(rotation[1, 0], rotation[0, 0]),
    ]


def _kernel(kernel: object) -> str:
    if isinstance(kernel, ThermalKernel):
        return f"{_kernel(kernel.kernel)} at {kernel.temperature:g} deg C"
    return "none" if kernel is None else type(kernel).__name__.removesuffix("Kernel")


def _memory(body: Body) -> list[list[str]]:
    """Return each kernel with its law, its temperature, its integral and its mounts."""
    users: dict[str, tuple[Kernel, list[str]]] = {}
    for mount in body.mounts:
        for kernel in mount.kernels:
            if kernel is not None:
                names = users.setdefault(repr(kernel), (kernel, []))[1]
                if mount.name not in names:
                    names.append(mount.name)
    rows = []
    for kernel, names in users.values():
        inner, at = kernel, ""
        if isinstance(kernel, ThermalKernel):
            inner = kernel.kernel
            at = f"{kernel.temperature:g} deg C, {kernel.shift!r}, a_T = {kernel.slowness:.5g}"
        law = _kernel_law(inner) + ("; at a_T: R(t/a_T)/a_T" if at else "")
        rows.append([_kernel(inner), law, at, f"{kernel.integral:.6g}", ", ".join(names)])
    return rows


def _kernel_law(kernel: Kernel) -> str:
    """Return R(t) with its numbers."""
    if isinstance(kernel, (RzhanitsynKernel, AbelKernel, RabotnovKernel)):
        numbers = f"A = {kernel.amplitude:.6g}, alpha = {kernel.alpha:.6g}"
        if isinstance(kernel, AbelKernel):
            return f"A t^(alpha-1), {numbers}"
        numbers += f", beta = {kernel.beta:.6g}"
        if isinstance(kernel, RabotnovKernel):
            return f"A t^(alpha-1) E_alpha,alpha(-beta t^alpha), {numbers}"
        return f"A exp(-beta t) t^(alpha-1), {numbers}"
    if isinstance(kernel, PronyKernel):
        pairs = zip(np.asarray(kernel.weights), np.asarray(kernel.rates), strict=True)
        terms = [f"{w:.4g} exp(-{r:.4g} t)" for w, r in pairs]
        more = f" + ... ({len(terms)} terms)" if len(terms) > _TERMS else ""
        return " + ".join(terms[:_TERMS]) + more
    text = repr(kernel)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def _further(body: Body) -> list[list[str]]:
    """Return properties that few mounts have: rotational stiffness, fluid tracks."""
    lines: list[list[str]] = []
    for mount in body.mounts:
        if np.any(np.asarray(mount.rotational_stiffness)):
            size = _row(np.asarray(mount.rotational_stiffness))
            lines.append([f"{mount.name}: rotational stiffness", f"{size} N m/rad"])
        if mount.track is not None:
            track = mount.track
            size = f"{track.mass:.6g} kg, {track.damping:.6g} N s/m, {track.stiffness:.6g} N/m"
            lines.append([f"{mount.name}: fluid track along {'xyz'[track.axis]}", size])
    return lines


def _law(laws: tuple[dict[int, float] | Law, ...]) -> str:
    texts = [
        f"{axis}: "
        + (
            law.text
            if isinstance(law, Law)
            else " + ".join(f"{c:.4g} d^{p}" for p, c in law.items())
        )
        for axis, law in zip("xyz", laws, strict=True)
        if law
    ]
    return "; ".join(texts) or "linear"


def _plot_transmissibility(
    body: Body, ax: Axes, hz: npt.NDArray[np.float64], axis: str, variants: Sequence[Body]
) -> None:
    """Draw the transmissibility and, along the axis, the band of the variants behind it."""
    plot_transmissibility(body, ax, hz=hz, axis=axis)
    if not variants:
        return
    place, omega = "xyz".index(axis), 2 * math.pi * hz
    answers = np.abs([one.base_transmissibility(omega, axis, None)[:, place] for one in variants])
    with np.errstate(divide="ignore"):
        low, high = 20 * np.log10(np.quantile(answers, (0.025, 0.975), axis=0))
    label = f"{axis}, 95 % of the variants"
    ax.fill_between(hz, low, high, color=COLOURS[place], alpha=0.2, lw=0, label=label)
    ax.legend(frameon=False)


def _orders(
    body: Body, orders: Mapping[float, npt.ArrayLike] | None, rpm: npt.ArrayLike | None
) -> tuple[npt.NDArray[np.float64], dict[float, Any]]:
    """Check the speeds (1/min) and the loads of engine orders."""
    if orders is None or rpm is None:
        raise InputError("orders, rpm: must be given together")
    if not isinstance(orders, Mapping) or not orders:
        raise InputError(
            f"orders = {_native.shown(orders)}: must be a mapping of orders to loads, such as "
            "{2: body.load(torque=(0, 100, 0))}"
        )
    speeds = _native.real_array("rpm", rpm, ndim=1)
    if speeds.size < 2 or not speeds[0] > 0 or not (np.diff(speeds) > 0).all():
        raise InputError("rpm: must be two or more positive speeds, ascending")
    loads = {}
    for order, load in orders.items():
        loads[_native.number("orders", order)] = _native.complex_array(f"orders[{order}]", load)
    body.engine_orders(speeds[:1], list(loads), list(loads.values()))
    return speeds, loads


def _plot_orders(
    body: Body, ax: Axes, rpm: npt.NDArray[np.float64], loads: Mapping[float, Any], place: int
) -> None:
    """Draw the displacement of each order over the speed, and the root mean square of all."""
    found = body.engine_orders(2 * math.pi * rpm / 60, list(loads), list(loads.values()))
    sizes = np.abs(found[:, :, place])
    for i, order in enumerate(loads):
        ax.plot(
            rpm, sizes[:, i], color=COLOURS[i % len(COLOURS)], linestyle=STYLES[i % len(STYLES)],
            label=f"order {order:g}",
        )  # fmt: skip
    ax.plot(rpm, np.hypot.reduce(sizes, axis=1) / math.sqrt(2), color="0.5", label="rms of all")
    ax.set(xlabel="speed (1/min)", ylabel="displacement (m)", xlim=(rpm[0], rpm[-1]))
    ax.set_ylim(0, None)
    ax.legend(frameon=False)


def _plot_forces(body: Body, ax: Axes, hz: npt.NDArray[np.float64], load: Any) -> None:
    """Draw the size of the linear force at each mount."""
    from viscovib.analyses.forced import forced_response

    result = forced_response(body, 2 * math.pi * hz, load=load, method="linear")
    forces = body.mount_forces(result)
    # A load of 0 has no order; squares of large forces would overflow.
    sizes = np.hypot.reduce(np.abs(forces.force[..., :1]).sum(axis=3), axis=2)
    for i, name in enumerate(forces.names):
        ax.plot(
            hz, sizes[:, i], color=COLOURS[i % len(COLOURS)], linestyle=STYLES[i % len(STYLES)],
            label=name,
        )  # fmt: skip
    ax.set_xscale("log")
    if np.any(sizes >= np.finfo(float).tiny):
        ax.set_yscale("log")
    ax.set_xlim(hz[0], hz[-1])
    ax.set_xlabel("frequency (Hz)")
    ax.set_ylabel("force, first order (N)")
    ax.legend(frameon=False)
    plain_hertz(ax)


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    if height > width:
        # A sheet of paper, with margins for punched holes.
        figure.set_layout_engine("constrained", rect=(0.06, 0.04, 0.88, 0.92))
    return figure


def _write_html(
    path: Path, title: str, tables: list[_Table], pictures: list[Any], foot: str
) -> None:
    parts = [f"<h1>{html.escape(title)}</h1>"]
    for caption, head, rows in tables:
        cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
        lines = [f"<tr>{cells}</tr>"] if any(head) else []
        for row in rows:
            lines.append("<tr>" + "".join(map(_cell, row)) + "</tr>")
        body = "".join(lines)
        parts.append(f"<table><caption>{html.escape(caption)}</caption>{body}</table>")
    for caption, draw, in_space in pictures:
        figure = _figure(7.5, 5.5 if in_space else 4)
        draw(figure.add_subplot(projection="3d" if in_space else None))
        data = io.BytesIO()
        figure.savefig(data, format="png", dpi=110)
        text, escaped = base64.b64encode(data.getvalue()).decode(), html.escape(caption)
        parts.append(f"<h2>{escaped}</h2><img alt='{escaped}' src='data:image/png;base64,{text}'>")
    page = (
        "<!doctype html><html lang='en'><meta charset='utf-8'>"
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style>{''.join(parts)}"
        f"<p>{html.escape(foot)}</p></html>\n"
    )
    with whole_file(path, "w") as file:
        file.write(page)


def _cell(text: str) -> str:
    # Cells with three numbers stay on one line.
    whole = " class='whole'" if len(text) <= _UNBROKEN else ""
    return f"<td{whole}>{html.escape(text)}</td>"


def _write_pdf(
    path: Path, title: str, tables: list[_Table], pictures: list[Any], foot: str
) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    with whole_file(path, "wb") as file, PdfPages(file) as pages:
        pages.savefig(_page_of_tables(title, tables, foot))
        second = _figure(8.27, 11.69)
        heights = [2.0 if in_space else 1.0 for _, _, in_space in pictures]
        grid = second.add_gridspec(len(pictures), 1, height_ratios=heights)
        for place, (caption, draw, in_space) in enumerate(pictures):
            axis = second.add_subplot(grid[place], projection="3d" if in_space else None)
            draw(axis)
            axis.set_title(caption, fontsize=9)
            if not in_space:
                # Labels of normal size would be longer than these low panels.
                axis.yaxis.label.set_fontsize(7)
        pages.savefig(second)


def _page_of_tables(title: str, tables: list[_Table], foot: str) -> Figure:
    page = _figure(8.27, 11.69)
    page.set_layout_engine("constrained", rect=(0.06, 0.04, 0.88, 0.90))
    page.suptitle(plain(title), y=0.975)
    heights = [len(rows) + 2.5 for _, _, rows in tables]
    axes = page.subplots(len(tables) + 1, 1, height_ratios=[*heights, max(40 - sum(heights), 0.1)])
    axes[-1].axis("off")
    for axis, (caption, head, rows) in zip(axes, tables, strict=False):
        axis.axis("off")
        axis.set_title(caption, loc="left", fontsize=9)
        lines = [head, *rows] if any(head) else rows
        widths = [max(len(line[c]) for line in lines) + 2 for c in range(len(head))]
        full = max(sum(widths), 80)
        table = axis.table(lines, colWidths=[w / full for w in widths], loc="upper left")
        table.auto_set_font_size(False)
        table.set_fontsize(7 if full < 120 else 5.5)
        table.scale(1, 1.1)
        for (_, column), cell in table.get_celld().items():
            cell.set_linewidth(0.3)
            if column == 0:
                cell.set_text_props(ha="left")
                cell.PAD = 1.0 / widths[0]
    page.supxlabel(foot, fontsize=7)
    return page
