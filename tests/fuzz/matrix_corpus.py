"""Small valid files of linear systems: matrices in all layouts and formats, vectors with all suffixes."""

from __future__ import annotations

import io
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from fuzz.several import packed
from scipy import sparse
from scipy.io import mmwrite

from agglo_core.io.system_files import write_system
from agglo_core.problems import System

__all__ = ["CELLS", "matrix_files"]

CELLS = 16
_A = sparse.csr_array(
    sparse.diags_array([-np.ones(CELLS - 1), np.full(CELLS, 2.5), -np.ones(CELLS - 1)], offsets=[-1, 0, 1])
)
_B = np.arange(1.0, CELLS + 1.0) / 3.0


@cache
def matrix_files() -> dict[str, list[bytes]]:
    """Return small valid files by suffix."""
    return {".mtx": _markets(), ".system.npz": _systems(), ".linear.toml": _problems()}


def _market(matrix: object, symmetry: str = "general", field: str | None = None) -> bytes:
    stream = io.BytesIO()
    mmwrite(stream, matrix, symmetry=symmetry, field=field, precision=17, comment="a matrix")
    return stream.getvalue()


def _written(suffix: str, system: System) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        write_system(Path(folder) / f"m{suffix}", system)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


def _whole() -> System:
    """Return a system with all optional arrays."""
    near = np.stack((np.ones(CELLS), np.arange(CELLS)), axis=1)
    return System(_A, np.stack((_B, -_B), axis=1), np.arange(0, CELLS + 1, 2), near_null=near)


def _markets() -> list[bytes]:
    pattern = sparse.coo_array(np.eye(4))
    skew = sparse.coo_array((4, 4))
    files = [
        {"m.mtx": _market(_A, "symmetric"), "m_b.mtx": _market(_B[:, None])},
        {"m.mtx": _market(_A.toarray(), "symmetric"), "m_b.mtx": _market(sparse.coo_array(_B[:, None]))},
        {"m.mtx": _market(pattern, field="pattern"), "m_b.mtx": _market(np.ones((4, 1), int))},
        {"m.mtx": _market(skew, "skew-symmetric"), "m_b.mtx": _market(np.ones((4, 1)))},
        {"m.mtx": _market(np.diag([2, 3]), "general"), "m_b.mtx": _market(np.ones((2, 3)))},
    ]
    return [packed(each) for each in (_written(".mtx", _whole()), *files)]


def _systems() -> list[bytes]:
    packs = [_written(".npz", each)["m.npz"] for each in (_whole(), System(_A, _B))]
    for form in ("csc", "bsr", "coo", "dia"):
        stream = io.BytesIO()
        sparse.save_npz(stream, _A.tobsr((2, 2)) if form == "bsr" else _A.asformat(form))
        with np.load(io.BytesIO(stream.getvalue())) as arrays:
            parts = {name: arrays[name] for name in arrays}
        stream = io.BytesIO()
        np.savez(stream, b=_B, **parts)
        packs.append(stream.getvalue())
    return packs


def _problems() -> list[bytes]:
    """Return problem files with the files that they name."""
    near, arrays = np.ones((CELLS, 1)), io.BytesIO()
    np.save(arrays, _B)
    table = b'kind = "linear"\nmatrix = "%b"\nrhs = "%b"\n'
    system = _written(".npz", System(_A, _B, near_null=near))["m.npz"]
    return [
        packed(
            {"m.linear.toml": table % (b"A.mtx", b"b.npy"), "A.mtx": _market(_A), "b.npy": arrays.getvalue()}
        ),
        packed(
            {
                "m.linear.toml": table % (b"A.mtx", b"b.txt") + b'unknowns = 1\nnear_null = "n.txt"\n',
                "A.mtx": _market(_A, "symmetric"),
                "b.txt": b"# b\n" + b"".join(b"%r\n" % each for each in _B.tolist()),
                "n.txt": b"1 2.5\n" * CELLS,
            }
        ),
        packed(
            {
                "m.linear.toml": table % (b"s.npz", b"s.npz") + b'near_null = "n.mtx"\n',
                "s.npz": system,
                "n.mtx": _market(near),
            }
        ),
    ]
