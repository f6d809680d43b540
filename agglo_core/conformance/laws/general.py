"""Laws for all kinds: declaration, construction, side effects and answers."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

from agglo_core.conformance.base import ASKED, Broken, Subject, law, require
from agglo_core.conformance.base.surroundings import Snapshot, enter_empty_folder, stdout_of_process
from agglo_core.conformance.inputs.cases import cases, failing
from agglo_core.conformance.inputs.mesh_cases import TAG
from agglo_core.conformance.inputs.questions import (
    answer,
    fingerprints,
    global_random,
    plain,
    questions,
    questions_in_3d,
    select_accepted,
)
from agglo_core.errors import OptionError
from agglo_core.registry import KINDS
from agglo_core.registry.containment import PLUGIN_FAILURES

_NO_OPTION = "no_such_option"
_REFUSING = {
    "solver": "it refuses every problem: a solver must accept Diffusion or Linear problems, or the kinds "
    "listed in its attribute accepts",
    "discretisation": "it refuses every problem: it must accept Diffusion problems, or the kinds listed in "
    "its attribute accepts",
    "estimator": "it refuses every solution: it must accept solutions of the Diffusion problems that the "
    "solver direct returns",
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
    """Each promise is checked by some law of the kind, and a direct partition is promised by ``kway``."""
    promises = set(KINDS[subject.kind].promises)
    empty = sorted(set(subject.declared) - promises)
    require(
        not empty,
        f"promise {', '.join(empty)} does not apply to a {subject.kind}: remove it (accepted: "
        f"{', '.join(sorted(promises)) or 'none'})",
    )
    kway = subject.promised("kway") is not None
    require(
        subject.partitions or not kway,
        "it promises kway but has no method partition(graph, target, seed)",
    )
    require(
        kway or subject.record is None or not subject.partitions,
        "it has a method partition: promise it, {'kway': True}",
    )


@law(*KINDS)
def surroundings_kept(subject: Subject) -> None:
    """A call, even if it fails, changes neither its input nor its process, and prints and writes nothing."""
    remedy = "these settings belong to the program: change them in a with block (np.errstate) or not at all"
    require(not subject.disturbed, f"building it changed {', '.join(subject.disturbed)}: {remedy}")
    before = Snapshot()
    small = [*cases(subject.kind, "one cell"), *failing(subject.kind), *questions_in_3d(subject)[:3]]
    test_cases = [*questions(subject), *small]
    for case in test_cases[:1]:
        with contextlib.suppress(Broken):
            answer(subject, case)  # the first call may import modules
    before.restore()
    for case in test_cases:
        given, before, printed = dict(fingerprints(case.given)), Snapshot(), io.StringIO()
        with (
            enter_empty_folder() as folder,
            stdout_of_process() as read_output,
            contextlib.redirect_stdout(printed),
            global_random(1) as random_kept,
        ):
            with contextlib.suppress(Broken):  # judged by other laws
                answer(subject, case)
            text = printed.getvalue() or read_output().decode(errors="replace")
            new_files = sorted(path.name for path in folder.iterdir())
            left_folder = Path.cwd() != folder
            drew = not random_kept()
        settings = ["the current folder"] * left_folder + before.changed()
        before.restore()
        after = dict(fingerprints(case.given))
        changed = sorted(path for path in given | after if given.get(path) != after.get(path))
        require(not settings, f"on {case.name}: it changed {', '.join(settings)}: {remedy}")
        require(
            not text,
            f"on {case.name}: it printed {text!r:.60}: use logging.getLogger(__name__) instead of print",
        )
        require(
            not drew,
            f"on {case.name}: it drew from, or seeded, the global random state: draw from the generator (or "
            "from np.random.default_rng(seed)) it is given",
        )
        require(not new_files, f"on {case.name}: it left {', '.join(new_files)} in the current folder")
        require(
            not changed,
            f"on {case.name}: it changed its input (argument {', '.join(changed)}): work on a copy",
        )


@law(*ASKED)
def answers(subject: Subject) -> None:
    """Every test mesh gives a result of the form that its kind requires (some kinds may refuse some)."""
    test_cases = questions(subject)
    require(
        test_cases or subject.kind not in _REFUSING or _only_reads(subject), _REFUSING.get(subject.kind, "")
    )
    for case in [*test_cases, *select_accepted(subject, cases(subject.kind, "one cell"))]:
        plain(subject, case)
