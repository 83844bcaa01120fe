"""Readers and writers of matrices: valid data are read back, other files give one line."""

import re

import numpy as np
import pytest
import viscovib as vv
from models_of_structures import write_matrix
from scipy.sparse import csc_array, eye_array, random_array, save_npz
from viscovib.systems.matrix_files import read_matrix

HARWELL = """\
A small stiffness                                                       KEY     
             4             1             1             2             0
RSA                        3             3             5             0
(4I3)           (5I3)           (3E12.4)            
  1  3  5  6
  1  2  2  3  3
  2.0000E+00 -1.0000E+00  2.0000D+00
 -1.0000E+00  1.5000E+00
"""
FULL = [[2.0, -1, 0], [-1, 2, -1], [0, -1, 1.5]]


@pytest.mark.parametrize("ending", [".mtx", ".npz"])
def test_what_is_written_comes_back_bit_for_bit(tmp_path, ending):
    rng = np.random.default_rng(3)
    for symmetric in (False, True):
        matrix = csc_array(random_array((30, 30), density=0.2, rng=rng))
        matrix = matrix + matrix.T if symmetric else matrix
        write_matrix(tmp_path / f"k{ending}", matrix)
        found = read_matrix("stiffness", tmp_path / f"k{ending}")
        assert (found != matrix).nnz == 0


def test_harwell_boeing(tmp_path):
    file = tmp_path / "k.rsa"
    file.write_text(HARWELL)
    np.testing.assert_array_equal(read_matrix("stiffness", file).toarray(), FULL)
    file.write_text(HARWELL.replace("RSA", "RUA"))
    np.testing.assert_array_equal(read_matrix("stiffness", file).toarray(), np.tril(FULL))


def test_fields_of_harwell_boeing_may_touch(tmp_path):
    file = tmp_path / "k.rsa"
    text = HARWELL.replace(
        "  2.0000E+00 -1.0000E+00  2.0000D+00\n -1.0000E+00  1.5000E+00\n",
        " 2.0000E+00-1.0000E+00 2.0000E+00\n-1.0000E+00 1.5000E+00\n",
    ).replace("(3E12.4)", "(3E11.4)")
    file.write_text(text)
    np.testing.assert_array_equal(read_matrix("stiffness", file).toarray(), FULL)


BANNER = "%%MatrixMarket matrix coordinate real general\n"
WRONG = {
    "a.mtx": {
        "": "is empty",
        "hello\n": "is not a Matrix Market file",
        BANNER + "2 2 3\n1 1 1.0\n2 2 1.0\n": "is truncated",
        BANNER + "2 2 300000000000\n1 1 1.0\n": "is truncated: it declares 300000000000 entries",
        BANNER + "2000000 2000000 1\n1 1 1.0\n": "it is 2000000 x 2000000, must have 1 to 1000000",
        BANNER + "2 3 1\n1 1 1.0\n": "is 2 x 3, must be square",
        BANNER + "2 2 1\n3 1 1.0\n": "is not a Matrix Market file",
        BANNER + "2 2 1\n1 1 x\n": "a.mtx, line 3: '1 1 x' must be row, column and number",
        BANNER + "2 2 1\n1 1 3,5\n": "a.mtx, line 3: '1 1 3,5' must be",
        BANNER + "%\n2 2 2\n1 1 1\n2 2 0x10\n": "a.mtx, line 5: '2 2 0x10' must be",
        BANNER.replace("real", "integer") + "2 2 1\n1 1 1.5\n": "number without a point",
        BANNER.replace("coordinate", "array") + "1 1\n3,5\n": "line 3: '3,5' must be a number",
        BANNER.replace("real", "complex") + "1 1 1\n1 1 1 2\n": "contains complex numbers",
        BANNER.replace("real", "pattern") + "1 1 1\n1 1\n": "a pattern without values",
    },
    "a.rsa": {
        "": "is empty",
        "hello\n": "is not a Harwell-Boeing file",
        HARWELL.replace("RSA", "CSA"): "is of type CSA, must be real and assembled",
        HARWELL.replace("RSA", "PSA"): "is of type PSA, must be real",
        HARWELL.replace("RSA", "RSE"): "is of type RSE, must be real",
        HARWELL.replace("  1  2  2  3  3", "  1  2  1  2  3"): "stores both (2, 1) and (1, 2)",
        HARWELL[:-14]: "is truncated",
        HARWELL.replace("1.5000", "1.5x00"): "contains a value that is not a number",
        HARWELL.replace("  1  2  2  3  3", "  1  2  2  3  4"): "has entries outside the matrix",
    },
    "a.npz": {"": "is empty", "hello\n": "cannot be read"},
}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [(name, text, said) for name, cases in WRONG.items() for text, said in cases.items()],
)
def test_wrong_files(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(vv.ViscovibError, match=re.escape(message)) as caught:
        read_matrix("mass", tmp_path / name)
    assert str(caught.value).startswith("mass: ")
    assert "\n" not in str(caught.value)


def entry(rng):
    """A word that is a number or nearly a number; its value, or None."""
    sound = f"{rng.choice(['', '-', '+'])}{rng.integers(1, 99)}{rng.choice(['', '.', '.5', '.25'])}"
    sound += rng.choice(["", "", "e3", "E-2", "D+1", "d2"])
    spoil = rng.choice(["", "", "", "x", ",5", "e", "&.0C", " 5", "_0", "D", "f0", ".5.5"])
    whole = sound + spoil
    try:
        return whole, float(whole.lower().replace("d", "e").replace("_", "x").replace("f", "x"))
    except ValueError:
        return whole, None


def test_a_line_is_an_entry_or_refused(tmp_path):
    """No part of a number, and no data after the end of a file without a final line end."""
    rng = np.random.default_rng(45)
    file = tmp_path / "a.mtx"
    refused = 0
    for i in range(300):
        word, value = entry(rng)
        end = rng.choice(["", "\n", "\r\n", "\n\n", " \n"])
        if i % 2:
            file.write_text(f"{BANNER}% by a program\n2 2 2\n1 1 1.0\n% 2\n2 2 {word}{end}")
        else:
            file.write_text(f"{BANNER.replace('coordinate', 'array')}2 2\n1\n0\n0\n{word}{end}")
        if value is None:
            refused += 1
            with pytest.raises(vv.FileError, match=r"a\.mtx, line 6: "):
                read_matrix("mass", file)
        else:
            assert read_matrix("mass", file).toarray()[1, 1] == value, word
    assert 50 < refused < 250


def test_each_pair_of_a_symmetric_file_is_stored_once(tmp_path):
    """In either triangle; a pair in both is refused, because the sum would double the entry."""
    rng = np.random.default_rng(7)
    file = tmp_path / "k.mtx"
    for i in range(20):
        word, sign = (("symmetric", 1), ("skew-symmetric", -1))[i % 2]
        n = int(rng.integers(2, 8))
        below = np.tril(rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.6), -1)
        below[1, 0] = 0.5
        full = below + sign * below.T + np.diag(rng.normal(size=n)) * (sign + 1)
        swap = rng.random((n, n)) < 0.5
        one = np.where(swap, np.tril(full), 0) + np.triu(full) * ~swap.T
        for stored in (one, full):
            places = np.argwhere(stored)
            text = [f"%%MatrixMarket matrix coordinate real {word}", f"{n} {n} {len(places)}"]
            text += [f"{i + 1} {j + 1} {float(stored[i, j])!r}" for i, j in places.tolist()]
            file.write_text("\n".join(text))
            if stored is one:
                np.testing.assert_array_equal(read_matrix("stiffness", file).toarray(), full)
                continue
            with pytest.raises(vv.InputError, match=r"stores both \(\d, \d\) and .* one triangle"):
                read_matrix("stiffness", file)


def test_npz_of_something_else(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.eye(2))
    with pytest.raises(vv.FileError, match=r"mass: .*a.npz cannot be read"):
        read_matrix("mass", tmp_path / "a.npz")
    save_npz(tmp_path / "b.npz", csc_array(np.eye(2)))
    whole = (tmp_path / "b.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(vv.FileError, match=r"mass: .*b.npz cannot be read"):
        read_matrix("mass", tmp_path / "b.npz")


FORMATS = ("csc", "csr", "coo", "bsr", "dia")


def damaged(rng, parts):
    """Change one array of a .npz file: an entry, its type, its length or its dimensions."""
    key = str(rng.choice(sorted(parts)))
    array = parts[key].copy()
    how = rng.integers(6)
    if how < 3 and array.size and array.dtype.kind in "iuf":
        array.reshape(-1)[rng.integers(array.size)] = rng.choice([-5, -1, 7, 99, 10**6, 2**30])
    elif how == 3 and array.dtype.kind in "iuf":
        array = array.astype(rng.choice(["f8", "c16", "i1", "u8", ">i8", "U3", "f2"]))
    elif how == 4:
        array = array.reshape(-1)[: array.size // 2]
    elif how == 5:
        array = array[np.newaxis]
    return parts | {key: array}


@pytest.mark.filterwarnings("ignore:stiffness. has entries on one side")
def test_a_damaged_matrix_is_read_whole_or_refused(tmp_path):
    """Indices outside the matrix, other types and lengths: one line, or existing entries."""
    rng = np.random.default_rng(11)
    file = tmp_path / "k.npz"
    refused = 0
    for i in range(200):
        n = int(rng.integers(2, 7))
        matrix = random_array((n, n), density=0.4, rng=rng) + eye_array(n)
        whole = i % 3 == 0
        if whole:
            vv.Structure(mass=eye_array(n, format="csc"), stiffness=csc_array(matrix)).write(file)
        else:
            save_npz(file, matrix.asformat(FORMATS[i % 5]))
        with np.load(file) as held:
            parts = {key: held[key] for key in held.files}
        np.savez(file, **damaged(rng, parts))
        try:
            found = vv.Structure.read(file).stiffness if whole else read_matrix("stiffness", file)
        except vv.ViscovibError:
            refused += 1
        else:
            found = csc_array(found)
            assert found.dtype == float
            assert found.indices.min(initial=0) >= 0
            assert found.indices.max(initial=0) < found.shape[0]
            assert (np.diff(found.indptr) >= 0).all()
    assert 50 < refused < 180


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"indices": np.array([0, -5])}, "it has entries outside the matrix"),
        ({"indices": np.array([0.0, 1.0])}, "indices must be whole numbers in a row"),
        ({"indptr": np.array([0, 5, 0])}, "indptr must begin with 0 and must not decrease"),
        ({"data": np.array(["a", "b"])}, "its numbers are of type <U1, must be real"),
        ({"shape": np.array([2_000_000, 2])}, "it is 2000000 x 2, must have 1 to 1000000 rows"),
        ({"shape": np.array(2)}, "shape must be two whole numbers"),
        ({"format": np.array("lil")}, "it contains no sparse matrix"),
    ],
)
def test_arrays_of_a_matrix_are_checked(tmp_path, change, message):
    parts = {
        "format": np.array("csc"), "shape": np.array([2, 2]), "data": np.ones(2),
        "indices": np.array([0, 1]), "indptr": np.array([0, 1, 2]),
    }  # fmt: skip
    np.savez(tmp_path / "k.npz", **parts)
    np.testing.assert_array_equal(read_matrix("mass", tmp_path / "k.npz").toarray(), np.eye(2))
    np.savez(tmp_path / "k.npz", **(parts | change))
    with pytest.raises(vv.FileError, match=re.escape(message)):
        read_matrix("mass", tmp_path / "k.npz")
    np.savez(tmp_path / "k.npz", **parts, colour=np.eye(2), form=np.array("viscovib structure 1"))
    with pytest.raises(vv.FileError, match="cannot be read"):
        vv.Structure.read(tmp_path / "k.npz")


def test_missing_files_and_other_names(tmp_path):
    with pytest.raises(vv.FileError, match=r"mass: .*none.mtx cannot be read \(No such file"):
        read_matrix("mass", tmp_path / "none.mtx")
    with pytest.raises(vv.InputError, match=r"mass = '.*k.txt': must end in \.mtx"):
        read_matrix("mass", "k.txt")
    (tmp_path / "d.mtx").mkdir()
    with pytest.raises(vv.FileError, match=r"mass: .*d.mtx cannot be read \(Is a directory\)"):
        read_matrix("mass", tmp_path / "d.mtx")
