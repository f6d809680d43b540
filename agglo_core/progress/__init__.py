"""Progress of long computations, reported to a function of the user or shown on stderr."""

from agglo_core.progress.display import followed, shown
from agglo_core.progress.phases import Listener, Progress, Tell, labelled, part, phase, to_nobody, unwrapped
from agglo_core.progress.time_limits import TimeLimit, checked_seconds, noted_limits

__all__ = [
    "Listener",
    "Progress",
    "Tell",
    "TimeLimit",
    "checked_seconds",
    "followed",
    "labelled",
    "noted_limits",
    "part",
    "phase",
    "shown",
    "to_nobody",
    "unwrapped",
]
