"""Matrices and vectors in files: MatrixMarket, npz, npy and text are read exactly, or refused in words."""

from __future__ import annotations

import io
import os
import struct
import tracemalloc
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmwrite

from agglo_core import FileError, OptionError, Pipeline, samples
from agglo_core.files.archive import Archive
from agglo_core.files.matrix_market import read_matrix_market
from agglo_core.files.stored_matrices import read_matrix, read_vectors
from agglo_core.files.text_numbers import number_rows
from agglo_core.io.system_files import read_system, write_system
from agglo_core.problems import Linear, System, named_problem, read_problem

HEAD = "%%MatrixMarket matrix "
MATRICES = {
    "real": ("coordinate real general\n2 3 3\n1 1 1.5\n2 3 -2e-1\n2 1 4\n", [[1.5, 0, 0], [4, 0, -0.2]]),
    "double": ("coordinate double general\n1 1 1\n1 1 0.1D1\n", [[1]]),
    "integer": ("coordinate integer general\n2 2 2\n1 2 7\n2 1 -8\n", [[0, 7], [-8, 0]]),
    "pattern": ("coordinate pattern general\n2 2 2\n1 2\n2 2\n", [[0, 1], [0, 1]]),
    "entries in pieces": ("coordinate real general\n1 2 3\n1 2 1\n1 2 2\n1 1 5\n", [[5, 3]]),
    "symmetric": ("coordinate real symmetric\n2 2 2\n1 1 3\n2 1 -1\n", [[3, -1], [-1, 0]]),
    "upper triangle": ("coordinate real symmetric\n2 2 2\n1 1 3\n1 2 -1\n", [[3, -1], [-1, 0]]),
    "both triangles": (
        "coordinate real symmetric\n3 3 2\n2 1 4\n1 3 5\n",
        [[0, 4, 5], [4, 0, 0], [5, 0, 0]],
    ),
    "skew": ("coordinate real skew-symmetric\n2 2 1\n2 1 -1.5\n", [[0, 1.5], [-1.5, 0]]),
    "empty": ("coordinate real general\n2 2 0\n", [[0, 0], [0, 0]]),
    "comments": ("coordinate real general\n% one\n%\n\n  \n1 1 1\n\n1 1 2.5\n\n", [[2.5]]),
    "capitals, returns": ("COORDINATE Real GENERAL\r\n1 2 1\r\n1 2 2.5\r\n", [[0, 2.5]]),
    "array": ("array real general\n2 3\n1\n2\n3\n4\n5\n6\n", [[1, 3, 5], [2, 4, 6]]),
    "array, no last line end": ("array integer general\n1 2\n1\n-2", [[1, -2]]),
    "symmetric array": (
        "array real symmetric\n3 3\n1\n2\n3\n4\n5\n6\n",
        [[1, 2, 3], [2, 4, 5], [3, 5, 6]],
    ),
    "skew array": ("array real skew-symmetric\n3 3\n1\n2\n3\n", [[0, -1, -2], [1, 0, -3], [2, 3, 0]]),
    "no rows": ("array real general\n0 3\n", np.zeros((0, 3))),
}


@pytest.mark.parametrize("name", MATRICES)
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_matrix_market_files(name: str, mark: bytes, tmp_path: Path) -> None:
    text, dense = MATRICES[name]
    (tmp_path / "a.mtx").write_bytes(mark + HEAD.encode() + text.encode())
    found = read_matrix_market(tmp_path / "a.mtx")
    assert sparse.issparse(found) == ("coordinate" in text.lower())
    assert (found.dtype == np.int64) == ("integer" in text)
    assert np.array_equal(found.toarray() if sparse.issparse(found) else found, dense)


REFUSED = {
    "nothing": ("", "line 1: expected %%MatrixMarket"),
    "text": ("what is this?", "line 1: expected %%MatrixMarket .* found 'what is this"),
    "complex": (
        HEAD + "coordinate complex general\n1 1 1\n1 1 1 0\n",
        "real.integer.pattern .*'.*complex gen",
    ),
    "hermitian": (HEAD + "coordinate real hermitian\n1 1 0\n", "line 1: expected"),
    "array of a pattern": (
        HEAD + "array pattern general\n1 1\n",
        "'array' cannot be combined with 'pattern'",
    ),
    "no sizes": (HEAD + "coordinate real general\n% only a comment", "line 2: expected the numbers of rows"),
    "two sizes": (HEAD + "coordinate real general\n1 1\n", "rows, columns and entries, found '1 1'"),
    "three sizes": (
        HEAD + "array real general\n%\n1 1 1\n",
        "line 3: expected the numbers of rows and columns",
    ),
    "negative": (
        HEAD + "coordinate real general\n-1 1 0\n",
        "expected the numbers of rows, columns and entries",
    ),
    "digits": (HEAD + "array real general\n1 " + "9" * 10_000, "expected the numbers of rows and columns"),
    "oblong": (HEAD + "coordinate real symmetric\n2 3 0\n", "a symmetric matrix must be square, .* 2 x 3"),
    "row 0": (
        HEAD + "coordinate real general\n2 2 1\n0 1 1\n",
        r"entry 1 of 1 is at \(0, 1\), expected 1..2",
    ),
    "row 3": (HEAD + "coordinate real general\n2 2 2\n1 1 1\n3 1 1\n", r"entry 2 of 2 is at \(3, 1\)"),
    "half a row": (HEAD + "coordinate real general\n2 2 1\n1.5 1 1\n", r"entry 1 of 1 is at \(1.5, 1\)"),
    "no row": (HEAD + "coordinate real general\n2 2 1\nnan 1 1\n", r"entry 1 of 1 is at \(nan, 1\)"),
    "cut": (HEAD + "coordinate real general\n2 2 2\n1 1 1.0\n2 2", "line 4: expected 3 numbers, found 2"),
    "word": (HEAD + "array real general\n1 1\n1 x", "line 3: expected a number, found 'x'"),
    "values of no rows": (
        HEAD + "array real general\n0 1\n1.0\n",
        "holds 1 entries, but its header declares 0",
    ),
    "few": (HEAD + "array real general\n2 1\n1.25\n", "holds 1 entries, but its header declares 2"),
    "many": (HEAD + "coordinate real general\n2 2 1\n1 1 1\n2 2 1\n", "holds 2 entries, .* declares 1"),
    "null": (HEAD + "array real general\n2 1\n1\n\x002\n", "line 4: expected a number"),
    "glued": (HEAD + "coordinate real general\n2 2 1\n1 2-5\n", "line 3: expected a number, found '2-5'"),
    "moved word": (
        HEAD + "coordinate real general\n2 2 2\n1 1\n1 2 2 1\n",
        "line 3: expected 3 numbers, found 2",
    ),
    "comment inside": (HEAD + "array real general\n2 1\n1\n% x\n2\n", "line 4: expected a number, found '%'"),
    "fraction": (HEAD + "array integer general\n1 1\n1.5\n", "line 3: expected a whole number, found '1.5'"),
    "twice": (
        HEAD + "coordinate real symmetric\n3 3 3\n1 1 1\n3 1 2\n1 3 2\n",
        r"a symmetric file may list one triangle only, found both \(1, 3\) and \(3, 1\)",
    ),
    "skew diagonal": (
        HEAD + "coordinate real skew-symmetric\n2 2 1\n2 2 1\n",
        r"list diagonal entries, found \(2, 2\)",
    ),
    "many rows": (HEAD + "coordinate real general\n900000000000 900000000000 0\n", "declares 900000000000 x"),
    "many columns": (HEAD + "array real general\n0 900000000000\n", "declares 0 x 900000000000 in a file of"),
    "many entries": (
        HEAD + "coordinate pattern general\n9 9 900000000000\n",
        "900000000000 entries, but only 0",
    ),
    "large array": (
        HEAD + "array real general\n3000000 3000000\n",
        "declares 3000000 x 3000000|9000000000000 en",
    ),
    "large triangle": (
        HEAD + "array real symmetric\n3000 3000\n1\n",
        "declares 4501500 entries, but only 2 byt",
    ),
}


@contextmanager
def little_memory(most: int) -> Iterator[None]:
    """Assert that no more than so many bytes are in use at once."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", REFUSED)
def test_other_matrix_market_files_are_refused(name: str, tmp_path: Path) -> None:
    """Some of them ended the interpreter or took all memory in scipy's reader."""
    text, message = REFUSED[name]
    (tmp_path / "a.mtx").write_text(text)
    with little_memory(1 << 22), pytest.raises(FileError, match=message):
        read_matrix_market(tmp_path / "a.mtx")


def test_tables_by_lines() -> None:
    """Across the pieces in which a text is converted, with and without blank lines."""
    values = np.arange(300_000.0).reshape(-1, 3)
    lines = [f"{i:.0f} {j:.1f} {a:.2e}" for i, j, a in values.tolist()]
    for text in ("\n".join(lines), "\r\n\n".join(lines) + "\n\n"):
        found = number_rows(text.encode(), 0, 3)
        assert np.allclose(found, values, rtol=1e-2)
        assert np.array_equal(found[:, :2], values[:, :2])
    lines[77_000] += " 1"
    with pytest.raises(FileError, match="line 77001: expected 3 numbers, found 4"):
        number_rows("\n".join(lines).encode(), 0, 3)
    assert number_rows(b"1 2\n\n3 4", 0, 2).tolist() == [[1, 2], [3, 4]]
    with pytest.raises(FileError, match="line 2: expected 2 numbers, found 4"):
        number_rows(b"\n1 2 3 4\n", 0, 2)


@pytest.mark.parametrize("form", ["csr", "csc", "bsr", "coo", "dia"])
@pytest.mark.parametrize("kind", ["array", "matrix"])
def test_every_format_of_scipys_npz(form: str, kind: str, tmp_path: Path) -> None:
    dense = np.diag([4.0, 5.0, 6.0, 7.0]) + np.diag([1.0, 2.0], 2)
    A = getattr(sparse, f"csr_{kind}")(dense)
    sparse.save_npz(tmp_path / "A.npz", A.asformat(form), compressed=kind == "array")
    found = read_matrix(tmp_path / "A.npz")
    assert found.format == form
    assert np.array_equal(found.toarray(), dense)
    (tmp_path / "b.txt").write_text("# four\n1 2\n\n3 4 # the end\n")
    table = {"matrix": "A.npz", "rhs": "b.txt"}
    problem = Linear.from_table(table, samples.squares(2), tmp_path)
    assert np.array_equal(problem.A.toarray(), dense)
    assert problem.b.tolist() == [1, 2, 3, 4]


def test_vectors_of_every_suffix(tmp_path: Path) -> None:
    values = np.arange(6.0).reshape(3, 2) / 7.0
    np.save(tmp_path / "v.npy", np.asfortranarray(values.astype(">f8")))
    np.savez_compressed(tmp_path / "v.npz", near=values)
    np.savetxt(tmp_path / "v.txt", values, fmt="%.17g")
    for name, matrix in (("v", values), ("s", sparse.coo_array(values))):
        with (tmp_path / f"{name}.mtx").open("wb") as stream:
            mmwrite(stream, matrix, precision=17)
    for name in ("v.npy", "v.npz", "v.txt", "v.mtx", "s.mtx"):
        assert np.array_equal(read_vectors(tmp_path / name, "near", 3), values)
    with pytest.raises(FileError, match="has 3 rows, expected 5"):
        read_vectors(tmp_path / "s.mtx", "near", 5)
    (tmp_path / "s.mtx").write_text(HEAD + "coordinate real general\n3 1000000 0\n")
    with pytest.raises(FileError, match="declares 3 x 1000000 in a file of"):
        read_vectors(tmp_path / "s.mtx", "near", 3)
    (tmp_path / "v.npy").write_bytes((tmp_path / "v.npy").read_bytes()[:-8])
    with pytest.raises(
        FileError, match=r"array 'v' is corrupt: its header declares 6 .* but 40 bytes follow"
    ):
        read_vectors(tmp_path / "v.npy", "near", 3)


def test_a_file_of_write_system_is_the_matrix_of_a_problem(tmp_path: Path) -> None:
    A = sparse.diags_array([-np.ones(3), np.full(4, 2.5), -np.ones(3)], offsets=[-1, 0, 1])
    write_system(tmp_path / "s.npz", System(A, np.arange(4.0), near_null=np.ones((4, 1))))
    problem = Linear.from_table({"matrix": "s.npz", "rhs": "s.npz"}, samples.squares(2), tmp_path)
    assert np.array_equal(problem.A.toarray(), A.toarray())
    assert problem.b.tolist() == [0, 1, 2, 3]
    assert problem.near_null is not None
    assert problem.near_null.tolist() == [[1], [1], [1], [1]]


WILD = 2**30
UNSOUND = {
    "index": ({"indices": [0, 1, 2, WILD]}, "the index 1073741824, expected 0..3"),
    "negative index": ({"indices": [0, -1, 2, 3]}, "the index -1, expected 0..3"),
    "large unsigned index": (
        {"indices": np.array([0, 2**64 - 1, 2, 3], np.uint64)},
        "more than an int64 can",
    ),
    "falling indptr": ({"indptr": [0, WILD, 2, 3, 4]}, "indptr must increase from 0"),
    "indptr that ends at 0": ({"indptr": [0, WILD, WILD, WILD, 0]}, "indptr must increase from 0"),
    "few entries": ({"indptr": [0, 1, 2, 3, 9]}, "are inconsistent|indptr must increase"),
    "complex": ({"data": np.ones(4, complex)}, "array 'data' has dtype complex128 .* expected real numbers"),
    "few numbers": ({"data": np.ones(3)}, r"array 'data' has shape \(3,\)"),
    "format": ({"format": np.array("xyz")}, "array 'format' is 'xyz', expected csr, csc, bsr, coo or dia"),
    "wide": ({"shape": [4, 10**12]}, r"array 'shape' is \(4, 1000000000000\), but there are 4 entries"),
    "coo": (
        {"format": np.array("coo"), "row": [0, 1, 2, WILD], "col": [0, 1, 2, 3]},
        "arrays of the coo matrix are inconsistent",
    ),
    "dia": (
        {"format": np.array("dia"), "offsets": [0, 0], "data": np.ones((2, 4))},
        "of the dia matrix are inconsistent",
    ),
}


@pytest.mark.parametrize("name", UNSOUND)
def test_unsound_matrices_in_npz_are_refused(name: str, tmp_path: Path) -> None:
    """By a system and by a problem file; with scipy's check alone some ended the interpreter."""
    changes, message = UNSOUND[name]
    arrays = {"data": np.ones(4), "indices": [0, 1, 2, 3], "indptr": [0, 1, 2, 3, 4], "b": np.ones(4)}
    np.savez(tmp_path / "s.npz", **{**arrays, "shape": [4, 4], **changes})
    (tmp_path / "p.toml").write_text('kind = "linear"\nmatrix = "s.npz"\nrhs = "s.npz"\n')
    with pytest.raises(FileError, match=rf"s\.npz: .*{message}"):
        read_system(tmp_path / "s.npz")
    with pytest.raises(FileError, match=rf"p\.toml: matrix: .*s\.npz: .*{message}"):
        read_problem(tmp_path / "p.toml", samples.squares(2))


def zeros(shape: tuple[int, ...], dtype: str) -> bytes:
    """An array as npy, deflated to a thousandth."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.zeros(shape, dtype))
    return stream.getvalue()


BOMBS = {
    "b": {"b": zeros((1 << 24,), "<f8")},
    "data": {"data": zeros((1 << 24,), "<f8"), "indices": zeros((1 << 24,), "<i4")},
    "indptr": {"indptr": zeros((1 << 25,), "<i4")},
    "near_null": {"near_null": zeros((4, 1 << 22), "<f8")},
}


@pytest.mark.parametrize("name", BOMBS)
def test_arrays_far_larger_than_their_file_are_refused(name: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "s.npz", data=np.ones(4), indices=np.arange(4), indptr=np.arange(5), b=np.ones(4))
    with zipfile.ZipFile(tmp_path / "s.npz") as archive:
        members = {Path(each).stem: archive.read(each) for each in archive.namelist()}
    with zipfile.ZipFile(tmp_path / "s.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in (members | BOMBS[name]).items():
            archive.writestr(f"{member}.npy", content)
    size = (tmp_path / "s.npz").stat().st_size
    (tmp_path / "p.toml").write_text('kind = "linear"\nmatrix = "s.npz"\nrhs = "s.npz"\n')
    message = f"array '({'|'.join(BOMBS[name])})' has .* bytes, far more than a file of {size} bytes"
    with little_memory(10 * size + (1 << 25)), pytest.raises(FileError, match=message):
        read_system(tmp_path / "s.npz")
    with little_memory(10 * size + (1 << 25)), pytest.raises(FileError, match=message):
        read_problem(tmp_path / "p.toml", samples.squares(2))


def test_long_headers_of_arrays_are_not_read(tmp_path: Path) -> None:
    content = np.lib.format.magic(2, 0) + struct.pack("<I", 1 << 26) + b" " * (1 << 26)
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", content)
    with (
        little_memory(1 << 22),
        pytest.raises(FileError, match="its header has 67108864 bytes, expected at mo"),
    ):
        Archive(tmp_path / "a.npz").take("a", "f", (None,))


def test_later_headers_are_read(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive, archive.open("a.npy", "w") as stream:
        np.lib.format.write_array(stream, np.arange(3.0), version=(2, 0))
    assert Archive(tmp_path / "a.npz").take("a", "f", (3,)).tolist() == [0, 1, 2]


def test_what_is_no_regular_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mtx")
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(FileError, match=r"pipe\.mtx: is not a regular file"):
        read_system(tmp_path / "pipe.mtx")
    with pytest.raises(FileError, match=r"matrix: .*pipe\.mtx: is not a regular file"):
        Linear.from_table({"matrix": "pipe.mtx", "rhs": "b.npy"}, samples.squares(2), tmp_path)
    with pytest.raises(FileError, match=r"pipe\.toml: is not a regular file; expected a TOML file"):
        Pipeline.from_toml(tmp_path / "pipe.toml")
    for name in ("n" * 5000, "a\0b"):
        with pytest.raises(FileError, match="no such file, and no problem of that name"):
            named_problem(name, samples.squares(2))


def test_toml_of_numbers_and_sizes_beyond_reason(tmp_path: Path) -> None:
    """Python converts hexadecimal digits without end, and then cannot print what it has."""
    file = tmp_path / "p.toml"
    for text in (
        f"kappa = 0x{'f' * 5000}",
        f"[dirichlet]\n0 = [1, 0x{'f' * 5000}]",
        f"kind = 0x{'f' * 5000}",
    ):
        file.write_text(text)
        with pytest.raises(FileError, match=r"p\.toml: a number has too many digits"):
            read_problem(file, samples.squares(2))
    file.write_text("kappa = 0xffff_ffff_ffff_ffff_ffff")
    assert read_problem(file, samples.squares(2)).kappa == 2.0**80
    file.write_text("#" * (1 << 21) + "\n")
    with pytest.raises(
        FileError, match=r"p\.toml: has 2097153 bytes, more than 2097152; expected a TOML file"
    ):
        read_problem(file, samples.squares(2))


def test_errors_of_reading_do_not_blame_a_plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for error, message in ((OSError(5, "Input/output error"), "Input/output error"), (MemoryError(), "Mem")):

        def fail(*_: object, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr(Linear, "from_table", fail)
        (tmp_path / "p.toml").write_text('kind = "linear"\n')
        with pytest.raises(FileError, match=rf"p\.toml: .*{message}") as caught:
            read_problem(tmp_path / "p.toml", samples.squares(2))
        assert "plugin" not in str(caught.value)


def test_a_system_that_does_not_fit_names_its_file(tmp_path: Path) -> None:
    np.savez(tmp_path / "s.npz", data=[1.0, 1.0], indices=[1, 1], indptr=[0, 1, 2], b=np.ones(2))
    with pytest.raises(OptionError, match=r"s\.npz: A must be symmetric"):
        read_system(tmp_path / "s.npz")
    np.savez(tmp_path / "s.npz", data=[1.0, 1.0], indices=[0, 1], indptr=[0, 1, 2], b=np.ones(3))
    with pytest.raises(OptionError, match=r"s\.npz: b must have the shape \(2,\) or \(2, k\)"):
        read_system(tmp_path / "s.npz")
