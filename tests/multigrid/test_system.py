"""Systems as users bring them: what is kept, what is refused, and what files give back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmread
from scipy.sparse.linalg import LinearOperator

from agglo_core import samples
from agglo_core.errors import FileError, OptionError
from agglo_core.io.system_files import read_system, write_system
from agglo_core.multigrid import aggregation_stack, block_matrix, classical_stack
from agglo_core.problems import Linear, System


def laplacian(n: int) -> sparse.csr_array:
    return sparse.csr_array(sparse.diags_array([-1.0, 2.5, -1.0], offsets=[-1, 0, 1], shape=(n, n)))


A, b = laplacian(6), np.linspace(1.0, 2.0, 6)


def test_what_is_given_is_kept_as_float64() -> None:
    dense = System(A.toarray().astype(int), [1, 2, 3, 4, 5, 6])
    assert (dense.A.format, dense.A.dtype, dense.b.dtype) == ("csr", np.float64, np.float64)
    assert (dense.n, dense.n_blocks, dense.width) == (6, 6, 1)
    blocks = sparse.bsr_array(A, blocksize=(2, 2))
    system = System(blocks, np.ones((6, 3)), [0, 2, 4, 6], near_null=np.ones((6, 1)))
    assert system.A.format == "bsr"
    assert (system.b.shape, system.n_blocks, system.width) == ((6, 3), 3, 2)
    assert System(A, b, [0, 1, 4, 6]).width is None
    matrix, rhs = system.to_scipy()
    assert matrix.format == "csr"
    assert np.array_equal(matrix.toarray(), A.toarray())
    rhs[0] = 7.0
    assert system.b[0, 0] == 1.0


def test_with_a_mesh_blocks_are_cells() -> None:
    mesh = samples.squares(2)
    assert System(laplacian(4), np.ones(4), mesh=mesh).n_blocks == 4
    with pytest.raises(OptionError, match="they assign the 6 unknowns to the 4 cells"):
        System(A, b, mesh=mesh)
    with pytest.raises(OptionError, match="define 3 blocks, but the mesh has 4 cells"):
        System(A, b, [0, 2, 4, 6], mesh)


def with_entry(i: int, j: int, value: float) -> np.ndarray:
    changed = A.toarray()
    changed[i, j] = value
    return changed


REFUSED = {
    "complex matrix": (lambda: System(A * 1j, b), "A holds complex128; expected real numbers"),
    "complex b": (lambda: System(A, b + 0j), "b holds complex128; expected real numbers"),
    "operator": (
        lambda: System(LinearOperator((6, 6), matvec=lambda x: x, dtype=float), b),
        "A must be a sparse or dense matrix, given .*LinearOperator",
    ),
    "rectangle": (lambda: System(np.ones((2, 3)), b), r"A must be a square matrix, given shape \(2, 3\)"),
    "empty": (lambda: System(np.zeros((0, 0)), []), "A must be a square matrix"),
    "asymmetric": (lambda: System(with_entry(0, 1, -1.01), b), r"entry \(0, 1\) is -1.01, \(1, 0\) is -1"),
    "one side": (lambda: System(with_entry(5, 0, 1e-6), b), "A must be symmetric"),
    "infinite A": (lambda: System(with_entry(2, 2, np.inf), b), "not finite"),
    "NaN in b": (lambda: System(A, [np.nan] * 6), "not finite"),
    "short b": (lambda: System(A, b[:5]), r"b must have the shape \(6,\) or \(6, k\) .*given \(5,\)"),
    "no columns": (lambda: System(A, np.zeros((6, 0))), "b must have the shape"),
    "sparse b": (lambda: System(A, sparse.csr_array(b[:, None])), r"b.toarray\(\)"),
    "text": (lambda: System(A, ["a"] * 6), "b .*real numbers"),
    "ends early": (lambda: System(A, b, [0, 2, 5]), "increase from 0 to the number of unknowns 6"),
    "falls": (lambda: System(A, b, [0, 4, 2, 6]), "increase from 0"),
    "empty block": (lambda: System(A, b, [0, 3, 3, 6]), "increase from 0"),
    "halves": (lambda: System(A, b, [0.0, 3.0, 6.0]), "block_offsets must be a block size or whole numbers"),
    "flat near_null": (lambda: System(A, b, near_null=np.ones(6)), r"near_null must have the shape \(6, k\)"),
    "NaN near_null": (lambda: System(A, b, near_null=np.full((6, 1), np.nan)), "near_null holds"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_system_is_refused(name: str) -> None:
    make, message = REFUSED[name]
    with pytest.raises(OptionError, match=message):
        make()


def damaged(kind: str, **parts: object) -> object:
    """A matrix whose arrays were changed after scipy checked them."""
    matrix = A.tobsr((2, 2)) if kind == "bsr" else A.copy().asformat(kind)
    for name, values in parts.items():
        setattr(matrix, name, values)
    return matrix


FAR = 2**30
UNSOUND = {
    "index beyond": ("csr", {"indices": np.array([0, 1, 0, 1, 2, 1, 2, 3, 2, 3, 4, 3, 4, 5, 4, 6])}),
    "wild indices": ("csr", {"indices": np.full(16, FAR)}),
    "negative index": ("csr", {"indices": np.arange(16) % 6 - 1}),
    "unsigned index": ("csr", {"indices": np.full(16, 2**64 - 1, np.uint64)}),
    "falling indptr": ("csr", {"indptr": np.array([0, FAR, 3, 5, 7, 9, 16])}),
    "falling unsigned indptr": ("csr", {"indptr": np.array([0, 9, 3, 5, 7, 9, 16], np.uint64)}),
    "indptr that ends at 0": ("csr", {"indptr": np.array([0, FAR, FAR, FAR, FAR, FAR, 0])}),
    "indptr beyond the entries": ("csr", {"indptr": np.arange(7) * 3}),
    "indptr from 1 on": ("csr", {"indptr": np.array([1, 2, 3, 4, 5, 6, 7])}),
    "short indptr": ("csr", {"indptr": np.arange(6)}),
    "short data": ("csr", {"data": np.ones(3)}),
    "fractions": ("csr", {"indices": np.full(16, 0.5)}),
    "column": ("csc", {"indices": np.full(16, FAR)}),
    "columns": ("csc", {"indptr": np.array([0, FAR, FAR, FAR, FAR, FAR, 16])}),
    "block": ("bsr", {"indices": np.array([0, 1, 0, 1, 2, 1, 3])}),
    "block size": ("bsr", {"data": np.ones((7, 4, 4))}),
    "coordinates": ("coo", {"row": np.full(16, FAR)}),
    "offsets": ("dia", {"offsets": np.array([-1, 0])}),
    "lists": ("lil", {"rows": np.array([[0], [1], [2], [3], [4], [FAR]], dtype=object)}),
}


@pytest.mark.parametrize("name", UNSOUND)
@pytest.mark.filterwarnings("ignore:ind:UserWarning")
def test_matrices_with_indices_out_of_range_are_refused(name: str) -> None:
    """Each would make scipy read or write outside its arrays."""
    matrix = damaged(UNSOUND[name][0], **UNSOUND[name][1])
    message = f"A is not a valid {UNSOUND[name][0]} matrix"
    with pytest.raises(OptionError, match=message):
        System(matrix, b)
    with pytest.raises(OptionError, match=message):
        Linear(matrix, b, np.arange(7))
    for stack in (aggregation_stack, classical_stack):
        with pytest.raises(OptionError, match=message):
            stack(matrix)
    with pytest.raises(OptionError, match=message):
        block_matrix(matrix, np.arange(7))


def test_the_message_names_the_index() -> None:
    with pytest.raises(OptionError, match=r"it has the index 6, expected 0\.\.5"):
        System(damaged("csr", indices=np.array([0, 1, 0, 1, 2, 1, 2, 3, 2, 3, 4, 3, 4, 5, 4, 6])), b)
    with pytest.raises(OptionError, match="indptr must increase from 0 to at most its 16 entries"):
        System(damaged("csr", indptr=np.array([0, 2, 1, 8, 11, 14, 16])), b)


@pytest.mark.parametrize("kind", ["csr", "csc", "bsr", "coo", "dia", "lil", "dok"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int8])
def test_matrices_of_every_format_keep_their_entries(kind: str, dtype: type) -> None:
    dense = np.diag(np.arange(2, 8)) + np.diag(np.ones(4), 2) + np.diag(np.ones(4), -2)
    given = sparse.csr_array(dense.astype(dtype))
    given = given.tobsr((2, 2)) if kind == "bsr" else given.asformat(kind)
    for matrix in (System(given, b).A, Linear(given, b, np.arange(7)).A):
        assert matrix.format == ("bsr" if kind == "bsr" else "csr")
        assert matrix.has_canonical_format
        assert matrix.dtype == np.float64
        assert np.array_equal(matrix.toarray(), dense)


def repeated_entries(kind: str) -> sparse.csr_array | sparse.bsr_array:
    """The matrix [[5, 1], [1, 3]], or one of blocks, out of order and with entries in pieces."""
    data, indices, indptr = [1.0, 2.0, 3.0, 1.0, 3.0], [1, 0, 0, 0, 1], [0, 3, 5]
    if kind == "csr":
        return sparse.csr_array((np.array(data), np.array(indices), np.array(indptr)), shape=(2, 2))
    blocks = np.multiply.outer(data, np.eye(2))
    return sparse.bsr_array((blocks, np.array(indices), np.array(indptr)), shape=(4, 4))


@pytest.mark.parametrize("kind", ["csr", "bsr"])
@pytest.mark.parametrize("make", [System, lambda A, b: Linear(A, b, np.arange(len(b) + 1))])
def test_neither_side_changes_the_arrays_of_the_other(
    kind: str, make: Callable[..., System | Linear]
) -> None:
    """scipy sums entries in place, also of a matrix that shares the arrays of another."""
    given = repeated_entries(kind)
    parts = {name: getattr(given, name).copy() for name in ("data", "indices", "indptr")}
    rhs = np.ones(given.shape[0])
    made = make(given, rhs)
    dense = np.kron([[5.0, 1.0], [1.0, 3.0]], np.eye(given.shape[0] // 2))
    for name, before in parts.items():
        assert np.array_equal(getattr(given, name), before)
    shared = type(made.A)(made.A)
    shared.sum_duplicates()
    for values in (given.data, given.indices, rhs):
        values[...] = 0
    assert np.array_equal(made.A.toarray(), dense)
    assert np.array_equal(made.b, np.ones(len(dense)))
    for values in (made.A.data, made.A.indices, made.A.indptr, made.b):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 7
    again = make(made.A, made.b)
    assert np.shares_memory(again.A.data, made.A.data)  # protected arrays need no copy


def test_a_matrix_of_integers_is_not_reordered_in_place() -> None:
    """The copy in float64 once shared the indices, which scipy sorted for both."""
    given = sparse.csr_array(
        (np.array([1, 5, 3, 1]), np.array([1, 0, 1, 0]), np.array([0, 2, 4])), shape=(2, 2)
    )
    system = System(given, np.ones(2))
    sparse.csr_array(system.A).sort_indices()
    for matrix in (given, system.A):
        assert matrix.toarray().tolist() == [[5, 1], [1, 3]]


def test_masked_values_and_ragged_rows_are_refused() -> None:
    with pytest.raises(OptionError, match="b has masked entries"):
        System(A, np.ma.masked_equal(np.arange(6), 2))
    with pytest.raises(OptionError, match="A must be an array of numbers"):
        System([[1.0, 2.0], [3.0]], [1.0, 2.0])


def test_rounding_does_not_make_a_matrix_asymmetric() -> None:
    random = np.random.default_rng(2)
    factor = sparse.random_array((300, 300), density=0.05, rng=random)
    for scale in (1e-30, 1.0, 1e30):
        product = scale * (factor @ factor.T)
        product.data *= 1.0 + 1e-15 * random.normal(size=product.nnz)
        assert System(product, np.ones(300)).n == 300


def random_system(seed: int) -> System:
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 30))
    dense = random.normal(size=(n, n)) * 10.0 ** random.integers(-200, 200) * (random.random((n, n)) < 0.4)
    offsets = np.unique(np.r_[0, random.integers(1, n + 1, 5), n])
    b = random.normal(size=(n, 3)) if seed % 2 else random.normal(size=n) / 3.0
    return System(dense + dense.T, b, offsets, near_null=random.normal(size=(n, 2)) if seed % 3 else None)


@pytest.mark.parametrize("suffix", [".npz", ".mtx", ".NPZ"])
@pytest.mark.parametrize("seed", range(6))
def test_files_give_back_every_bit(tmp_path: Path, suffix: str, seed: int) -> None:
    system = random_system(seed)
    path = tmp_path / f"system{suffix}"
    write_system(path, system)
    found = read_system(path)
    assert np.array_equal(found.A.toarray(), system.A.toarray())
    for name in ("b", "block_offsets", "near_null"):
        kept, given = getattr(found, name), getattr(system, name)
        assert (kept is None) == (given is None)
        assert given is None or np.array_equal(kept, given)
    assert not [each for each in tmp_path.iterdir() if each.name.startswith(".")]


def test_other_programs_read_the_matrix_market_files(tmp_path: Path) -> None:
    write_system(tmp_path / "a.mtx", System(A, b))
    assert {each.name for each in tmp_path.iterdir()} == {"a.mtx", "a_b.mtx", "a_block_offsets.mtx"}
    assert np.array_equal(mmread(tmp_path / "a.mtx").toarray(), A.toarray())
    assert np.array_equal(mmread(tmp_path / "a_b.mtx").ravel(), b)


def test_files_that_are_no_system_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"a\.vtu: the suffix of a system file must be one of .npz, .mtx"):
        write_system(tmp_path / "a.vtu", System(A, b))
    with pytest.raises(FileError, match=r"none\.npz"):
        read_system(tmp_path / "none.npz")
    with pytest.raises(FileError, match=r"no\.mtx: no such file"):
        read_system(tmp_path / "no.mtx")
    write_system(tmp_path / "a.mtx", System(A, b))
    (tmp_path / "a_b.mtx").unlink()
    with pytest.raises(FileError, match=r"a_b\.mtx: no such file"):
        read_system(tmp_path / "a.mtx")
    (tmp_path / "a.mtx").write_text("not a matrix")
    with pytest.raises(FileError, match=r"a\.mtx: line 1: expected %%MatrixMarket .*found 'not a matrix'"):
        read_system(tmp_path / "a.mtx")
    np.savez(tmp_path / "b.npz", data=np.ones(2), indices=[0, 9], indptr=[0, 1, 2], b=np.ones(2))
    with pytest.raises(
        FileError, match=r"b\.npz: A is not a valid csr matrix: it has the index 9, expected 0\.\.1"
    ):
        read_system(tmp_path / "b.npz")
    write_system(tmp_path / "c.npz", System(A, b))
    whole = (tmp_path / "c.npz").read_bytes()
    (tmp_path / "c.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match=r"c\.npz"):
        read_system(tmp_path / "c.npz")
    with pytest.raises(FileError, match="missing"):
        write_system(tmp_path / "missing" / "a.npz", System(A, b))
