"""How far a long computation has come: told to a callable of the caller, or shown on stderr."""

from agglo_core.progress.display import followed, shown
from agglo_core.progress.phases import Listener, Progress, Tell, labelled, part, phase, to_nobody, unwrapped

__all__ = [
    "Listener",
    "Progress",
    "Tell",
    "followed",
    "labelled",
    "part",
    "phase",
    "shown",
    "to_nobody",
    "unwrapped",
]
