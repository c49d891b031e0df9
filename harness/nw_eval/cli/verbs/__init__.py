"""The verbs of the command line, and how arguments become one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, cast

import tyro

from nw_eval import __version__
from nw_eval.cli.verbs.blame import Blame
from nw_eval.cli.verbs.check import Check
from nw_eval.cli.verbs.judging.agree import Agree
from nw_eval.cli.verbs.judging.baseline import Baseline
from nw_eval.cli.verbs.judging.bisect import BisectSeries
from nw_eval.cli.verbs.judging.compare import Compare
from nw_eval.cli.verbs.judging.gate import GateRun
from nw_eval.cli.verbs.judging.ledger import Ledger
from nw_eval.cli.verbs.judging.merge import MergeRuns
from nw_eval.cli.verbs.judging.plan import PlanTrials
from nw_eval.cli.verbs.parts.cache import CacheOfTrials
from nw_eval.cli.verbs.parts.policies import Policies
from nw_eval.cli.verbs.parts.scenes import Scenes
from nw_eval.cli.verbs.parts.schema import Schema
from nw_eval.cli.verbs.parts.sensors import Sensors
from nw_eval.cli.verbs.parts.splat import Splat
from nw_eval.cli.verbs.parts.suites import Suites
from nw_eval.cli.verbs.replay import Replay
from nw_eval.cli.verbs.report import Report
from nw_eval.cli.verbs.run import Run
from nw_eval.cli.verbs.training.study import Study
from nw_eval.cli.verbs.training.train import Train
from nw_eval.cli.verbs.verify import Verify
from nw_eval.cli.verbs.warmup import Warmup

Verb = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[PlanTrials, tyro.conf.subcommand("plan")]
    | Annotated[Suites, tyro.conf.subcommand("suites")]
    | Annotated[Baseline, tyro.conf.subcommand("baseline")]
    | Annotated[GateRun, tyro.conf.subcommand("gate")]
    | Annotated[MergeRuns, tyro.conf.subcommand("merge")]
    | Annotated[Ledger, tyro.conf.subcommand("ledger")]
    | Annotated[BisectSeries, tyro.conf.subcommand("bisect")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Agree, tyro.conf.subcommand("agree")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Verify, tyro.conf.subcommand("verify")]
    | Annotated[Blame, tyro.conf.subcommand("blame")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Study, tyro.conf.subcommand("study")]
    | Annotated[Policies, tyro.conf.subcommand("policies")]
    | Annotated[Scenes, tyro.conf.subcommand("scenes")]
    | Annotated[Sensors, tyro.conf.subcommand("sensors")]
    | Annotated[Splat, tyro.conf.subcommand("splat")]
    | Annotated[Schema, tyro.conf.subcommand("schema")]
    | Annotated[CacheOfTrials, tyro.conf.subcommand("cache")]
    | Annotated[Warmup, tyro.conf.subcommand("warmup")]
)


def parse(arguments: Sequence[str], *, description: str) -> Callable[[], int]:
    """Return the verb that the arguments name; calling it returns its exit code.

    Raises:
        SystemExit: help was asked for and printed (0), or the arguments are none (2).
    """
    if list(arguments) == ["--version"]:
        print(f"nw-eval {__version__}")
        raise SystemExit(0)
    verb = tyro.cli(
        Verb,  # pyright: ignore[reportArgumentType]
        args=arguments,
        prog="nw-eval",
        description=description,
        config=(
            tyro.conf.OmitSubcommandPrefixes,
            tyro.conf.FlagCreatePairsOff,
            tyro.conf.DisallowNone,  # Who wants none leaves the option out.
            tyro.conf.PositionalMetavarFromFieldName,
        ),
    )
    return cast("Callable[[], int]", verb)
