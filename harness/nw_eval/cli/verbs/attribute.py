"""`nw-eval attribute`: from when on a run's failures could not be averted."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_base.clean import clean
from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.terminal.time_left import TimeLeft
from nw_eval.cli.verbs.shared import AllowCode, Checkpoint, Workers

if TYPE_CHECKING:
    from nw_eval.api import AttributedTrial, Attribution, AttributionPlan
    from nw_sim.rollout.replaying.reports import AttributionReport


@dataclass(frozen=True, kw_only=True)
class Attribute:
    """Find the last moment of each failed trial from which a baseline still completes it.

    Replays the trial and hands control to the baseline at evenly spaced times, then by bisection.
    The output says if there is no single point of no return.

    If the suite measures scores, the output also shows when the trial first exceeded a joint or
    motor limit (`limit_time`) or violated what the suite expects, and when the baseline did.

    --cause tells perception from control: it runs all four combinations of old and new perception
    and control and splits the drop between them. The run's reports show the result.
    """

    run: tyro.conf.Positional[Path]
    """A run folder with its mcap/."""
    baseline: str
    """The baseline (a name or path) whose policy takes over, or a policy if the suite has no such
    baseline."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """Where the baseline's policy is (default: the path in the baseline)."""
    checkpoint: Checkpoint = None
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """Failed trials to analyse, worst first; each takes about as long as ten others (default: 10).
    With --cause: trials per scene (default: the run's number)."""
    cause: bool = False
    """Combine perception and control of the run's policy and the baseline's."""
    out: Path | None = None
    """Write the result to this .md or .json file, too. With --cause, the folder of the four
    policies' runs (default: one in the run folder)."""
    allow_code: AllowCode = False
    workers: Workers = None

    def __call__(self) -> int:
        return self._cause() if self.cause else self._since_when()

    def _cause(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.lines import aligned
        from nw_eval.cli.terminal.progress import RunProgress
        from nw_eval.reporting.tables.cause import answer_words, cause_table

        with RunProgress() as progress:
            cause = api.find_cause(
                self.run,
                baseline=self.baseline,
                policy=self.policy,
                checkpoint=self.checkpoint,
                trials=self.trials,
                workers=self.workers,
                allow_code=self.allow_code,
                out=self.out,
                listener=progress,
            )
        table = cause_table(cause.cause)
        print("\n".join(aligned([table.columns, *table.rows], right={2, 3, 4})))
        print(answer_words(cause.cause))
        page = api.report(self.run).page
        print(f"{cause.out / 'cause.md'}; in the run's report, too: {page}")
        return 0

    def _since_when(self) -> int:
        from nw_eval import api
        from nw_eval.api.attribution import AT_MOST
        from nw_eval.cli.terminal.final_output import tell

        heard = _Heard()
        if self.out is not None:
            self._check_out(self.out)
        attribution = api.attribute(
            self.run,
            baseline=self.baseline,
            policy=self.policy,
            checkpoint=self.checkpoint,
            trials=AT_MOST if self.trials is None else self.trials,
            workers=self.workers,
            allow_code=self.allow_code,
            planned=lambda plan: tell(heard.planned(plan)),
            ended=lambda trial: tell(heard.ended(trial)),
        )
        print(attribution_page(attribution))
        if self.out is not None:
            from nw_base.files.cache import atomic_path, followed

            with atomic_path(followed(self.out)) as temporary:
                temporary.write_text(written(attribution, self.out.suffix), encoding="utf-8")
            print(self.out)
        return 0

    @staticmethod
    def _check_out(out: Path) -> None:
        from nw_base.errors import UsageError

        if out.suffix not in {".md", ".json"}:
            raise UsageError(f"--out {out} is neither .md nor .json", fix="give it one ending")


class _Heard:
    """Says what is to be done, then each trial's result and how long the others still take."""

    def __init__(self) -> None:
        self._left, self._open = TimeLeft(), 0

    def planned(self, plan: AttributionPlan) -> str:
        """Return the line before the first trial."""
        self._open = plan.chosen
        self._left.restart()
        return forecast_line(plan)

    def ended(self, trial: AttributedTrial) -> str:
        """Return the line for a trial."""
        self._open -= 1
        self._left.ended()
        left = self._left.in_words(self._open)
        more = f" ({plural(self._open, 'trial')} to go, {left})" if left else ""
        return f"{trial_line(trial)}{more}"


_EVENTS = {
    "collided": "the contact",
    "fell": "the fall",
    "off_course": "leaving the course",
    "policy_failed": "the policy's failure",
    "stuck": "it counted as stuck",
    "timeout": "the timeout",
}
_COLUMNS = ("trial", "ended", "at", "committed at", "before its end", "the baseline")


def forecast_line(plan: AttributionPlan) -> str:
    """Return what is to be done, and what it costs."""
    left = plan.failed - plan.chosen - plan.without_log
    what = f"{plan.baseline} takes over in {plural(plan.chosen, 'failed trial')}"
    cost = f"about {plan.minutes:.1f} minutes with --workers {plan.workers}"
    words = [f"{what}, at most {plan.tries} times in each: {cost}"]
    if left > 0:
        words.append(f"{left} more are skipped; --trials {plan.chosen + left} includes them")
    if plan.without_log:
        words.append(f"{plural(plan.without_log, 'failed trial')} without a log")
    return "; ".join(words)


def trial_line(trial: AttributedTrial) -> str:
    """Return what came of one trial."""
    return clean(f"{trial.trial}: {_sentence(trial)}{_limits(trial)}")


def attribution_page(attribution: Attribution) -> str:
    """Return what came of all of them: a table, and a sentence where a cell does not do."""
    rows = [_COLUMNS, *(_cells(trial) for trial in attribution.trials)]
    notes = [trial_line(trial) for trial in attribution.trials if _needs_words(trial)]
    return "\n".join([*aligned(rows, right={2, 3, 4}), *([""] if notes else []), *notes])


def written(attribution: Attribution, suffix: str) -> str:
    """Return the content of a file: JSON with every try, or Markdown."""
    if suffix == ".json":
        words = [{"says": _sentence(trial), **_verdict(trial)} for trial in attribution.trials]
        whole = asdict(attribution)
        whole["trials"] = [each | more for each, more in zip(whole["trials"], words, strict=True)]
        return json.dumps(whole, indent=2) + "\n"
    from nw_eval.reporting.markdown import escaped, markdown_table
    from nw_eval.reporting.tables.table import Table

    table = Table(
        title="Failure attribution",
        columns=_COLUMNS,
        rows=tuple(_cells(trial) for trial in attribution.trials),
        numbers=frozenset({"at", "committed at", "before its end"}),
    )
    notes = [f"* {escaped(trial_line(trial))}" for trial in attribution.trials]
    head = [
        f"# Failure attribution: {escaped(attribution.run)}",
        "",
        escaped(forecast_line(attribution.plan)),
        "",
    ]
    return "\n".join([*head, markdown_table(table), "", *notes]) + "\n"


def _verdict(trial: AttributedTrial) -> dict[str, object]:
    """Return the computed values for programs."""
    report = trial.report
    moment = None if report is None or report.committed is None else report.committed.step
    return {
        "committed_s": None
        if report is None or moment is None
        else moment / report.was.control_rate,
        "is_monotone": None if report is None else report.is_monotone,
    }


def _cells(trial: AttributedTrial) -> tuple[str, ...]:
    report = trial.report
    if report is None:
        return (clean(trial.trial), "", "", "", "", "no result")
    committed = report.committed
    return (
        clean(trial.trial),
        clean(f"{report.was.end} ({report.was.reason})", at_most=60),
        f"{_seconds(report.was.steps, report)} s",
        "never" if committed is None else f"{_seconds(committed.step, report)} s",
        "" if committed is None else f"{_seconds(report.was.steps - committed.step, report)} s",
        _standing(report),
    )


def _standing(report: AttributionReport) -> str:
    """Return in few words what the baseline makes of the trial."""
    if report.committed is None:
        return "fails from the start, too"
    if report.completes_throughout:
        return "completes from the last moment"
    return "completes until then" if report.is_monotone else "completes from some moments"


def _needs_words(trial: AttributedTrial) -> bool:
    report = trial.report
    return (
        report is None or report.committed is None or not report.is_monotone or bool(_limits(trial))
    )


def _limits(trial: AttributedTrial) -> str:
    """Return when limits were first passed in the trial, and in the baseline's from the start."""
    report = trial.report
    if report is None:
        return ""
    own, others = report.limits, report.tries[0].limits
    told = [
        f"{name} {_at(own.get(name))} (by {report.baseline} {_at(others.get(name))})"
        for name in dict.fromkeys((*own, *others))
    ]
    return f"; limits first passed, by both from the start: {', '.join(told)}" if told else ""


def _at(moment: float | None) -> str:
    return "never" if moment is None else f"at {moment:.3f} s"


def _sentence(trial: AttributedTrial) -> str:
    report = trial.report
    if report is None:
        return trial.fault
    committed, tried = report.committed, plural(len(report.tries), "moment")
    if committed is None:
        return (
            f"not only the candidate's fault: {report.baseline} fails from the start, too "
            f"({report.tries[0].end} at {_seconds(report.tries[0].steps, report)} s), and "
            f"completes from none of {tried}"
        )
    if report.completes_throughout:
        last = _seconds(committed.step, report)
        return f"{report.baseline} completes from all of {tried}, {last} s too"
    gap = _seconds(report.was.steps - committed.step, report)
    words = f"committed at {_seconds(committed.step, report)} s, {gap} s before {_event(report)}"
    if report.is_monotone:
        return words
    own = "" if report.tries[0].completes else f"; {report.baseline} fails from the start, too"
    return f"{words}; not monotone: {_spells(report)}{own}"


def _spells(report: AttributionReport) -> str:
    """Return from when on it completes, fails, completes again, as far as was tried."""
    first, *later = report.tries
    words = [f"{'completes' if first.completes else 'fails'} from 0.00 s"]
    has_completed = first.completes
    for before, after in pairwise([first, *later]):
        if before.completes != after.completes:
            suffix = " again" if after.completes and has_completed else ""
            verb = "completes" if after.completes else "fails"
            words.append(f"{verb}{suffix} from {_seconds(after.step, report)} s")
        has_completed = has_completed or after.completes
    return ", ".join(words)


def _event(report: AttributionReport) -> str:
    """Return what ended the trial, as something that one comes before."""
    was = report.was
    if was.end == "collided" and was.reason:
        return clean(was.reason, at_most=60)  # Such as `contact trunk`.
    return _EVENTS.get(was.end, clean(was.end, at_most=60))


def _seconds(steps: int, report: AttributionReport) -> str:
    return f"{steps / report.was.control_rate:.2f}"
