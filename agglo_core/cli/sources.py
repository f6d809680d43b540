"""From what is typed to a mesh: a file if there is one of that name, else a sample."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.errors import FileError, OptionError

if TYPE_CHECKING:
    from agglo_core.mesh import Mesh

__all__ = ["load_mesh"]

_SAMPLE = re.compile(r"[A-Za-z_]\w*(:[^/\\]*)?")


def load_mesh(text: str) -> Mesh:
    """Read the mesh file ``text``, or make the sample it describes.

    Raises
    ------
    FileError
        If it is a file that cannot be read, or neither a file nor the form of a sample.
    OptionError
        If it has the form of a sample, but is none.
    """
    if not text:
        raise FileError("the name of the mesh is empty; expected a file or a sample such as squares:n=64")
    if Path(text).exists():
        from agglo_core.io import read

        return read(Path(text))
    if not _SAMPLE.fullmatch(text):
        raise FileError(
            f"{text!r} is neither a file (there is none of that name) nor a sample such as squares:n=64"
        )
    from agglo_core import samples

    try:
        return samples.from_spec(text)
    except OptionError as error:
        raise OptionError(
            f"{text!r} is neither a file (there is none of that name) nor a sample: {error}"
        ) from error
