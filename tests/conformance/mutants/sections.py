"""Correct report sections, and sections that break one law first."""

from __future__ import annotations

import html
import random

from conformance.mutants.mutant import Mutant


class Parts:
    """List of runs with their parts."""

    title = "Parts"

    def html(self, mesh, runs):
        items = [
            f"<li>{html.escape(run.name)}: "
            + (html.escape(run.error) if run.hierarchy is None else f"{run.hierarchy.parts}")
            + "</li>"
            for run in runs
        ]
        return f"<p>{html.escape(mesh.name)}</p><ul>{''.join(items)}</ul>"


class Untitled(Parts):
    title = " "


class ListOfLines(Parts):
    def html(self, mesh, runs):
        return super().html(mesh, runs).split("<li>")


class BringsAScript(Parts):
    def html(self, mesh, runs):
        return super().html(mesh, runs) + "<script>alert(1)</script>"


class LoadsAPicture(Parts):
    def html(self, mesh, runs):
        return super().html(mesh, runs) + '<img src="https://example.org/dot.png">'


class RawNames(Parts):
    def html(self, mesh, runs):
        return "".join(f"<p>{run.name} {run.error}</p>" for run in runs)


class WantsEveryRun(Parts):
    def html(self, mesh, runs):
        return "".join(f"<p>{run.hierarchy.parts}</p>" for run in runs)


class ReversesRuns(Parts):
    def html(self, mesh, runs):
        runs.reverse()
        return super().html(mesh, runs)


class NumbersItself(Parts):
    def __init__(self):
        self.times = 0

    def html(self, mesh, runs):
        self.times += 1
        return f"{self.times}. {super().html(mesh, runs)}"


class DrawsAnId(Parts):
    def html(self, mesh, runs):
        return f'<p id="{random.random()}">{len(runs)}</p>'


CORRECT = [(Parts, {"pickles": True})]

MUTANTS = [
    Mutant("answers", WantsEveryRun, "'NoneType' object"),
    Mutant("surroundings_kept", ReversesRuns, "work on a copy"),
    Mutant("titled", Untitled, "heading of the section"),
    Mutant("static_html", ListOfLines, "expected a string"),
    Mutant("static_html", BringsAScript, "<script"),
    Mutant("static_html", LoadsAPicture, "one static file"),
    Mutant("static_html", RawNames, "html.escape"),
    Mutant("same_seed_same_result", NumbersItself, "keep nothing between calls"),
    Mutant("surroundings_kept", DrawsAnId, "draw from"),
]
