"""Files of structures: matrices with damping and names, and reduced models for the driver."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import shown
from viscovib.common.files import whole_file
from viscovib.common.parameters import FilePath
from viscovib.errors import FileError, InputError
from viscovib.systems.linear_model import damping_and_layers
from viscovib.systems.matrix_files import (
    arrays_of,
    content_of,
    put_matrix_market,
    read_matrix,
    sparse_of,
)
from viscovib.systems.structure_matrices import is_sparse, is_triangular

#: Format mark of a file.
_FORM = "viscovib structure 1"
_MATRICES = ("mass", "stiffness", "damping")
_SPARSE = ("data", "indices", "indptr")
#: Entries of a file in addition to the arrays of sparse matrices.
_PARTS = {
    *_MATRICES, "modal_damping", "rayleigh", "base_direction", "loss_factor", "names", "units",
    "supports",
}  # fmt: skip


def read_structure(mass: Any, stiffness: Any, damping: Any, options: dict[str, Any]) -> Any:
    """Return the arguments of a `Structure` from one file, or from one file for each matrix."""
    if stiffness is None:
        if damping is not None:
            raise InputError("damping: must not be given without a file of the stiffness")
        return _whole(Path(FilePath("mass").check(mass))) | options
    given = {"mass": mass, "stiffness": stiffness}
    if damping is not None:
        given["damping"] = damping
    matrices: dict[str, Any] = {}
    for name, path in given.items():
        matrices[name] = read_matrix(name, path)
        n, (own, columns) = matrices["mass"].shape[0], matrices[name].shape
        if own != columns:
            raise InputError(f"{name}: {path} is {own} x {columns}, must be square")
        if own != n:
            raise InputError(f"{name}: {path} has {own} rows, must have {n} as mass has")
        if is_triangular(matrices[name]):
            raise InputError(
                f"{name}: {path} has entries on one side of the diagonal only: store both "
                "triangles, or declare it symmetric; a coupling in one direction must be given as "
                "an array (Structure)"
            )
    return matrices | options


def _whole(file: Path) -> dict[str, Any]:
    from scipy.sparse import csc_array

    if file.suffix.lower() != ".npz":
        raise InputError(
            f"mass = {str(file)!r}: must end in .npz to contain a whole structure; give a file "
            "of the stiffness too"
        )
    try:
        parts = arrays_of("mass", file, content_of("mass", file))
    except MemoryError:
        raise InputError(f"mass: {file} does not fit into memory") from None
    if str(parts.pop("form", "")) != _FORM:
        raise FileError(f"mass: {file} contains no structure; was it written by Structure.write?")
    found: dict[str, Any] = {}
    for name in _MATRICES:
        own = {key: parts.pop(f"{name}.{key}") for key in _SPARSE if f"{name}.{key}" in parts}
        if not own:
            continue
        n = own["indptr"].size - 1 if "indptr" in own else 0
        try:
            found[name] = csc_array(sparse_of(own, "csc", (n, n)))
        except ValueError as error:
            why = " ".join(str(error).split())[:120]
            raise FileError(f"mass: {file} cannot be read ({name}: {why})") from None
    if unknown := sorted(parts.keys() - _PARTS):
        raise FileError(f"mass: {file} cannot be read (it contains {shown(unknown[0])})")
    for name, value in parts.items():
        found[name] = value.tolist() if value.dtype.kind == "U" or value.ndim == 0 else value
    if lacking := [name for name in ("mass", "stiffness") if name not in found]:
        raise FileError(f"mass: {file} cannot be read (it lacks {lacking[0]})")
    return found


def write_structure(
    structure: Any, path: str | os.PathLike[str], coordinates: Sequence[str] | None
) -> None:
    """Write a structure: see `Structure.write`."""
    file = Path(FilePath("path").check(path))
    ending = file.suffix.lower()
    if ending not in (".npz", ".mtx"):
        raise InputError(f"path = {str(path)!r}: must end in .npz or .mtx")
    if coordinates is not None and (structure._reduced is None or ending == ".npz"):
        raise InputError("coordinates: only a reduced structure in .mtx has some of them")
    if ending == ".npz":
        _write_whole(structure, file)
        return
    parts = {name: getattr(structure, name) for name in _MATRICES}
    if structure._held is not None:
        raise InputError(f"path = {str(path)!r}: supports have no matrix: must end in .npz")
    if structure._reduced is not None:
        parts = _reduced_parts(structure, coordinates)
    elif structure._uncoupled is not None:
        raise InputError(
            f"path = {str(path)!r}: modal damping, Rayleigh and loss factors have no matrix: must "
            "end in .npz"
        )
    # No file is moved to its final name before all are written: a mass alone is useless.
    with ExitStack() as all_written:
        for name, matrix in parts.items():
            named = isinstance(matrix, Named)
            one = file.with_name(f"{file.stem}_{name}.mtx")
            target = all_written.enter_context(whole_file(one, "wb"))
            put_matrix_market(
                target, matrix.array if named else matrix,
                "rows: " + " ".join(matrix.names) if named else "",
            )  # fmt: skip
            target.flush()


def _write_whole(structure: Any, file: Path) -> None:
    parts: dict[str, Any] = {"form": np.array(_FORM)}
    given = structure._given
    for name in _MATRICES:
        matrix = given[name]
        if is_sparse(matrix):
            parts |= {f"{name}.{k}": getattr(matrix, k) for k in ("data", "indices", "indptr")}
        else:
            parts[name] = matrix
    for name in ("modal_damping", "rayleigh", "base_direction"):
        value = given[name]
        if value is not None:
            parts[name] = np.asarray(value, dtype=float)
    parts["loss_factor"] = np.array(float(structure.loss_factor))
    parts["names"], parts["units"] = np.array(given["names"]), np.array(given["units"])
    if given["supports"]:
        parts["supports"] = np.array(given["supports"])
    with whole_file(file, "wb") as target:
        np.savez_compressed(target, **parts)  # type: ignore[arg-type]


def _reduced_parts(structure: Any, coordinates: Sequence[str] | None) -> dict[str, Any]:
    """Matrices in the reduced coordinates without the elements, and shapes of some coordinates."""
    reduced = structure._reduced
    found = reduced.reduction
    if structure._layers.whole:
        raise InputError("path: layers that relax have no file: must end in .npz")
    if found.static.shape[1]:
        raise InputError("path: loads on coordinates without mass have no modes: must end in .npz")
    shapes = found.shapes
    stiffness = np.diag(found.squares)
    damping, _ = damping_and_layers(reduced.model, found)
    touched = np.zeros(structure.n_coordinates, dtype=bool)
    for element in structure._all_elements:
        e = shapes.T @ element.direction
        stiffness = stiffness - element.powers.get(1, 0.0) * np.outer(e, e)
        damping = damping - element.damping * np.outer(e, e)
        touched |= element.direction != 0
    if coordinates is None:
        touched |= np.abs(reduced.loads).max(axis=1) > 1e-12
        places = np.flatnonzero(touched)
    else:
        places = structure._chosen(coordinates)
    # Rounding errors would couple the modes, and entries need memory.
    kept = [_cleaned(matrix) for matrix in (stiffness, damping)]
    names = [structure.dof_names[i] for i in places]
    return {
        "mass": np.eye(found.squares.size), "stiffness": kept[0], "damping": kept[1],
        "shapes": Named(shapes[places], names),
    }  # fmt: skip


def _cleaned(matrix: Any) -> Any:
    matrix = 0.5 * (matrix + matrix.T)
    size = np.sqrt(np.abs(np.outer(matrix.diagonal(), matrix.diagonal())))
    return np.where(np.abs(matrix) > 1e-15 * size, matrix, 0.0)


class Named(NamedTuple):
    """An array with names of its rows, which are written as a comment."""

    array: Any
    names: list[str]
