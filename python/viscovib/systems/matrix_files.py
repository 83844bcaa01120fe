"""Files of matrices: Matrix Market, Harwell-Boeing and .npz of NumPy."""

import io
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import mminfo, mmread, mmwrite
from scipy.sparse import bsr_array, coo_array, csc_array, csr_array, dia_array

from viscovib._native import shown
from viscovib.common.files import bytes_of
from viscovib.common.parameters import FilePath
from viscovib.errors import FileError, InputError
from viscovib.systems.sparse_pencil import MOST

#: Smallest number of characters of an entry in a text file: a digit and a separator.
_LEAST = 2
#: Largest size (bytes) of a file and of its arrays.
_LARGEST = 1 << 32
#: File name extensions of the formats.
MATRIX_MARKET, HARWELL_BOEING = (".mtx", ".mm"), (".rb", ".hb", ".rsa", ".rua", ".psa")
_ENDINGS = f"{', '.join((*MATRIX_MARKET, *HARWELL_BOEING))} or .npz"
#: Fortran's edit descriptors of numbers: repetitions, letter, width.
_FORMAT = re.compile(r"\(\s*(?:\d+P\s*,?\s*)?(\d*)([IEDFG])(\d+)(?:\.\d+)?(?:E\d+)?\s*\)", re.I)
#: Header of a Matrix Market file: kind, comments and size.
_HEAD = re.compile(rb"[^\n]*\n(?:[ \t]*(?:%[^\n]*)?\r?\n)*[^\n]*(?:\n|\Z)")
#: No possessive groups with backtracking inside: Python before 3.11.5 has a bug with them.
_WHOLE, _REAL = rb"[+-]?\d++", rb"[+-]?(?:\d++\.?\d*+|\.\d++)(?:[eEdD][+-]?\d++)?"
_PLACES = {"coordinate": rb"\d++[ \t]++\d++[ \t]++", "array": b""}
#: SciPy reads neither the exponent letter D of Fortran nor signs "+".
_EXPONENTS = bytes.maketrans(b"dD", b"ee")

#: Arrays of the sparse formats of SciPy: the values, then their indices.
_PARTS = {
    "csc": ("data", "indices", "indptr"),
    "csr": ("data", "indices", "indptr"),
    "bsr": ("data", "indices", "indptr"),
    "dia": ("data", "offsets"),
    "coo": ("data", "row", "col"),
}
_FORMATS: dict[str, Any] = {"csc": csc_array, "csr": csr_array, "bsr": bsr_array}
#: Exceptions of NumPy and zipfile for a damaged file.
_DAMAGED = (
    ValueError, KeyError, EOFError, TypeError, RuntimeError, SyntaxError, OverflowError,
    zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip


def read_matrix(name: str, path: str | os.PathLike[str]) -> Any:
    """Return the real matrix in a file as a csc_array.

    The extension selects the format: Matrix Market (.mtx, .mm), Harwell-Boeing (.rb, .hb, .rsa,
    .rua), or a file of `scipy.sparse.save_npz` (.npz).
    """
    file = Path(FilePath(name).check(path))
    ending = file.suffix.lower()
    if ending not in (*MATRIX_MARKET, *HARWELL_BOEING, ".npz"):
        raise InputError(f"{name} = {str(path)!r}: must end in {_ENDINGS}")
    try:
        content = content_of(name, file)
        if ending in MATRIX_MARKET:
            matrix = _matrix_market(name, file, content)
        elif ending == ".npz":
            matrix = _npz(name, file, content)
        else:
            matrix = _harwell_boeing(name, file, content)
    except MemoryError:
        raise InputError(f"{name}: {file} does not fit into memory") from None
    return csc_array(matrix)


def content_of(name: str, file: Path) -> bytes:
    """Return the content of a regular, non-empty file."""
    try:
        content = bytes_of(str(file), _LARGEST, "a file of matrices")
    except FileError as error:
        why = str(error).removeprefix(f"{file}: ")
        raise FileError(f"{name}: {file} {why}") from None
    if not content:
        raise FileError(f"{name}: {file} is empty")
    return content


def put_matrix_market(target: Any, matrix: Any, comment: str = "") -> None:
    """Write a matrix with all digits into an open file."""
    mmwrite(target, coo_array(matrix), comment=comment, precision=17)


def _matrix_market(name: str, file: Path, content: bytes) -> Any:
    try:
        rows, columns, entries, form, kind, symmetry = mminfo(io.BytesIO(content))
        if kind == "complex" or symmetry == "hermitian":
            raise InputError(f"{name}: {file} contains complex numbers, must be real")
        if kind == "pattern":
            raise InputError(f"{name}: {file} contains a pattern without values, must be real")
        if rows != columns:
            raise InputError(f"{name}: {file} is {rows} x {columns}, must be square")
        _check_size(rows, columns)
        if form == "array":
            entries = rows * columns if symmetry == "general" else rows * (rows - 1) // 2
        if _LEAST * entries > len(content):
            raise FileError(f"{name}: {file} is truncated: it declares {entries} entries")
        content = _checked(name, file, content, form, kind)
        one_triangle = form == "coordinate" and symmetry != "general"
        if one_triangle:
            content = content.replace(content.split(maxsplit=5)[4], b"general", 1)
        matrix = mmread(io.BytesIO(content), spmatrix=False)
        if one_triangle:
            matrix = _mirrored(name, file, csc_array(matrix), symmetry)
    except (ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        why = _first_line(error)
        if "runcated" in why:
            raise FileError(f"{name}: {file} is truncated") from None
        raise FileError(f"{name}: {file} is not a Matrix Market file ({why})") from None
    return matrix


def _mirrored(name: str, file: Path, stored: Any, symmetry: str) -> Any:
    """Return the full matrix of a file that stores each symmetric pair of entries once."""
    entries = stored.tocoo()
    row, column, values = entries.row, entries.col, entries.data
    off = (row != column) & (values != 0)
    n = np.int64(stored.shape[0])
    twice = np.intersect1d(column[off] * n + row[off], row[off] * n + column[off])
    if twice.size:
        j, i = (int(place) + 1 for place in divmod(twice[0], n))
        raise InputError(
            f"{name}: {file} is declared {symmetry} but stores both ({i}, {j}) and ({j}, {i}): "
            "store one triangle, or declare it general"
        )
    mirrored = values[off] if symmetry == "symmetric" else -values[off]
    places = np.append(row, column[off]), np.append(column, row[off])
    return csc_array((np.append(values, mirrored), places), shape=stored.shape)


def _checked(name: str, file: Path, content: bytes, form: str, kind: str) -> bytes:
    """Return a Matrix Market file after checking that each line is exactly one entry.

    SciPy ignores the part of a line that it cannot parse: it reads 3 from 3,5 and 1.0 from 1.0D3.
    If the last line ends in such a part, it reads beyond the end of the file.
    """
    head = _HEAD.match(content)
    start = head.end() if head else len(content)
    body = content[start:] + (b"" if content.endswith(b"\n") else b"\n")
    whole = "integer" in kind
    entry = _PLACES[form] + (_WHOLE if whole else _REAL)
    # Match a limited number of lines at a time, since each stores a backtracking position.
    lines = re.compile(rb"(?:[ \t]*+(?:" + entry + rb")?[ \t]*+(?:%[^\n]*+)?\r?\n){1,1000}")
    end = 0
    while sound := lines.match(body, end):
        end = sound.end()
    if end < len(body):
        line = body[end : body.index(b"\n", end)].decode("latin-1").strip()
        what = "a number" if form == "array" else "row, column and number"
        raise FileError(
            f"{name}: {file}, line {content[: start + end].count(bytes([10])) + 1}: "
            f"{shown(line)} must be {what}{' without a point' if whole else ''}"
        )
    if b"%" in body:
        body = re.sub(rb"%[^\n]*", b"", body)
    return content[:start] + body.translate(_EXPONENTS, b"+")


def arrays_of(name: str, file: Path, content: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of a .npz file; objects, which may run code, are refused."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as held:
            if sum(part.file_size for part in held.zip.infolist()) > _LARGEST:
                raise FileError(f"{name}: {file} holds more than {_LARGEST // 2**20} MB")
            return {part: held[part] for part in held.files}
    except _DAMAGED as error:
        raise FileError(f"{name}: {file} cannot be read ({_first_line(error)})") from None


def sparse_of(parts: Mapping[str, Any], form: str, shape: tuple[int, int]) -> Any:
    """Return a matrix from the checked arrays of a sparse format of SciPy.

    The constructors of SciPy accept indices outside the matrix, which cause a segmentation fault.
    Every error is a ValueError.
    """
    if form not in _PARTS:
        raise ValueError("it contains no sparse matrix")
    if lacking := [key for key in _PARTS[form] if key not in parts]:
        raise ValueError(f"it lacks {lacking[0]}")
    data, *indices = (parts[key] for key in _PARTS[form])
    if data.dtype.kind not in "iufb":
        raise ValueError(f"its numbers are of type {data.dtype}, must be real")
    for key, array in zip(_PARTS[form][1:], indices, strict=True):
        if array.dtype.kind not in "iu" or array.ndim != 1:
            raise ValueError(f"{key} must be whole numbers in a row")
    _check_size(*shape)
    data, indices = data.astype(float), [array.astype(np.int64) for array in indices]
    if form in ("csc", "csr", "bsr"):
        within, starts = indices
        if data.ndim != (3 if form == "bsr" else 1):
            raise ValueError(f"data has {data.ndim} dimensions")
        most = shape[0] if form == "csc" else shape[1]
        if form == "bsr":
            most //= max(data.shape[2], 1)
        if starts.size == 0 or starts[0] != 0 or (np.diff(starts) < 0).any():
            raise ValueError("indptr must begin with 0 and must not decrease")
        if within.min(initial=0) < 0 or within.max(initial=-1) >= most:
            raise ValueError("it has entries outside the matrix")
        return _FORMATS[form]((data, within, starts), shape=shape)
    if form == "dia":
        if np.abs(indices[0]).max(initial=0) > max(shape):
            raise ValueError("it has entries outside the matrix")
        return dia_array((data, indices[0]), shape=shape)
    return coo_array((data, tuple(indices)), shape=shape)


def _check_size(rows: int, columns: int) -> None:
    if min(rows, columns) < 1 or max(rows, columns) > MOST:
        raise ValueError(f"it is {rows} x {columns}, must have 1 to {MOST} rows")


def _npz(name: str, file: Path, content: bytes) -> Any:
    parts = arrays_of(name, file, content)
    try:
        form = parts["format"].item() if "format" in parts and parts["format"].size == 1 else ""
        form = form.decode("latin-1") if isinstance(form, bytes) else form
        shape = parts["shape"] if form in _PARTS and "shape" in parts else np.zeros(2, dtype=int)
        if shape.shape != (2,) or shape.dtype.kind not in "iu":
            raise ValueError("shape must be two whole numbers")
        if "coords" in parts and form == "coo":
            if parts["coords"].ndim != 2 or len(parts["coords"]) != 2:
                raise ValueError("coords must have two rows")
            parts |= dict(zip(("row", "col"), parts["coords"], strict=True))
        return csc_array(sparse_of(parts, form, (int(shape[0]), int(shape[1]))))
    except ValueError as error:
        raise FileError(f"{name}: {file} cannot be read ({_first_line(error)})") from None


def _harwell_boeing(name: str, file: Path, content: bytes) -> Any:
    """Read an assembled real matrix (Duff, Grimes and Lewis 1989), symmetric or not."""
    lines = content.decode("latin-1").splitlines()
    try:
        counts = [int(part) for part in _fields(lines[1], 14, 4)]
        kind = lines[2][:3].upper()
        rows, columns, entries = (int(part) for part in _fields(lines[2][14:], 14, 3))
        formats = [_FORMAT.fullmatch(part) for part in _split_formats(lines[3])]
    except (ValueError, IndexError):
        raise FileError(f"{name}: {file} is not a Harwell-Boeing file") from None
    if len(kind) != 3 or kind[0] not in "RCPI" or None in formats or len(formats) != 3:
        raise FileError(f"{name}: {file} is not a Harwell-Boeing file")
    if kind[0] != "R" or kind[1] not in "SUR" or kind[2] != "A":
        raise InputError(
            f"{name}: {file} is of type {kind}, must be real and assembled (RSA or RUA)"
        )
    if rows != columns:
        raise InputError(f"{name}: {file} is {rows} x {columns}, must be square")
    # With right-hand sides the header has one more line.
    start = 4 + (int(lines[1][56:70].strip() or 0) > 0)
    found = []
    for length, form, expected in zip(
        counts[1:4], formats, (columns + 1, entries, entries), strict=True
    ):
        assert form is not None
        values = _numbers(lines[start : start + length], int(form[3]))
        start += length
        if len(values) < expected:
            raise FileError(f"{name}: {file} is truncated")
        found.append(values[:expected])
    try:
        pointers, places = (np.array([int(v) for v in part]) - 1 for part in found[:2])
        entered = np.array([float(v.upper().replace("D", "E")) for v in found[2]])
    except ValueError as error:
        raise FileError(
            f"{name}: {file} contains a value that is not a number ({_first_line(error)})"
        ) from None
    sound = pointers[0] == 0 and pointers[-1] == entries and (np.diff(pointers) >= 0).all()
    if not sound or places.min(initial=0) < 0 or places.max(initial=0) >= rows:
        raise FileError(f"{name}: {file} has entries outside the matrix")
    matrix = csc_array((entered, places, pointers), shape=(rows, columns))
    if kind[1] == "S":
        matrix = _mirrored(name, file, matrix, "symmetric")
    return matrix


def _fields(line: str, width: int, count: int) -> list[str]:
    return [line[i * width : (i + 1) * width] for i in range(count)]


def _split_formats(line: str) -> list[str]:
    return [part.strip() for part in (line[:16], line[16:32], line[32:52])]


def _numbers(lines: list[str], width: int) -> list[str]:
    """Split lines into fields of fixed width, which may be without separators."""
    found = []
    for line in lines:
        line = line.rstrip()
        parts = [line[i : i + width].strip() for i in range(0, len(line), width)]
        found += [part for part in parts if part]
    return found


def _first_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]
