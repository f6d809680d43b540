"""Components that break one law first (mutants), and the correct components they derive from, by kind."""

from conformance.mutants import (
    bisectors,
    constraints,
    discretisations,
    elsewhere,
    estimators,
    forgetful,
    formats,
    honest,
    labellers,
    metrics,
    multigrid_parts,
    numbered,
    overwhelmed,
    problems,
    ragged,
    samples,
    sections,
    smoothers,
    solvers,
    touching,
    two_sided,
    units,
    written,
)

_KINDS = (
    bisectors,
    honest,
    labellers,
    metrics,
    numbered,
    solvers,
    formats,
    samples,
    problems,
    discretisations,
    estimators,
    smoothers,
    touching,
    two_sided,
    multigrid_parts,
    constraints,
    sections,
    forgetful,
    overwhelmed,
    ragged,
    elsewhere,
    units,
    written,
)
MUTANTS = [mutant for kind in _KINDS for mutant in kind.MUTANTS]
CORRECT = [given for kind in _KINDS for given in kind.CORRECT]

NEWCOMERS = [
    bisectors.OneAndTwo,
    bisectors.NamesOfSides,
    bisectors.ForgetsTheSeed,
    bisectors.LevelWideScale,
    bisectors.ScalesInPlace,
    bisectors.FloatsAboveOne,
    bisectors.SwapsSides,
    bisectors.CrashesOnOneCell,
    labellers.DropsALabel,
    bisectors.GlobalNumpy,
]
"""Ten typical bugs of newcomers."""
