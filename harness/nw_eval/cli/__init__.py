"""The command line: one small module for each verb; all of them call `nw_eval.api`.

Exit codes: 0 PASS or RAN (a suite without a bar), 1 REGRESSED, 2 usage, suite, scene or policy
error, 3 INCONCLUSIVE, 4 errors left or trials missing, 5 not comparable, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Annotated

import tyro

from nw_eval import __version__
from nw_eval.cli.check import Check
from nw_eval.cli.policies import Policies
from nw_eval.cli.replay import Replay
from nw_eval.cli.report import Report
from nw_eval.cli.run import Run
from nw_eval.cli.scenes import Scenes
from nw_eval.cli.schema import Schema
from nw_eval.cli.sensors import Sensors
from nw_eval.cli.splat import Splat
from nw_eval.cli.suites import Suites
from nw_eval.cli.warmup import Warmup
from nw_eval.errors import NwEvalError

_DESCRIPTION = """May this policy checkpoint ship?

Rolls a legged robot's checkpoint out in digital twins of real places, scores the share of
waypoints reached, and gives a verdict as an exit code: 0 PASS, or RAN where the suite has no bar,
1 REGRESSED, 2 usage or suite error, 3 INCONCLUSIVE, 4 errors left or trials missing, 5 not
comparable, 130 interrupted."""

Verb = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Suites, tyro.conf.subcommand("suites")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Policies, tyro.conf.subcommand("policies")]
    | Annotated[Scenes, tyro.conf.subcommand("scenes")]
    | Annotated[Sensors, tyro.conf.subcommand("sensors")]
    | Annotated[Splat, tyro.conf.subcommand("splat")]
    | Annotated[Schema, tyro.conf.subcommand("schema")]
    | Annotated[Warmup, tyro.conf.subcommand("warmup")]
)

_INTERRUPTED = 130  # 128 + SIGINT, what a shell expects of an interrupted command.


def main(argv: Sequence[str] | None = None) -> None:
    """Run one verb and leave with its exit code; known errors are one line on stderr."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ["--version"]:
        print(f"nw-eval {__version__}")
        sys.exit(0)
    verb = tyro.cli(
        Verb,  # pyright: ignore[reportArgumentType]
        args=arguments,
        prog="nw-eval",
        description=_DESCRIPTION,
        config=(
            tyro.conf.OmitSubcommandPrefixes,
            tyro.conf.FlagCreatePairsOff,
            tyro.conf.DisallowNone,  # Who wants none leaves the option out.
            tyro.conf.PositionalMetavarFromFieldName,
        ),
    )
    sys.exit(_run(verb))


def _run(verb: Callable[[], int]) -> int:
    try:
        return verb()
    except NwEvalError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        # The reader of our output left (`nw-eval ... | head`); the interpreter's own flush at
        # exit would complain once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
