"""Whether the kernels still have to be compiled."""

from __future__ import annotations

from pathlib import Path

from agglo_core.kernels.graphs import permute_graph

__all__ = ["first_use"]


def first_use() -> bool:
    """Whether the kernels of the recursion are not compiled on disk yet (the first run takes longer)."""
    if permute_graph.signatures:
        return False
    folder = permute_graph.stats.cache_path  # None where no folder is writable
    return folder is None or not any(Path(folder).glob("graphs.permute_graph-*.nbi"))
