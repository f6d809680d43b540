"""Options of formats that build meshes from the points and cells of a file."""

from __future__ import annotations

from typing import TypedDict


class ReadOptions(TypedDict):
    """Options of building a mesh from the contents of a file."""

    merge_points: bool
    allow_gaps: bool
    drop_flat: bool


class Reading:
    """The part of a format that has the options of reading.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    drop_flat : bool
        Leave out cells of zero area or volume.
    """

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False, drop_flat: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps
        self.drop_flat = drop_flat

    @property
    def reading(self) -> ReadOptions:
        """The options, for the function that reads."""
        return {
            "merge_points": self.merge_points,
            "allow_gaps": self.allow_gaps,
            "drop_flat": self.drop_flat,
        }


class Compressing(Reading):
    """The part of a format that also compresses.

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
