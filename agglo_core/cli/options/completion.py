"""Tab completion in the shell: names, options and option values of components, samples, files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    add_completion_class,
    get_completion_class,
    split_arg_string,
)

from agglo_core.cli.options.specs import split_specs
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.output.tables import print_lines
from agglo_core.errors import AggloError
from agglo_core.registry import KINDS, Record, default
from agglo_core.registry.construct import resolve
from agglo_core.registry.option_types import words_of
from agglo_core.registry.options import Option, options_of

Offer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]
"""Completion callback of click, from the text so far: ``shell_complete=`` of an option or argument."""


def names(*kinds: str, several: bool = False, also: tuple[str, ...] = ()) -> Offer:
    """Return a click callback that completes names, options and option values of these component kinds.

    Parameters
    ----------
    several : bool
        Complete a comma-separated component list.
    also : tuple of str
        Further words besides component names.
    """

    def offer(_: click.Context, __: click.Parameter, typed: str) -> list[CompletionItem]:
        return [
            CompletionItem(text, help=about)
            for text, about in _find_continuations(kinds, typed, several, also)
        ]

    return offer


def any_names(_: click.Context, __: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete the name of a component of any kind, as ``NAME`` or ``KIND:NAME``."""
    kind, colon = typed.partition(":")[:2]
    alone = bool(colon) and kind in KINDS
    records = _usable_records((kind,) if alone else tuple(KINDS))
    items = [CompletionItem(f"{kind}:{r.name}" if alone else r.name, help=_summary_of(r)) for r in records]
    return [item for item in items if item.value.startswith(typed)]


samples: Offer = names("sample")
"""Completion of samples with their options."""


def meshes(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete a sample mesh name, or a file name if no sample matches."""
    return samples(context, parameter, typed) or [CompletionItem(typed, type="file")]


def _find_continuations(
    kinds: tuple[str, ...], typed: str, several: bool, also: tuple[str, ...]
) -> Iterator[tuple[str, str]]:
    """Yield the possible completions of the typed text, each with a description.

    After a comma in a list, another component or another option of the previous component may follow.
    """
    last = typed.rpartition(",")[2]
    head = typed[: len(typed) - len(last)]
    specs = split_specs(typed) if several else [typed]
    if "=" not in last and ":" not in last and (several or not head):
        for word, about in [(r.name, _summary_of(r)) for r in _usable_records(kinds)] + [
            (word, "") for word in also
        ]:
            if word.startswith(last):
                yield head + word, about
        specs = [f"{specs[-2]},{last}"] if len(specs) > 1 else specs
    name, colon, options = specs[-1].partition(":")
    if colon:
        before = typed[: len(typed) - len(options.rpartition(",")[2])]
        for text, about in _options(kinds, name, options):
            yield before + text, about


def _options(kinds: tuple[str, ...], name: str, typed: str) -> Iterator[tuple[str, str]]:
    """Yield the option names that may follow those ``typed``, or the last option's values."""
    *typed_options, last = typed.split(",")
    option, equals, value = last.partition("=")
    used_names = {item.partition("=")[0] for item in typed_options}
    candidates = [
        item for record in _usable_records(kinds) if record.name == name for item in _options_of(record)
    ]
    for item in candidates:
        if equals and item.name == option:
            words = [word for word in words_of(item.type) if word.startswith(value)]
            yield from ((f"{option}={word}", "") for word in words)
        elif not equals and item.name not in used_names and item.name.startswith(option):
            yield f"{item.name}=", item.about


def _options_of(record: Record) -> tuple[Option, ...]:
    try:
        return options_of(resolve(record)) or ()
    except AggloError:  # completion must not print errors
        return ()


def _summary_of(record: Record) -> str:
    return record.component.summary if record.component else ""


def _usable_records(kinds: tuple[str, ...]) -> list[Record]:
    return [record for record in default().list() if record.kind in kinds and record.state == "ok"]


_BASH = """\
%(complete_func)s() {
    local kind word
    COMPREPLY=()
    while IFS=, read -r kind word; do
        if [[ $kind == plain ]]; then COMPREPLY+=("$word"); else compopt +o nospace -o default; fi
    done < <(COMP_LINE="$COMP_LINE" COMP_POINT="$COMP_POINT" %(complete_var)s=bash_complete "$1")
}
complete -o nosort -o nospace -F %(complete_func)s %(prog_name)s
"""


class _Bash(BashComplete):
    """Tab completion in bash, which splits words at ``:`` and ``=`` and completes only the last fragment."""

    source_template = _BASH

    def get_completion_args(self) -> tuple[list[str], str]:
        """Return the words before the cursor, and the beginning of the word at the cursor."""
        line = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])]
        words = split_arg_string(line)
        typed = words.pop() if words and not line[-1].isspace() else ""
        self._known = max(typed.rfind(":"), typed.rfind("=")) + 1
        return words[1:], typed

    def format_completion(self, item: CompletionItem) -> str:
        """Return the missing end of a word, followed by a space unless an option value comes next."""
        if item.type != "plain":
            return f"{item.type},"
        text = str(item.value)[self._known :]
        return f"plain,{text}{'' if text.endswith('=') else ' '}"


add_completion_class(_Bash)


@click.command(cls=OwnCommand, short_help="Set up tab completion in the shell.")
@click.argument("shell", type=click.Choice(("bash", "zsh", "fish")))
def completion(shell: str) -> None:
    """Print a script for SHELL to complete commands, options, components with options, and samples.

    bash: put eval "$(agglo completion bash)" into ~/.bashrc, and likewise in ~/.zshrc. fish: agglo
    completion fish > ~/.config/fish/completions/agglo.fish
    """
    kind: Any = get_completion_class(shell)
    print_lines(kind(click.Command("agglo"), {}, "agglo", "_AGGLO_COMPLETE").source())
