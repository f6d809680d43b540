"""Feature levels of processors, for machine code that runs on more than the processor it was compiled on."""

from __future__ import annotations

from functools import cache

LEVELS = {
    "generic": "",
    "x86-64-v2": "cx16 popcnt sahf sse3 sse4.1 sse4.2 ssse3",
    "x86-64-v3": "avx avx2 bmi bmi2 f16c fma lzcnt movbe xsave",
    "x86-64-v4": "avx512bw avx512cd avx512dq avx512f avx512vl",
}
"""LLVM's names of the levels, lowest first, and of the features that each adds to the lower ones.

The lowest level contains all processors of an architecture, such as x86-64 or ARMv8.
"""


@cache
def supported_levels(features: str) -> tuple[str, ...]:
    """Return the levels that a processor supports, highest first.

    Parameters
    ----------
    features : str
        Features of the processor in LLVM's notation, with a plus for those that it has.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> supported_levels("+cx16,+popcnt,+sahf,+sse3,+sse4.1,+sse4.2,+ssse3,-avx")
    ('x86-64-v2', 'generic')
    """
    present = {feature[1:] for feature in features.split(",") if feature.startswith("+")}
    levels: list[str] = []
    for level, added in LEVELS.items():
        if not present.issuperset(added.split()):
            break
        levels.insert(0, level)
    return tuple(levels)
