"""Laws for all kinds: declaration, construction, unchanged input and unchanged process settings."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from agglo_core.conformance.base.law import ASKED, law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.surroundings import Snapshot, enter_empty_folder
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.mesh_cases import TAG
from agglo_core.conformance.inputs.questions import answer, fingerprints, questions
from agglo_core.errors import OptionError
from agglo_core.registry import KINDS
from agglo_core.registry.containment import PLUGIN_FAILURES

_NO_OPTION = "no_such_option"
_REFUSING = {
    "solver": "it refuses every problem: a solver must accept Diffusion or Linear problems, or the kinds "
    "listed in its attribute accepts",
    "discretisation": "it refuses every problem: it must accept Diffusion problems, or the kinds listed in "
    "its attribute accepts",
    "format": (
        "it refuses to write every mesh, even plain triangles: raise an AggloError only for data that the "
        "format cannot store"
    ),
    "constraint": f"it refuses every graph: the test graphs have the cell tag {TAG!r} (graph.data), so set "
    "the option that names a tag to it",
}
"""Remedy if a component that may refuse some cases refuses all of them."""


def _only_reads(subject: Subject) -> bool:
    return subject.kind == "format" and not subject.has("write")


@law(*KINDS)
def builds(subject: Subject) -> None:
    """The component can be built, and an unknown option raises an error that names the component."""
    try:
        subject.make()
    except PLUGIN_FAILURES as error:
        raise Broken(f"building it raised {type(error).__name__}: {error}") from error
    if not subject.takes_options:
        return
    try:
        subject.make(**{_NO_OPTION: 1})
    except (OptionError, TypeError) as error:
        require(
            subject.record is None or subject.name in str(error),
            f"the error {str(error)!r:.60} does not name {subject.name!r}: name the component in the error",
        )
        return
    except PLUGIN_FAILURES as error:
        raise Broken(f"an unknown option raised {type(error).__name__}, not OptionError: {error}") from error
    raise Broken(
        "an unknown option was accepted: name each option in the constructor instead of **options, so that "
        "a misspelt one is noticed"
    )


@law(*KINDS)
def promises_can_be_kept(subject: Subject) -> None:
    """Each promise is checked by some law of the kind."""
    promises = set(KINDS[subject.kind].promises)
    empty = sorted(set(subject.declared) - promises)
    require(
        not empty,
        f"promise {', '.join(empty)} does not apply to a {subject.kind}: remove it (accepted: "
        f"{', '.join(sorted(promises)) or 'none'})",
    )


@law(*(kind for kind in ASKED if kind != "format"))
def surroundings_kept(subject: Subject) -> None:
    """Process settings stay unchanged: np.seterr, environment, folder, warnings, signals, threads, files."""
    remedy = "these settings belong to the program: change them in a with block (np.errstate) or not at all"
    require(not subject.disturbed, f"building it changed {', '.join(subject.disturbed)}: {remedy}")
    tool, before = subject.build(), Snapshot()
    for tools in ((tool,), ()):  # the first round may import modules
        with enter_empty_folder() as folder:
            for case in questions(subject):
                with suppress(Broken):  # judged by the next law
                    answer(subject, *tools or (subject.build(),), case)
            new_files = sorted(path.name for path in folder.iterdir())
            require(Path.cwd() == folder, f"it changed the current folder: {remedy}")
        changed = before.changed()
        before.restore()
        require(not changed, f"it changed {', '.join(changed)}: {remedy}")
        require(not new_files, f"it left {', '.join(new_files)} in the current folder: write no files")
        before = Snapshot()


@law(*ASKED)
def answers(subject: Subject) -> None:
    """Every test mesh gives a result (solvers, discretisations, formats and constraints may refuse some)."""
    test_cases = questions(subject)
    require(
        test_cases or subject.kind not in _REFUSING or _only_reads(subject), _REFUSING.get(subject.kind, "")
    )
    for case in test_cases:
        try:
            answer(subject, subject.build(), case)
        except Broken as error:
            if "read-only" not in str(error.__cause__):  # judged by another law
                raise


@law(*ASKED)
def input_untouched(subject: Subject) -> None:
    """The input is left unchanged."""
    for case in questions(subject):
        before = dict(fingerprints(case.given))
        answer(subject, subject.build(), case)
        after = dict(fingerprints(case.given))
        changed = sorted(path for path in before | after if before.get(path) != after.get(path))
        require(
            not changed,
            f"on {case.name}: it changed its input (argument {', '.join(changed)}): work on a copy",
        )
