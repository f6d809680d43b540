"""Files with trained networks: safetensors parameter arrays, and a descriptive header.

A header is a JSON object under the key ``agglo`` of the file's metadata. It has at least these keys:

- ``architecture``: name of the network;
- ``features``: its input columns, in order;
- ``recipe``: training data and options; ``seed``; ``version`` of agglo; ``metrics`` reached.

:func:`save` adds ``arrays``, the type and shape of each array, and ``sha256``, their digest.
Model files never execute code.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.authoring import FileError, PluginError, staging

REQUIRED = ("architecture", "features", "recipe", "seed", "version", "metrics")

_HEADER = 1 << 22  # limit in bytes of JSON; shipped headers have a few thousand

Arrays = Mapping[str, NDArray[Any]]


def save(path: str | Path, arrays: Arrays, header: Mapping[str, Any]) -> None:
    """Write a model file in one step, so that an interruption leaves no incomplete file.

    Parameters
    ----------
    path : str or Path
        Must end in ``.safetensors``.
    arrays : mapping of str to array
        Real or integer arrays.
    header : mapping
        Plain data with the required keys (see the module docstring).

    Raises
    ------
    FileError
        If the name or the header is invalid, or the file cannot be written.
    """
    # 1. Check name and header
    _check_safetensors()
    from safetensors.numpy import save as in_bytes

    target = Path(path)
    _check_name(target)
    missing = [key for key in REQUIRED if key not in header]
    if missing:
        raise FileError(f"{target}: the header of a model file lacks {', '.join(missing)}")
    # 2. Complete the header
    solid = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    full = {**header, "arrays": _describe_arrays(solid), "sha256": _digest(solid)}
    try:
        text = json.dumps(full, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise FileError(f"{target}: the header is not plain data: {error}") from error
    # 3. Write to a staging folder, then move
    try:
        with staging(target) as stage:
            (stage / target.name).write_bytes(in_bytes(solid, metadata={"agglo": text}))
    except OSError as error:
        raise FileError(f"{target}: cannot be written: {error.strerror or error}") from error


def load(
    path: str | Path, architecture: str | None = None, shapes: Mapping[str, tuple[int, ...]] | None = None
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read and completely check a model file, and return its arrays and header.

    Parameters
    ----------
    path : str or Path
    architecture : str, optional
        Required architecture.
    shapes : mapping of str to tuple, optional
        Required real arrays with their shapes; no others are accepted.

    Raises
    ------
    FileError
        If the file is missing, a pickle, truncated, corrupt, without a header, has another architecture, or
        its arrays are not finite or not as required.
    """
    _check_safetensors()
    from safetensors import SafetensorError
    from safetensors.numpy import load as parse

    # 1. Header
    header = read_header(path)
    if architecture is not None and header["architecture"] != architecture:
        raise FileError(f"{path}: is a model of {header['architecture']!r}, expected {architecture!r}")
    # 2. Arrays, compared with the header
    try:
        arrays = parse(_content(Path(path)))
    except (SafetensorError, KeyError, ValueError, TypeError, OverflowError) as error:
        raise FileError(f"{path}: is corrupt or truncated: {error}") from error
    if _describe_arrays(arrays) != header["arrays"]:
        raise FileError(f"{path}: its arrays do not match the list in its header")
    if _digest(arrays) != header["sha256"]:
        raise FileError(f"{path}: is corrupt: the digest of its arrays differs from the one in its header")
    # 3. Finite values and required shapes
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise FileError(f"{path}: array {name!r} has values that are not finite")
    if shapes is not None:
        check_shapes(path, arrays, shapes)
    return arrays, header


def read_header(path: str | Path) -> dict[str, Any]:
    """Read the header of a model file, without its arrays.

    Raises
    ------
    FileError
        If the file is missing, or has no valid model header.
    """
    # 1. Refuse pickles
    content = _content(Path(path), 8 + _HEADER)
    if content[:1] == b"\x80" or content[:2] == b"PK":
        raise FileError(
            f"{path}: is a pickle or zip file, as written by torch.save. It is not read, because loading one "
            "can run any code; expected safetensors written by agglo train"
        )
    # 2. Length of the safetensors header
    length, size = int.from_bytes(content[:8], "little"), Path(path).stat().st_size
    if size < 8 or length > size - 8:
        raise FileError(f"{path}: is truncated or not a safetensors file ({size} bytes)")
    if length > _HEADER:
        raise FileError(f"{path}: its header has {length} bytes, expected at most {_HEADER}")
    # 3. Metadata of the model
    try:
        metadata = json.loads(content[8 : 8 + length])["__metadata__"]
        header = json.loads(metadata["agglo"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileError(
            f"{path}: has no header of an agglo model; expected a file written by agglo train"
        ) from error
    if not isinstance(header, dict):
        raise FileError(f"{path}: its header is not a JSON object")
    missing = [key for key in (*REQUIRED, "arrays", "sha256") if key not in header]
    if missing:
        raise FileError(f"{path}: its header lacks {', '.join(missing)}")
    return header


def _check_safetensors() -> None:
    if find_spec("safetensors") is None:
        raise PluginError("model files need safetensors, which is not installed: pip install 'agglo[gnn]'")


def _check_name(target: Path) -> None:
    if target.suffix != ".safetensors":
        raise FileError(f"{target}: model files end in .safetensors, not {target.suffix!r}")


def _content(path: Path, most: int = -1) -> bytes:
    """Return the first ``most`` bytes of a file, or the whole file if ``most`` is negative."""
    if path.exists() and not (path.is_file() or path.is_dir()):  # a device may be endless
        raise FileError(f"{path}: is not a regular file")
    try:
        with open(path, "rb") as stream:
            return stream.read(most)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from error


def _describe_arrays(arrays: Arrays) -> dict[str, Any]:
    return {name: [str(array.dtype), list(array.shape)] for name, array in sorted(arrays.items())}


def _digest(arrays: Arrays) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(name.encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def check_shapes(path: str | Path, arrays: Arrays, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise FileError unless the arrays have exactly these names and shapes, and contain real numbers."""
    odd = sorted(arrays.keys() ^ shapes.keys())
    if odd:
        verb = "lacks" if odd[0] in shapes else "has an unknown"
        raise FileError(f"{path}: {verb} array {odd[0]!r}; expected {', '.join(sorted(shapes))}")
    for name, shape in shapes.items():
        if arrays[name].shape != tuple(shape) or arrays[name].dtype.kind != "f":
            raise FileError(
                f"{path}: array {name!r} is {arrays[name].dtype} of shape {arrays[name].shape}, expected "
                f"real numbers of shape {tuple(shape)}"
            )
