"""Formats with several files per mesh: packed as an archive in the corpus, unpacked for reading."""

from __future__ import annotations

import io
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path

__all__ = ["SEVERAL", "lay_out", "packed"]

SEVERAL = (".foam", ".ele", ".pvtu", ".xdmf", ".mtx", ".linear.toml")


def packed(files: Mapping[str, bytes]) -> bytes:
    """Return an archive of files by name."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


def lay_out(file: Path, content: bytes) -> None:
    """Write a mesh of the corpus as ``file``, with its other files next to it."""
    if file.name[file.name.index(".") :] not in SEVERAL:
        file.write_bytes(content)
        return
    for left in file.parent.glob(f"{file.stem}_*.mtx"):  # of another system
        left.unlink()
    shutil.rmtree(file.parent / "constant", ignore_errors=True)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(file.parent)
    file.touch()
