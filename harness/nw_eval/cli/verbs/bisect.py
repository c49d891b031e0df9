"""`nw-eval bisect`: which checkpoint of a series is flagged first."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.printed import Printed, json_text
from nw_eval.cli.verbs.verb import Verb, verb_of
from nw_eval.reporting.tables.table import bounds_header

if TYPE_CHECKING:
    from nw_eval.api.reports import RunReport
    from nw_eval.api.series import BisectedSeries
    from nw_gate.bisection import Bisection


@verb_of(
    "bisect",
    changes=("suite", "scenes", "trials", "allow_code", "workers", "no_cache"),
    listens=True,
    heard=lambda name, word: f"{name}: {word}",
)
class BisectSeries(Printed, Verb):
    """Find the first checkpoint of a series that is flagged as worse than a good one.

    CHECKPOINT is weights for the card of --policy, or policy folders, oldest first; or the folder
    of a training, which stands for its checkpoints in order of steps. Each tested checkpoint is
    compared with the baseline of the good one, by success and by each of `gate.scores` with a
    `max_drop`. The suite's bars are ignored. A checkpoint before the first flagged one may be
    slightly worse; the result shows by how much at most. Exit code 1 if a checkpoint was flagged, 0
    if the bad one was not, 3 if nothing was decided.
    """

    goes_on = "interrupted; run the same command again to resume"

    trials: int | None
    """Largest number of trials per checkpoint, as an average per scene (default: the suite's
    `gate.rounds`)."""

    def show(self, found: BisectedSeries) -> str:
        return series_page(found)

    def shown_json(self, found: BisectedSeries) -> str:
        return series_json(found)


def series_json(series: BisectedSeries) -> str:
    """Return the checkpoints in order of age, and which was flagged first, as JSON."""
    names, found = series.checkpoints, series.found
    fallen, good = (None, None) if found is None else (found.first_fallen, found.last_good)
    whole = {
        "baseline": series.baseline,
        "first_flagged": None if fallen is None else names[fallen],
        "last_passed": None if good is None else names[good],
        "suspects": [] if found is None else [names[place] for place in found.suspects],
        "passed_later": [] if found is None else [names[place] for place in found.recovered],
        "checkpoints": [
            {"checkpoint": name, **_facts(series.runs.get(place))}
            for place, name in enumerate(names)
        ],
        "trials": series.trials,
        "folder": series.folder,
        "interrupted": found is None,
        "exit_code": series.exit_code,
    }
    return json_text(whole)


def _facts(run: RunReport | None) -> dict[str, Any]:
    """Return what became of a checkpoint; its verdict is null where it was not judged."""
    against = None if run is None else run.verdict.against
    if run is None or against is None:
        return {"verdict": None}
    return {
        "verdict": run.verdict.verdict,
        "success": run.verdict.success,
        "drop": against.drop,
        "bounds": None if against.interval is None else list(against.interval),
        "trials": len(run.rows),
        "regressed_in": _regressed(run),
        "run": run.typed_folder,
    }


def _regressed(run: RunReport) -> list[str]:
    """Return the scenes, scores and ladders in which a checkpoint is worse."""
    against = run.verdict.against
    named = [] if against is None else [scene.scene for scene in against.scenes if scene.named]
    named += [item.spec.name for item in run.verdict.scores if item.word == "REGRESSED"]
    return named + [item.ladder for item in run.verdict.limits if item.word == "REGRESSED"]


def series_page(series: BisectedSeries) -> str:
    """Return the checkpoints that were judged, and which of the series was flagged first."""
    known = (run.verdict.against for run in series.runs.values())
    found = next((each for each in known if each is not None), None)
    sure = "" if found is None else f" ({bounds_header(found.alpha_regr, found.alpha_pass)})"
    head = ["", "checkpoint", "against the good one", f"drop{sure}", "trials", "regressed in"]
    lines = [
        [str(place + 1), name, *_cells(series.runs.get(place))]
        for place, name in enumerate(series.checkpoints)
    ]
    judged = plural(len(series.runs), "checkpoint")
    cost = f"{judged} of {len(series.checkpoints)} judged, in {plural(series.trials, 'trial')}"
    words = [] if series.found is None else _sentences(series.found, series)
    table = aligned([head, *lines], right={0, 4})
    return "\n".join([*table, "", *words, f"{cost}; each run in {series.folder}"])


def _cells(run: RunReport | None) -> tuple[str, str, str, str]:
    against = None if run is None else run.verdict.against
    if run is None or against is None:
        return "", "", "", ""
    drop = "" if against.drop is None else f"{against.drop:.3f}"
    if against.interval is not None and against.trials:
        drop += f" ({against.interval.low:.2f} to {against.interval.high:.2f})"
    return run.verdict.verdict, drop, str(len(run.rows)), ", ".join(_regressed(run))


def _sentences(found: Bisection, series: BisectedSeries) -> list[str]:
    """Return what was found, how sure that is, and what was not looked at."""
    names, fallen, good = series.checkpoints, found.first_fallen, found.last_good
    if fallen is None:
        opened = [names[place] for place, word in found.words.items() if word == "INCONCLUSIVE"]
        if opened:
            return [f"no checkpoint was flagged; undecided: {', '.join(opened)}"]
        return [f"none was flagged: {names[-1]} passed{_up_to(series.runs.get(len(names) - 1))}"]
    words = [f"the first flagged: {names[fallen]}{_worse(series.runs.get(fallen))}"]
    if good is not None:
        words.append(
            f"the last before it that passed: {names[good]}{_up_to(series.runs.get(good))}"
        )
    elif fallen == 0:
        words.append("it is the first of the series")
    if len(found.suspects) > 1:
        among = ", ".join(names[place] for place in found.suspects[:-1])
        words.append(f"not passed and not flagged before it: {among}")
    if found.recovered:
        later = ", ".join(names[place] for place in found.recovered)
        words.append(
            f"the series is not monotone: {later} passed after {names[fallen]} was flagged"
        )
    elif len(found.words) < found.length:
        words.append("monotone as far as judged; --everyone judges the others too")
    return words


def _worse(run: RunReport | None) -> str:
    """Return by what a checkpoint was flagged, and how much worse it is; nothing if unknown."""
    from nw_gate.verdict import percent_sure

    against = None if run is None else run.verdict.against
    if run is None or against is None:
        return ""
    scores = "".join(
        f"; {reason}"
        for item in run.verdict.scores
        if item.word == "REGRESSED"
        for reason in item.reasons
    )
    if against.interval is None or against.word != "REGRESSED":
        return scores
    low, high = against.interval
    return (
        f", worse than the good one by {low:.2f} ({percent_sure(against.alpha_regr)} confidence) "
        f"to {high:.2f} ({percent_sure(against.alpha_pass)}){scores}"
    )


def _up_to(run: RunReport | None) -> str:
    """Return how much worse a checkpoint that passed may be; nothing where that is unknown."""
    from nw_gate.verdict import percent_sure

    against = None if run is None else run.verdict.against
    if against is None or against.interval is None or against.basis == "same":
        return ""
    high = max(0.0, against.interval.high)
    sure = percent_sure(against.alpha_pass)
    return f"; at most {high:.2f} worse than the good one ({sure} confidence)"
