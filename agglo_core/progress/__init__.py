"""Progress of long computations, reported to a function of the user or shown on stderr."""

from agglo_core.progress.display import followed, shown
from agglo_core.progress.phases import (
    Listener,
    Notify,
    Progress,
    ignore_progress,
    labelled,
    part,
    phase,
    unwrapped,
)
from agglo_core.progress.time_limits import TimeLimit, checked_seconds, noted_limits

__all__ = [
    "Listener",
    "Notify",
    "Progress",
    "TimeLimit",
    "checked_seconds",
    "followed",
    "ignore_progress",
    "labelled",
    "noted_limits",
    "part",
    "phase",
    "shown",
    "unwrapped",
]
