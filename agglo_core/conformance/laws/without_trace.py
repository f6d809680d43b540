"""The law of calls that end early: what is refused or has nothing to do leaves no trace either."""

from __future__ import annotations

import contextlib
import io

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.surroundings import Snapshot, elsewhere, stdout_of_process
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.coarsening_cases import PARTS
from agglo_core.conformance.inputs.early_ends import early_ends
from agglo_core.conformance.inputs.questions import answer, fingerprints, global_random

_KINDS = ("bisector", "refiner", "fixer", "metric", "solver", "smoother", "constraint", *PARTS)


@law(*_KINDS)
def ends_early_without_trace(subject: Subject) -> None:
    """Where it refuses, fails or has nothing to do, it changes no setting, prints and writes nothing."""
    remedy = "a with block (np.errstate) or finally puts things back on every way out"
    for case in early_ends(subject.kind):
        given, before, printed = dict(fingerprints(case.given)), Snapshot(), io.StringIO()
        with elsewhere() as folder, stdout_of_process() as written, contextlib.redirect_stdout(printed):
            with global_random(1) as unmoved:
                with contextlib.suppress(Broken):
                    answer(subject, subject.build(), case)
                still = unmoved()
            text = printed.getvalue() or written().decode(errors="replace")
            left = sorted(path.name for path in folder.iterdir())
        changed = before.changed()
        before.restore()
        require(not changed, f"on {case.name}: it changed {', '.join(changed)}: {remedy}")
        require(not text, f"on {case.name}: it printed {text!r:.60}: say it in the error or in the reason")
        require(still, f"on {case.name}: it drew from, or seeded, the global random state")
        require(not left, f"on {case.name}: it left {', '.join(left)} in the current folder: write no files")
        after = dict(fingerprints(case.given))
        require(given == after, f"on {case.name}: it changed what it was given: work on a copy")
