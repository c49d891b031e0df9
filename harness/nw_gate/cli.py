"""`nw-gate judge NEW --baseline OLD`: a verdict from the episodes of any simulator."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from nw_base import __version__
from nw_base.errors import NwEvalError, UsageError
from nw_gate.episodes import Columns, read_evaluation
from nw_gate.judgement import Judgement, JudgeSettings, judge

_EXIT = "exit codes: 0 PASS, 1 REGRESSED, 2 wrong usage or file, 3 INCONCLUSIVE, 5 not comparable"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, and leave with its exit code."""
    parser = _parser()
    given = parser.parse_args(arguments)
    try:
        print(_judge(given))
        code = given.code
    except NwEvalError as error:
        print(f"error: {error}", file=sys.stderr)
        code = error.exit_code
    raise SystemExit(code)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nw-gate", description="Judge policies by the episodes of any simulator."
    )
    parser.add_argument("--version", action="version", version=f"nw-gate {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    verb = verbs.add_parser(
        "judge",
        help="say whether a policy is worse than a baseline",
        description="Say whether a policy is worse than a baseline, over all tasks. Files: "
        "Parquet, CSV, TSV, JSON lines, LeRobot's eval_info.json, logs of inspect_ai (.json, "
        ".eval), averages of robomimic.",
        epilog=_EXIT,
    )
    add, limits = verb.add_argument, JudgeSettings()
    add("new", metavar="NEW", help="the candidate's episodes")
    add("--baseline", metavar="OLD", help="the episodes of what it is compared with")
    add("--bar", type=float, help="mean score that must be reached by itself, 0 to 1")
    for name, words in (
        ("max_drop", "drop of the mean score that must be excluded for PASS"),
        ("tolerate", "drop that counts as equal"),
        ("task_drop", "drop in one task beyond which it is named"),
        ("confidence", "that a PASS is right"),
        ("false_alarm", "largest probability of a wrong REGRESSED"),
    ):
        default = getattr(limits, name)
        flag = f"--{name.replace('_', '-')}"
        add(flag, type=float, default=default, help=f"{words} (default: {default:g})")
    add("--critical", nargs="*", default=[], metavar="TASK", help="tasks that may not fall")
    add("--score", metavar="COLUMN", help="the score's column; `success` and the like by default")
    add("--baseline-score", metavar="COLUMN", help="that of the baseline; as --score by default")
    add("--task", metavar="COLUMNS", help="columns that name the task, with commas")
    add("--start", metavar="COLUMNS", help="columns that name the start, by which pairs are made")
    add("--part", metavar="KEY", help="the evaluation of a JSON file that holds several")
    add("--baseline-part", metavar="KEY", help="that of the baseline")
    add("--range", metavar="LOW,HIGH", default="0,1", help="least and greatest score")
    add("--json", action="store_true", help="print the judgement as JSON")
    return parser


def _judge(given: argparse.Namespace) -> str:
    """Return what is printed; `given.code` becomes the exit code."""
    span = _span(given.range)
    columns = Columns(
        score=given.score, task=given.task, start=given.start, part=given.part, span=span
    )
    others = Columns(
        score=given.baseline_score or given.score,
        task=given.task,
        start=given.start,
        part=given.baseline_part,
        span=span,
    )
    limits = JudgeSettings(
        max_drop=given.max_drop,
        tolerate=given.tolerate,
        task_drop=given.task_drop,
        critical=tuple(given.critical),
        bar=given.bar,
        confidence=given.confidence,
        false_alarm=given.false_alarm,
    )
    new = read_evaluation(given.new, columns)
    old = None if given.baseline is None else read_evaluation(given.baseline, others)
    judgement = judge(new, old, limits)
    given.code = judgement.exit_code
    if given.json:
        fields: dict[str, Any] = {"version": __version__, **asdict(judgement)}
        return json.dumps(fields, indent=2)
    return table(judgement)


def _span(text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        low = high = 0.0
    if not -1e300 < low < high < 1e300:
        raise UsageError(f"--range {text!r} is not a range", fix="give LOW,HIGH, such as 0,100")
    return low, high


def table(judgement: Judgement) -> str:
    """Return the verdict, its reasons, and a line for each task."""
    lines = [judgement.word, *(f"  {why}" for why in judgement.reasons)]
    if judgement.decided_after is not None:
        lines.append(
            f"  settled after {judgement.decided_after} of {judgement.rounds} episodes a task"
        )
    if judgement.paired_by == "order":
        lines.append("  paired by order: the files do not name the same initial states")
    width = max(len(task.task) for task in judgement.tasks)
    lines += ["", f"  {'task':{width}}  episodes  candidate  baseline"]
    for task in judgement.tasks:
        old = "-" if task.baseline is None else f"{task.baseline:.3f}"
        mark = "  fell" if task.fell else ""
        lines.append(
            f"  {task.task:{width}}  {task.pairs:8}  {task.candidate:9.3f}  {old:>8}{mark}"
        )
    old = "-" if judgement.baseline is None else f"{judgement.baseline:.3f}"
    lines.append(f"  {'mean':{width}}  {'':8}  {judgement.candidate:9.3f}  {old:>8}")
    return "\n".join(lines)
