"""The verbs of the command line, and how arguments become one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import or_
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Annotated, Any, cast

from nw_eval import __version__
from nw_eval.cli.verbs.ahead import begin

_VERBS = MappingProxyType(
    {
        "run": "run:Run",
        "check": "check:Check",
        "plan": "judging.plan:PlanTrials",
        "suites": "parts.suites:Suites",
        "baseline": "judging.baseline:Baseline",
        "gate": "judging.gate:GateRun",
        "merge": "judging.merge:MergeRuns",
        "ledger": "judging.ledger:Ledger",
        "bisect": "judging.bisect:BisectSeries",
        "report": "report:Report",
        "compare": "judging.compare:Compare",
        "sweep": "judging.sweep:SweepAxes",
        "agree": "judging.agree:Agree",
        "replay": "replay:Replay",
        "view": "view:ViewTrials",
        "verify": "verify:Verify",
        "blame": "blame:Blame",
        "train": "training.train:Train",
        "study": "training.study:Study",
        "twin": "twin.twin:Twin",
        "policies": "parts.policies:Policies",
        "scenes": "parts.scenes:Scenes",
        "sensors": "parts.sensors:Sensors",
        "splat": "parts.splat:Splat",
        "schema": "parts.schema:Schema",
        "cache": "parts.cache:CacheOfTrials",
        "warmup": "warmup:Warmup",
    }
)
"""Where each of them is, in the order of the help text."""


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


def _verb(name: str) -> Any:
    return resolve_name(f"{__name__}.{_VERBS[name]}")


def _parsed(form: Any, arguments: Sequence[str], **words: Any) -> Callable[[], int]:
    import tyro

    verb = tyro.cli(
        form,
        args=arguments,
        config=(
            tyro.conf.OmitSubcommandPrefixes,
            tyro.conf.FlagCreatePairsOff,
            tyro.conf.DisallowNone,  # Who wants none leaves the option out.
            tyro.conf.PositionalMetavarFromFieldName,
        ),
        **words,
    )
    return cast("Callable[[], int]", verb)
