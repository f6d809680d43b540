"""Options for reading, shared by all formats that build meshes from points and cells."""

from __future__ import annotations

from typing import TypedDict


class ReadOptions(TypedDict):
    """Keyword arguments that control the construction of a mesh from a file."""

    merge_points: bool
    allow_gaps: bool
    drop_flat: bool


class Reading:
    """Base class of file formats, with the options for reading.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Keep coincident outer faces.
    drop_flat : bool
        Drop cells with zero area or volume.
    """

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False, drop_flat: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps
        self.drop_flat = drop_flat

    @property
    def reading(self) -> ReadOptions:
        """Options as keyword arguments for the functions that build a mesh."""
        return {
            "merge_points": self.merge_points,
            "allow_gaps": self.allow_gaps,
            "drop_flat": self.drop_flat,
        }


class Compressing(Reading):
    """Base class of file formats, with the options for reading and for compression.

    Parameters
    ----------
    compress : bool
        Write compressed data: smaller files, slower to write and to read.
    """

    def __init__(
        self,
        merge_points: bool = True,
        allow_gaps: bool = False,
        compress: bool = False,
        drop_flat: bool = False,
    ) -> None:
        super().__init__(merge_points, allow_gaps, drop_flat)
        self.compress = compress
