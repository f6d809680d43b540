"""Systems as users bring them: what is kept, what is refused, and what files give back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmread
from scipy.sparse.linalg import LinearOperator

from agglo_core import samples
from agglo_core.errors import FileError, OptionError
from agglo_core.io.system_files import read_system, write_system
from agglo_core.problems import System


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
    with pytest.raises(OptionError, match="which of the 6 unknowns belong to each of 4 cells"):
        System(A, b, mesh=mesh)
    with pytest.raises(OptionError, match="of 3 blocks, the mesh has 4 cells"):
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
        "A must be a sparse or dense matrix with entries, given .*LinearOperator",
    ),
    "rectangle": (lambda: System(np.ones((2, 3)), b), r"A must be a square matrix, given the shape \(2, 3\)"),
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
    "halves": (lambda: System(A, b, [0.0, 3.0, 6.0]), "block_offsets must be whole numbers"),
    "flat near_null": (lambda: System(A, b, near_null=np.ones(6)), r"near_null must have the shape \(6, k\)"),
    "NaN near_null": (lambda: System(A, b, near_null=np.full((6, 1), np.nan)), "near_null holds"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_system_is_refused(name: str) -> None:
    make, message = REFUSED[name]
    with pytest.raises(OptionError, match=message):
        make()


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
    with pytest.raises(FileError, match=r"a\.vtu: a system is read and written as .npz, .mtx"):
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
    with pytest.raises(FileError, match=r"a\.mtx cannot be read"):
        read_system(tmp_path / "a.mtx")
    np.savez(tmp_path / "b.npz", data=np.ones(2), indices=[0, 9], indptr=[0, 1, 2], b=np.ones(2))
    with pytest.raises(FileError, match="arrays of A are corrupt"):
        read_system(tmp_path / "b.npz")
    write_system(tmp_path / "c.npz", System(A, b))
    whole = (tmp_path / "c.npz").read_bytes()
    (tmp_path / "c.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match=r"c\.npz"):
        read_system(tmp_path / "c.npz")
    with pytest.raises(FileError, match="missing"):
        write_system(tmp_path / "missing" / "a.npz", System(A, b))
