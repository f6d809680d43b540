"""Fake plugin distributions, each with one typical mistake of an author."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path

from thirdparty.installing import write_wheel

__all__ = ["FAKES", "MISBEHAVING", "Fake", "Use", "plain_fakes"]


@dataclass(frozen=True)
class Use:
    """Command line that uses the fake, and the text expected in its one-line error besides the origin."""

    arguments: str
    complaint: str


@dataclass(frozen=True)
class Fake:
    """Distribution ``agglo-NAME`` with the plugin NAME: declaration, code, state, and errors in use."""

    name: str
    declaration: str
    state: str
    reason: str = ""
    code: str = ""
    uses: tuple[Use, ...] = ()
    version: str = "0.1"

    @property
    def origin(self) -> str:
        """Origin of the component, as messages name it."""
        return f"distribution agglo-{self.name} {self.version}"

    def wheel(self, folder: Path) -> Path:
        """Write the wheel to ``folder``."""
        module = f"agglo_{self.name}"
        files = {f"{module}/__init__.py": self.declaration, f"{module}/code.py": self.code}
        return write_wheel(folder, f"agglo-{self.name}", self.version, files, f"{self.name} = {module}")


def _declares(*components: str, hook: str = "agglo_components", answer: str = "") -> str:
    return textwrap.dedent(f"""
        from agglo_core import Command, Component, hookimpl

        @hookimpl
        def {hook}():
            return {answer or "[" + ", ".join(components) + "]"}
        """)


def _component(plugin: str, kind: str = "bisector", name: str = "", more: str = "") -> str:
    return f"Component({kind!r}, {name or plugin!r}, 'agglo_{plugin}.code:Part', {more})"


def _run(bisector: str, more: str = "") -> str:
    return f"run strip:n=8 --bisector {bisector} --parts 4 {more}".rstrip()


def _use(bisector: str, complaint: str) -> tuple[Use, ...]:
    return (Use(_run(bisector), complaint),)


def _bisecting(body: str, init: str = "") -> str:
    """Return a module whose ``Part`` bisects by ``body``."""
    head = "import sys\nimport time\nimport numpy as np\n\nclass Part:\n"
    return f"{head}{init}    def bisect(self, graph, rng):\n        {body}\n"


def _bisects(name: str, body: str, complaint: str, *, init: str = "", more: str = "") -> Fake:
    """Return a plugin with state ok whose bisector has this ``body``."""
    code, declaration = _bisecting(body, init), _declares(_component(name, more=more))
    return Fake(name, declaration, "ok", "", code, _use(name, complaint))


def _helps(name: str, kind: str, signature: str, body: str, complaint: str) -> Fake:
    """Return a plugin with state ok whose refiner or fixer has this ``body``."""
    code = f"class Part:\n    objective = 'interface'\n    def {signature}:\n        {body}\n"
    use = Use(_run("comb", f"--{kind} {name}"), complaint)
    return Fake(name, _declares(_component(name, kind)), "ok", "", code, (use,))


_HALVES = "return np.arange(graph.n) >= (graph.n + 1) // 2"
_WORKS = _bisecting(_HALVES)
_LACKING = "No module named 'no_such_package'"
_REFINE = "refine(self, graph, labels, seeds, target)"

_UNLOADABLE = (
    Fake(
        "torn",
        "raise ImportError('libtorn.so.3: cannot open shared object file')",
        "broken",
        "importing 'agglo_torn' raised ImportError: libtorn.so.3: cannot open",
        uses=_use("torn", "libtorn.so.3: cannot open shared object file"),
    ),
    Fake("orphan", "import no_such_package", "broken", _LACKING, uses=_use("orphan", _LACKING)),
    Fake("quitter", "raise SystemExit(7)", "broken", "SystemExit: 7", uses=_use("quitter", "SystemExit: 7")),
    Fake(
        "misspelt",
        _declares(_component("misspelt"), hook="agglo_component"),
        "broken",
        "unknown hook 'agglo_component' (did you mean 'agglo_components'?)",
        uses=_use("misspelt", "did you mean 'agglo_components'?"),
    ),
    Fake(
        "rubbish",
        _declares(answer="'rubbish'"),
        "broken",
        "agglo_components() returned 'rubbish', expected a list of Component",
        uses=_use("rubbish", "expected a list of Component"),
    ),
    Fake(
        "untyped",
        _declares(answer="[{'kind': 'bisector', 'name': 'untyped'}]"),
        "broken",
        "expected a Component",
        uses=_use("untyped", "expected a Component"),
    ),
    Fake(
        "vain",
        _declares(_component("vain", more="promises={'best': True}")),
        "broken",
        "unknown promise 'best'; accepted: deterministic",
        _WORKS,
        _use("vain", "unknown promise 'best'"),
    ),
    Fake(
        "needy",
        _declares(_component("needy", more="requires=('numpy', 'no_such_package')")),
        "needs",
        "needs no_such_package, not installed here; try: pip install no_such_package",
        _WORKS,
        _use("needy", "pip install no_such_package"),
    ),
)

_CLASHING = (
    Fake(
        "usurper", _declares(_component("usurper", name="kmeans")), "conflict", "use 'usurper/kmeans'", _WORKS
    ),
    Fake(
        "runner",
        _declares("Command('run', 'agglo_runner.code:run')", hook="agglo_commands"),
        "conflict",
        "the name is reserved for a built-in command of agglo; use 'runner/run'",
        "import click\n\n@click.command()\ndef run():\n    click.echo('mine')\n",
    ),
    *(
        Fake(
            twin,
            _declares(_component(twin, name="twins")),
            "conflict",
            f"the name is also declared by bisector 'twins' (plugin '{other}', distribution agglo-{other}",
            _WORKS,
            _use("twins", "use 'castor/twins'"),
            version,
        )
        for twin, other, version in (("castor", "pollux", "1.0"), ("pollux", "castor", "2.0"))
    ),
)

MISBEHAVING = (
    _bisects(
        "stillborn",
        _HALVES,
        "could not be built with no options: KeyError: 'HOME_OF_STILLBORN'",
        init="    def __init__(self):\n        raise KeyError('HOME_OF_STILLBORN')\n",
    ),
    _bisects(
        "long", "return np.zeros(graph.n + 1, int)", "bisect returned shape (9,) of int64, expected (8,)"
    ),
    _bisects("nan", "return np.full(graph.n, np.nan)", "probabilities that are NaN or outside [0, 1]"),
    _bisects("above", "return np.arange(graph.n) / 2.0", "probabilities that are NaN or outside [0, 1]"),
    _bisects("onetwo", "return 1 + np.arange(graph.n) % 2", "returned sides 1..2, expected 0 and 1"),
    _bisects("words", "return np.full(graph.n, 'left')", "expected integers, booleans or floats"),
    _bisects("silent", "pass", "bisect returned None, expected ("),
    _bisects("onesided", "return np.ones(graph.n, int)", "put all 8 cells of a piece on one side"),
    _bisects(
        "scribbler", "graph.measures[:] = 1.0; return graph.n", "ValueError: assignment destination is read"
    ),
    _bisects("leaver", "sys.exit('enough')", "raised SystemExit: enough"),
    _bisects("memory", "raise MemoryError('all gone')", "raised MemoryError: all gone"),
    _helps("dropper", "refiner", _REFINE, "return labels * 0", "emptied part 1 of block 0"),
    _helps("inventor", "refiner", _REFINE, "return labels + 1", "created labels 1..2 beyond 0..1"),
    _helps("halfway", "refiner", _REFINE, "return labels * 0.5", "expected (8,) integers"),
    _helps("idle", "fixer", "fix(self, graph, labels)", "return labels", "left a part disconnected"),
    Fake(
        "methodless",
        _declares(_component("methodless")),
        "ok",
        code="class Part: ...",
        uses=_use(
            "methodless", "expected an object with a method bisect_level(…) or bisect(…) or partition(…)"
        ),
    ),
    Fake("gone", _declares(_component("gone")), "ok", uses=_use("gone", "AttributeError")),
)

_COMMANDS = (
    Fake(
        "nowhere",
        _declares("Command('nowhere', 'agglo_nowhere.code:nowhere')", hook="agglo_commands"),
        "ok",
        uses=(Use("nowhere", "importing its target 'agglo_nowhere.code:nowhere' raised AttributeError"),),
    ),
    Fake(
        "number",
        _declares("Command('number', 'agglo_number.code:number')", hook="agglo_commands"),
        "ok",
        code="number = 3",
        uses=(Use("number --big", "its target is 3, expected a click command"),),
    ),
)

_LEFT_ALONE = (
    # hangs: used only by a check with a timeout
    Fake("sleeper", _declares(_component("sleeper")), "ok", code=_bisecting("time.sleep(99)")),
    # alternating sides: every part falls apart, and the fixer must repair this
    Fake(
        "comb",
        _declares(_component("comb")),
        "ok",
        code=_bisecting("return np.arange(graph.n) % 2"),
    ),
    # one-sided, but declares a fallback
    Fake(
        "modest",
        _declares(_component("modest", more="fallback='coordinate'")),
        "ok",
        code=_bisecting("return np.zeros(graph.n, int)"),
    ),
    Fake(
        "heckler",
        _declares(_component("heckler"))
        + "\n@hookimpl\ndef agglo_level_done(info):\n    raise RuntimeError('boo')\n",
        "ok",
        code=_WORKS,
    ),
)

FAKES = (*_UNLOADABLE, *_CLASHING, *MISBEHAVING, *_COMMANDS, *_LEFT_ALONE)


def plain_fakes(count: int) -> list[Fake]:
    """Return ``count`` working plugins whose code would import heavy packages."""
    heavy = "import matplotlib, networkx, numba, scipy, shapely\n"
    names = [f"extra{i}" for i in range(count)]
    return [Fake(name, _declares(_component(name)), "ok", code=heavy + _WORKS) for name in names]
