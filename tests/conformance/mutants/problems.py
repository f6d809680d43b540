"""Correct kinds of problem, and kinds that break one law first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import Component, Diffusion, OptionError


@dataclass(frozen=True)
class Heat:
    """Problem with a conductivity and a source."""

    kind: ClassVar[str] = "heat"
    conductivity: float = 1.0
    source: float = 1.0

    @classmethod
    def from_table(cls, table, mesh, folder):
        unknown = sorted(set(table) - {"kind", "conductivity", "source"})
        if unknown:
            raise OptionError(f"heat: key {unknown[0]!r} is not known; accepted: conductivity, source")
        return cls(**{name: float(value) for name, value in table.items() if name != "kind"})

    @classmethod
    def example(cls, mesh):
        return cls(conductivity=2.0)


def warm() -> Heat:
    """Factory for a named problem."""
    return Heat(source=3.0)


class Kindless(Heat):
    kind = None


class OtherKind(Heat):
    kind: ClassVar[str] = "warmth"


class ExampleOfAnother(Heat):
    @classmethod
    def example(cls, mesh):
        return Diffusion()


@dataclass
class Fluid:
    kind: ClassVar[str] = "fluid"
    conductivity: float = 1.0
    from_table = classmethod(Heat.from_table.__func__)

    @classmethod
    def example(cls, mesh):
        return cls()


@dataclass(frozen=True, slots=True)
class Slotted:
    """Correct: a frozen dataclass with slots."""

    kind: ClassVar[str] = "slotted"
    conductivity: float = 1.0
    from_table = classmethod(Heat.from_table.__func__)

    @classmethod
    def example(cls, mesh):
        return cls()


class Tuple(NamedTuple):
    """Correct: a named tuple."""

    conductivity: float = 1.0
    source: float = 1.0


class Named(Tuple):
    kind: ClassVar[str] = "named"
    __slots__ = ()
    from_table = classmethod(Heat.from_table.__func__)

    @classmethod
    def example(cls, mesh):
        return cls()


class TakesAnyKey(Heat):
    @classmethod
    def from_table(cls, table, mesh, folder):
        return cls(conductivity=float(table.get("conductivity", 1.0)))


class IgnoresCapitals(Heat):
    @classmethod
    def from_table(cls, table, mesh, folder):
        super().from_table({name.lower(): value for name, value in table.items()}, mesh, folder)
        return cls(conductivity=float(table.get("conductivity", 1.0)), source=float(table.get("source", 1.0)))


class NeedsAKey(Heat):
    @classmethod
    def from_table(cls, table, mesh, folder):
        super().from_table(table, mesh, folder)
        return cls(conductivity=float(table["conductivity"]))


class TakesOutKeys(Heat):
    @classmethod
    def from_table(cls, table, mesh, folder):
        table.pop("kind", None)
        return super().from_table(table, mesh, folder)


_DEFAULTS = {"conductivity": 1.0, "source": 1.0}


class ChangesTheDefaults(Heat):
    @classmethod
    def from_table(cls, table, mesh, folder):
        super().from_table(table, mesh, folder)
        _DEFAULTS.update((name, value) for name, value in table.items() if name != "kind")
        return cls(**_DEFAULTS)


@dataclass(frozen=True)
class WithAFunction(Heat):
    source: object = None

    @classmethod
    def example(cls, mesh):
        return cls(source=lambda x: x[:, 0])


class OtherExamples(Heat):
    @classmethod
    def example(cls, mesh):
        return cls(source=float(np.random.default_rng().random()))


class RaisesOnHexagons(Heat):
    @classmethod
    def example(cls, mesh):
        if "hexagons" in mesh.name:
            raise IndexError("corner 6")
        return cls()


def _product(points):
    return np.sin(np.pi * points).prod(axis=1)


def hill() -> Diffusion:
    """Problem with a known solution in 2-D and 3-D."""
    return Diffusion(source=lambda x: x.shape[1] * np.pi**2 * _product(x), exact=_product)


def hill_of_the_plane() -> Diffusion:
    return Diffusion(source=lambda x: 2 * np.pi**2 * _product(x), exact=_product)


CORRECT = [
    (Heat, {"pickles": True}),
    (Slotted, {"pickles": True}),
    (Named, {"pickles": True}),
    (Component("problem", "heat", f"{__name__}:Heat"), {"pickles": True}),
    (Component("problem", "warm", f"{__name__}:warm"), {"pickles": True}),
    (Component("problem", "hill", f"{__name__}:hill"), {}),
]

MUTANTS = [
    Mutant("answers", RaisesOnHexagons, "corner 6"),
    Mutant("kind_named", Kindless, "ClassVar"),
    Mutant("kind_named", Component("problem", "heat", f"{__name__}:OtherKind"), "use the same name"),
    Mutant("example_given", ExampleOfAnother, "expected a ExampleOfAnother"),
    Mutant("example_given", Fluid, "frozen=True"),
    Mutant("table_read", TakesAnyKey, "no_such_key"),
    Mutant("table_read", IgnoresCapitals, "accepted and ignored"),
    Mutant("table_read", NeedsAKey, "a default"),
    Mutant("table_read", TakesOutKeys, "work on a copy"),
    Mutant("table_read", ChangesTheDefaults, "a copy (dict(defaults))"),
    Mutant("exact_solution_holds", Component("problem", "hill", f"{__name__}:hill_of_the_plane"), "in 3-D"),
    Mutant("same_seed_same_result", OtherExamples, "without a seed"),
    Mutant("pickles", WithAFunction, "no lambdas", {"pickles": True}),
]
