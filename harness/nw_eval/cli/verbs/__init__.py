"""The verbs of the command line, and how arguments become one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from operator import or_
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Annotated, Any, cast

from nw_eval import __version__

_VERBS = MappingProxyType(
    {
        "run": "Run",
        "check": "Check",
        "plan": "PlanTrials",
        "suites": "Suites",
        "baseline": "Baseline",
        "gate": "GateRun",
        "merge": "MergeRuns",
        "ledger": "Ledger",
        "bisect": "BisectSeries",
        "watch": "Watch",
        "report": "Report",
        "compare": "Compare",
        "sweep": "SweepAxes",
        "agree": "Agree",
        "replay": "Replay",
        "scores": "Scores",
        "view": "ViewTrials",
        "verify": "Verify",
        "blame": "Blame",
        "train": "Train",
        "study": "Study",
        "twin": "Twin",
        "policies": "Policies",
        "scenes": "Scenes",
        "robots": "Robots",
        "sensors": "Sensors",
        "splat": "Splat",
        "schema": "Schema",
        "cache": "CacheOfTrials",
        "warmup": "Warmup",
    }
)
"""The class of each of them, in the module of its name; in the order of the help text."""

_FENCELESS = ("--in", "--engine", "--allow", "--render")
"""Beginnings of options with which trials run elsewhere, or in processes that are not forked."""
_HELP = frozenset({"-h", "--help"})


def parse(arguments: Sequence[str], *, description: str) -> Callable[[], int]:
    """Return the verb that the arguments name; calling it returns its exit code.

    Raises:
        SystemExit: help was asked for and printed (0), or the arguments are none (2).
    """
    if list(arguments) == ["--version"]:
        print(f"nw-eval {__version__}")
        raise SystemExit(0)
    begin(arguments)
    import tyro

    # The other verbs take longer to import than many a verb takes to run.
    if arguments and arguments[0] in _VERBS:
        try:
            return _parsed(_verb(arguments[0]), arguments[1:], console_outputs=False)
        except SystemExit:
            pass  # Help, or usage: all verbs say that, which know each other's options.
    verbs = [Annotated[_verb(name), tyro.conf.subcommand(name)] for name in _VERBS]
    return _parsed(reduce(or_, verbs), arguments, prog="nw-eval", description=description)


def begin(arguments: Sequence[str]) -> None:
    """Start what trials are forked from, for a command that will most likely run some.

    It imports for as long as the verb does itself and the run is planned, on another core. Where
    the guess is wrong, it ends with this process.
    """
    if len(arguments) < 2 or arguments[0] != "run" or _HELP & set(arguments):
        return
    if not any(word.replace("_", "-").startswith(_FENCELESS) for word in arguments):
        from nw_eval.rollout.confined.start import prepare

        prepare()


def _verb(name: str) -> Any:
    return resolve_name(f"{__name__}.{name}:{_VERBS[name]}")


def parsers() -> Iterator[tuple[str, Any]]:
    """Yield each verb, in the order of the help text, with argparse's parser of its options."""
    get_parser = resolve_name("tyro.extras:get_parser")  # Deprecated for parsing, not for reading.
    for name in _VERBS:
        yield name, get_parser(_verb(name), prog=f"nw-eval {name}", config=_config())


def _parsed(form: Any, arguments: Sequence[str], **words: Any) -> Callable[[], int]:
    import tyro

    verb = tyro.cli(form, args=arguments, config=_config(), **words)
    return cast("Callable[[], int]", verb)


def _config() -> tuple[Any, ...]:
    from tyro import conf

    return (
        conf.OmitSubcommandPrefixes,
        conf.FlagCreatePairsOff,
        conf.DisallowNone,  # Who wants none leaves the option out.
        conf.PositionalMetavarFromFieldName,
    )
