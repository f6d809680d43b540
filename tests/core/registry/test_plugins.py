"""The registry: states, names, attribution; fake plugins as objects and as installed distributions."""

from __future__ import annotations

import logging
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agglo_core.errors import AggloError, MeshError, OptionError, PluginError
from agglo_core.registry import Command, Component, Record, Registry, default, describe, hookimpl

HALVES = Component("bisector", "halves", "halves_target:Halves")

TARGETS = """
from agglo_core.errors import MeshError

class Halves:
    def __init__(self, axis=0, *, tie="low"):
        if axis == "x":
            raise TypeError("axis is a number")
        if axis > 2:
            raise MeshError(f"no axis {axis}")
        self.axis, self.tie = axis, tie
    def bisect(self, graph, rng): ...

class Needy:
    def __init__(self, parts): ...
    def bisect(self, graph, rng): ...

class Level:
    def bisect_level(self, level, seeds): ...

class Direct:
    def partition(self, graph, target, seed): ...

class Moves:
    objective = "interface"
    def refine(self, graph, labels, seeds, target): ...

class Aimless:
    def refine(self, graph, labels, seeds, target): ...

class Mends:
    def fix(self, graph, labels): ...

class Measures:
    def measure(self, mesh, labels): ...

class Solves:
    def solve(self, problem, hierarchy): ...

def factory(axis=1):
    return Halves(axis)

number = 3
"""


def plugin(
    *components: Any, commands: list[Any] | None = None, answer: Any = None, **functions: Callable[..., Any]
) -> SimpleNamespace:
    """A plugin object declaring the given components (or answering ``answer``)."""

    def agglo_components() -> Any:
        return list(components) if answer is None else answer

    def agglo_commands() -> Any:
        return commands

    hooks = {"agglo_components": hookimpl(agglo_components)}
    if commands is not None:
        hooks["agglo_commands"] = hookimpl(agglo_commands)
    return SimpleNamespace(**hooks | functions)


@pytest.fixture(autouse=True)
def _targets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    before = set(sys.modules)
    (tmp_path / "halves_target.py").write_text(TARGETS)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name in set(sys.modules) - before:
        if name.startswith(("halves_", "mine", "bad_")):
            del sys.modules[name]


@pytest.fixture
def registry() -> Registry:
    return Registry()


@pytest.fixture
def install(tmp_path: Path) -> Callable[..., None]:
    """Write a distribution with entry points of the group ``agglo`` and modules on sys.path."""

    def write(distribution: str, version: str, points: str, modules: dict[str, str]) -> None:
        info = tmp_path / f"{distribution.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\nProvides-Extra: extra_one\n"
        )
        (info / "entry_points.txt").write_text(f"[agglo]\n{points}\n")
        for name, source in modules.items():
            (tmp_path / f"{name}.py").write_text(textwrap.dedent(source))

    return write


def declaring(name: str, target: str = "halves_target:Halves", more: str = "") -> str:
    return f"""
from agglo_core import Component, hookimpl

@hookimpl
def agglo_components():
    return [Component(kind="bisector", name={name!r}, target={target!r}, {more})]
"""


def only(registry: Registry, plugin_name: str) -> Record:
    """The single record of a plugin."""
    (record,) = [record for record in registry.list() if record.plugin == plugin_name]
    return record


def test_a_valid_component_is_listed_and_built(registry: Registry) -> None:
    registry.register(plugin(HALVES), "mine", distribution="my-dist", version="0.3")
    record = only(registry, "mine")
    assert (record.component, record.state, record.reason) == (HALVES, "ok", "")
    assert describe(record) == "bisector 'halves' (plugin 'mine', distribution my-dist 0.3)"
    assert registry.record("bisector", "halves") == record
    built = registry.build("bisector", "halves", axis=1, tie="high")
    assert (type(built).__name__, built.axis, built.tie) == ("Halves", 1, "high")


def test_a_factory_is_a_target_too(registry: Registry) -> None:
    registry.register(plugin(Component("bisector", "made", "halves_target:factory")), "mine")
    assert registry.build("bisector", "made").axis == 1


@pytest.mark.parametrize(
    ("kind", "target"),
    [
        ("bisector", "Level"),
        ("bisector", "Direct"),
        ("refiner", "Moves"),
        ("fixer", "Mends"),
        ("metric", "Measures"),
        ("solver", "Solves"),
    ],
)
def test_each_kind_requires_its_method(registry: Registry, kind: str, target: str) -> None:
    registry.register(plugin(Component(kind, "it", f"halves_target:{target}")), "mine")
    assert type(registry.build(kind, "it")).__name__ == target
    wrong = Registry()
    wrong.register(
        plugin(
            Component(kind, "it", "halves_target:Halves" if kind != "bisector" else "halves_target:Mends")
        ),
        "mine",
        distribution="my-dist",
        version="1",
    )
    with pytest.raises(
        PluginError, match=r"\(plugin 'mine', distribution my-dist 1\) built .* with a method"
    ):
        wrong.build(kind, "it")


def test_a_refiner_names_its_objective(registry: Registry) -> None:
    registry.register(plugin(Component("refiner", "it", "halves_target:Aimless")), "mine")
    with pytest.raises(PluginError, match="objective"):
        registry.build("refiner", "it")


def test_options_are_checked_against_the_signature(registry: Registry) -> None:
    registry.register(plugin(HALVES, Component("bisector", "needy", "halves_target:Needy")), "mine")
    with pytest.raises(
        OptionError, match=r"'halves' .* no option 'axes' \(did you mean 'axis'\?\); accepted: axis, tie"
    ):
        registry.build("bisector", "halves", axes=1)
    with pytest.raises(OptionError, match="no option 'name'"):
        registry.build("bisector", "halves", name="x")
    with pytest.raises(OptionError, match=r"'needy' .* needs a value for parts"):
        registry.build("bisector", "needy")


def test_errors_of_constructors_are_attributed(registry: Registry) -> None:
    registry.register(plugin(HALVES), "mine", distribution="my-dist", version="0.3")
    with pytest.raises(
        PluginError, match=r"'halves' \(plugin 'mine', distribution my-dist 0.3\).*axis='x'.*TypeError"
    ) as info:
        registry.build("bisector", "halves", axis="x")
    assert isinstance(info.value.__cause__, TypeError)
    with pytest.raises(MeshError, match="no axis 5"):  # the component's own words pass through
        registry.build("bisector", "halves", axis=5)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("halves_target:Absent", "AttributeError"),
        ("halves_absent:Halves", "ModuleNotFoundError"),
        ("halves_target:number", "expected a class or a factory"),
    ],
)
def test_targets_that_cannot_be_had(registry: Registry, target: str, message: str) -> None:
    registry.register(plugin(Component("bisector", "it", target)), "mine")
    assert only(registry, "mine").state == "ok"  # targets are not imported for a listing
    with pytest.raises(PluginError, match=rf"'it' \(plugin 'mine', registered by hand\).*{message}"):
        registry.build("bisector", "it")


@pytest.mark.parametrize(
    ("component", "reason"),
    [
        (Component("bisektor", "it", "m:C"), "unknown kind 'bisektor'; accepted: bisector, refiner"),
        (Component("bisector", "1st", "m:C"), "'1st' is not an identifier"),
        (Component("refiner", "none", "m:C"), "'none' is not an identifier"),
        (Component("bisector", ["it"], "m:C"), "is not an identifier"),  # type: ignore[arg-type]
        (Component("bisector", "it", "m.C"), "target 'm.C' is not of the form 'module:attribute'"),
        (Component("bisector", "it", "m:C", requires="numpy"), "requires 'numpy' is not a tuple"),  # type: ignore[arg-type]
        (
            Component("bisector", "it", "m:C", promises={"fast": True}),
            "unknown promise 'fast'; accepted: det",
        ),
        (Component("bisector", "it", "m:C", promises={"3d": "yes"}), "expected a bool or a number"),  # type: ignore[dict-item]
        (Component("bisector", "it", "m:C", promises=["3d"]), "not a mapping"),  # type: ignore[arg-type]
        (Component("fixer", "it", "m:C", fallback="kmeans"), "fallback applies to bisectors"),
    ],
)
def test_a_wrong_declaration_is_broken_alone(registry: Registry, component: Component, reason: str) -> None:
    registry.register(plugin(component, HALVES), "mine")
    wrong, valid = registry.list()
    assert wrong.state == "broken"
    assert reason in wrong.reason
    assert valid.state == "ok"


def test_one_name_twice_in_a_plugin_is_broken(registry: Registry) -> None:
    registry.register(plugin(HALVES, HALVES), "mine")
    assert {r.state for r in registry.list()} == {"broken"}
    with pytest.raises(PluginError, match="declared more than once"):
        registry.build("bisector", "halves")


def fails() -> None:
    raise ValueError("not today")


def unmarked() -> None:
    """A hook whose author forgot the decorator."""


def leaves() -> None:
    raise SystemExit(1)


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (plugin(answer=False), "returned False, expected a list of Component"),
        (plugin(answer="halves"), "expected a list of Component"),
        (plugin(answer={"halves": HALVES}), "expected a list of Component"),
        (plugin(answer=["halves"]), r"agglo_components()[0] is 'halves', expected a Component"),
        (plugin(HALVES, commands=[HALVES]), "expected a Command"),
        (plugin(HALVES, agglo_commands=hookimpl(fails)), "agglo_commands() raised ValueError: not today"),
        (plugin(HALVES, agglo_commands=hookimpl(leaves)), "agglo_commands() raised SystemExit"),
        (
            plugin(HALVES, agglo_comands=hookimpl(fails)),
            "unknown hook 'agglo_comands' (did you mean 'agglo_commands'?)",
        ),
        (
            plugin(HALVES, agglo_comands=unmarked),
            "unknown hook 'agglo_comands' (did you mean 'agglo_commands'?)",
        ),
        (plugin(HALVES, agglo_commands=unmarked), "agglo_commands is not marked with @hookimpl"),
        (plugin(HALVES, agglo_level_done=hookimpl(lambda level: None)), "its hooks cannot be registered"),
        (SimpleNamespace(), "no hook is implemented; accepted: agglo_components"),
        (None, "no hook is implemented"),
    ],
)
def test_a_broken_plugin_is_explained_and_out(registry: Registry, broken: Any, reason: str) -> None:
    registry.register(broken, "bad", distribution="bad-dist", version="2")
    registry.register(plugin(Component("bisector", "valid", "halves_target:Halves")), "mine")
    (record,) = [r for r in registry.list() if r.plugin == "bad"]
    assert record.state == "broken"
    assert reason in record.reason
    registry.build("bisector", "valid")
    with pytest.raises(PluginError, match="bad-dist 2") as info:
        registry.build("bisector", "halves")
    assert reason in str(info.value)


def test_a_hook_that_returns_none_is_broken(registry: Registry) -> None:
    registry.register(SimpleNamespace(agglo_components=hookimpl(lambda: None)), "bad")
    assert "returned None, expected a list" in only(registry, "bad").reason


def test_missing_packages_are_named_with_a_remedy(registry: Registry) -> None:
    component = Component("bisector", "it", "m:C", requires=("numpy", "no_such_thing", "sklearn_gone"))
    registry.register(plugin(component), "mine")
    record = only(registry, "mine")
    assert (record.state, record.missing) == ("needs", ("no_such_thing", "sklearn_gone"))
    assert "pip install no_such_thing sklearn_gone" in record.reason
    with pytest.raises(PluginError, match=r"'it' \(plugin 'mine', registered by hand\).*needs no_such_thing"):
        registry.build("bisector", "it")


def test_the_extra_of_a_distribution_is_the_remedy(registry: Registry, install: Callable[..., None]) -> None:
    install(
        "my-dist", "1.0", "extra_one = mine", {"mine": declaring("it", more="requires=('no_such_thing',)")}
    )
    registry.discover({})
    assert "pip install 'my-dist[extra_one]'" in registry.record("bisector", "it").reason


def test_requirements_are_looked_for_and_not_imported(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "halves_heavy.py").write_text("raise RuntimeError('imported')")
    registry.register(plugin(Component("bisector", "it", "m:C", requires=("halves_heavy.part",))), "mine")
    assert only(registry, "mine").state == "ok"
    monkeypatch.setitem(sys.modules, "halves_heavy", None)  # how tests hide a package
    assert only(registry, "mine").state == "needs"


def test_reserved_names_go_to_agglo_in_any_order(registry: Registry) -> None:
    registry.register(plugin(HALVES), "theirs", distribution="their-dist", version="2")
    registry.register(plugin(HALVES), "ours", distribution="agglo", version="1")
    assert registry.record("bisector", "halves").plugin == "ours"
    record = only(registry, "theirs")
    assert record.state == "conflict"
    assert "reserved for bisector 'halves' (plugin 'ours', distribution agglo 1)" in record.reason
    assert "use 'theirs/halves'" in record.reason
    assert registry.record("bisector", "theirs/halves").plugin == "theirs"
    assert registry.build("bisector", "theirs/halves", axis=2).axis == 2
    assert registry.build("bisector", "ours/halves").axis == 0


def test_two_strangers_refuse_both(registry: Registry) -> None:
    registry.register(plugin(HALVES), "a", distribution="dist-a", version="1")
    registry.register(plugin(HALVES), "b", distribution="dist-b", version="2")
    assert [r.state for r in registry.list()] == ["conflict", "conflict"]
    with pytest.raises(PluginError, match=r"distribution dist-a 1.*distribution dist-b 2.*use 'a/halves'"):
        registry.build("bisector", "halves")
    assert registry.build("bisector", "b/halves").axis == 0
    registry.unregister("a")
    assert registry.record("bisector", "halves").plugin == "b"


def test_equal_plugin_names_are_distinguished_by_distribution(registry: Registry) -> None:
    registry.register(plugin(HALVES), "same", distribution="dist-a")
    registry.register(plugin(HALVES), "same", distribution="dist-b")
    assert "use 'dist-a/halves'" in registry.list()[0].reason
    with pytest.raises(PluginError, match=r"dist-a.*or.*dist-b"):
        registry.record("bisector", "same/halves")
    assert registry.record("bisector", "dist-b/halves").distribution == "dist-b"


def test_equal_names_of_different_kinds_do_not_clash(registry: Registry) -> None:
    registry.register(plugin(HALVES), "a")
    registry.register(plugin(Component("fixer", "halves", "halves_target:Mends")), "b")
    assert {r.state for r in registry.list()} == {"ok"}


def test_blocked_before_and_after_registration(registry: Registry) -> None:
    registry.block("early")
    seen: list[int] = []
    watch = {"agglo_level_done": hookimpl(lambda info: seen.append(info["level"]))}
    registry.register(plugin(answer=0), "early")
    registry.register(plugin(HALVES, **watch), "late")
    registry.hook.agglo_level_done(info={"level": 1})
    registry.block("late", "not wanted")
    registry.hook.agglo_level_done(info={"level": 2})
    assert [r.state for r in registry.list()] == ["blocked", "blocked"]
    assert seen == [1]
    with pytest.raises(PluginError, match="blocked: not wanted"):
        registry.build("bisector", "halves")


def test_blocking_the_owner_frees_a_name(registry: Registry) -> None:
    registry.register(plugin(HALVES), "ours", distribution="agglo", version="1")
    registry.register(plugin(HALVES), "theirs", distribution="their-dist", version="2")
    registry.block("ours")
    assert registry.record("bisector", "halves").plugin == "theirs"


def test_hooks_of_a_broken_plugin_are_never_called(registry: Registry) -> None:
    seen: list[Any] = []
    registry.register(plugin(answer=0, agglo_level_done=hookimpl(lambda info: seen.append(info))), "bad")
    watch = hookimpl(lambda info: seen.append(info))
    registry.register(plugin(answer=0, agglo_level_done=watch), "worse")
    registry.hook.agglo_level_done(info={"depth": 1})
    assert seen == []
    registry.unregister("worse")
    registry.register(plugin(agglo_level_done=watch), "mended")
    registry.hook.agglo_level_done(info={"depth": 2})
    assert seen == [{"depth": 2}]


def test_a_watcher_that_raises_does_not_end_the_run(
    registry: Registry, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[int] = []
    registry.register(plugin(HALVES, agglo_level_done=hookimpl(lambda: fails())), "clumsy", distribution="d")
    registry.register(plugin(agglo_level_done=hookimpl(lambda info: seen.append(info["depth"]))), "calm")
    with caplog.at_level(logging.WARNING, "agglo"):
        for depth in (1, 2):
            registry.level_done({"depth": depth})
    assert seen == [1, 2]
    assert [record.getMessage() for record in caplog.records] == [
        "plugin 'clumsy (d)' is not called any more: agglo_level_done() raised ValueError: not today"
    ]
    assert registry.build("bisector", "halves").axis == 0


def test_unknown_names_list_what_there_is(registry: Registry) -> None:
    registry.register(
        plugin(HALVES, Component("bisector", "other", "m:C", requires=("no_such_thing",))), "mine"
    )
    with pytest.raises(
        PluginError,
        match=r"no bisector is named 'halve' \(did you mean 'halves'\?\); available: halves, other \(needs\)",
    ):
        registry.build("bisector", "halve")
    with pytest.raises(PluginError, match=r"unknown kind .* 'bisectors'; expected one of bisector, refiner"):
        registry.record("bisectors", "halves")
    with pytest.raises(PluginError, match="available: none"):
        registry.build("fixer", "any")
    with pytest.raises(PluginError):
        registry.build("bisector", "elsewhere/halves")


def test_names_of_plugins_are_taken_once(registry: Registry) -> None:
    mine = plugin(HALVES)
    registry.register(mine, "mine")
    with pytest.raises(PluginError, match="already registered"):
        registry.register(plugin(), "mine")
    registry.register(mine, "again")
    assert "already registered as plugin 'mine" in only(registry, "again").reason
    with pytest.raises(PluginError, match="no plugin 'x' is registered; registered: again, mine"):
        registry.unregister("x")
    registry.unregister("mine")
    assert [r.plugin for r in registry.list()] == ["again"]


def test_commands_have_states_too(registry: Registry) -> None:
    commands = [Command("train", "halves_target:train"), Command("run", "m:c"), Command("No way", "m:c")]
    registry.register(plugin(commands=commands), "mine")
    train, taken, wrong = registry.commands()
    assert (train.state, train.kind, train.command) == ("ok", "command", commands[0])
    assert taken.state == "conflict"
    assert "use 'mine/run'" in taken.reason
    assert wrong.state == "broken"
    assert registry.record("command", "mine/run").state == "ok"
    assert registry.list() == []


def test_installed_plugins_are_discovered(registry: Registry, install: Callable[..., None]) -> None:
    install(
        "my-dist",
        "0.3",
        "mine = mine\nbad = bad_import\nworse = bad_exit\nodd = not a module!",
        {"mine": declaring("halves"), "bad_import": "1 / 0", "bad_exit": "import sys; sys.exit(1)"},
    )
    registry.discover({})
    assert (
        describe(registry.record("bisector", "halves"))
        == "bisector 'halves' (plugin 'mine', distribution my-dist 0.3)"
    )
    assert registry.build("bisector", "halves").axis == 0
    assert "importing 'bad_import' raised ZeroDivisionError" in only(registry, "bad").reason
    assert "SystemExit" in only(registry, "worse").reason
    assert only(registry, "odd").state == "broken"
    assert any(r.distribution == "agglo" and r.in_tree for r in registry.list())


def test_a_malformed_distribution_hurts_only_itself(
    registry: Registry, install: Callable[..., None], tmp_path: Path
) -> None:
    install("my-dist", "0.3", "mine = mine", {"mine": declaring("halves")})
    install("torn-dist", "1", "no equals sign", {})
    install("binary-dist", "1", "x = y", {})
    (tmp_path / "binary_dist-1.dist-info" / "entry_points.txt").write_bytes(b"[agglo]\n\xff\xfe")
    registry.discover({})
    assert registry.record("bisector", "halves").state == "ok"
    assert "malformed" in only(registry, "torn-dist").reason


def test_a_shadowed_distribution_counts_once(
    registry: Registry, install: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("my-dist", "0.3", "mine = mine", {"mine": declaring("halves")})
    copy = tmp_path / "shadow"
    shutil.copytree(tmp_path / "my_dist-0.3.dist-info", copy / "My_Dist-0.2.dist-info")
    (copy / "My_Dist-0.2.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: My_Dist\nVersion: 0.2\n"
    )
    monkeypatch.setattr(sys, "path", [*sys.path, str(copy)])
    registry.discover({})
    assert only(registry, "mine").version == "0.3"


def test_the_environment_keeps_plugins_from_being_imported(
    install: Callable[..., None], caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    install(
        "my-dist",
        "0.3",
        "mine = mine\nbad = bad_import",
        {"mine": declaring("halves"), "bad_import": "1 / 0"},
    )
    blocked, alone, traced = Registry(), Registry(), Registry()
    blocked.discover({"AGGLO_BLOCK": "bad, mine"})
    assert only(blocked, "mine").reason == "blocked by AGGLO_BLOCK"
    assert only(blocked, "bad").state == "blocked"
    assert "mine" not in sys.modules
    alone.discover({"AGGLO_ONLY": "mine"})
    assert {r.plugin for r in alone.list() if r.state == "ok"} == {"mine"}
    assert only(alone, "bad").reason == "not listed in AGGLO_ONLY"
    traced.discover({"AGGLO_TRACE": "1"})
    trace = capsys.readouterr().err
    assert "my-dist" in trace
    assert "ZeroDivisionError" in trace
    with caplog.at_level(logging.WARNING, "agglo"):
        Registry().discover({"AGGLO_BLOCK": "mien"})
    assert "'mien'" in caplog.text


def test_the_default_registry_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    default.cache_clear()
    monkeypatch.setenv("AGGLO_BLOCK", "kmeans")
    try:
        assert default() is default()
        assert {r.state for r in default().list() if r.plugin == "kmeans"} == {"blocked"}
    finally:
        default.cache_clear()


def test_errors_of_the_registry_are_agglo_errors() -> None:
    assert issubclass(PluginError, AggloError)
