"""`nw-eval scores`: the scores of a log, of a run or of a robot."""

from __future__ import annotations

import json
from math import isclose, nan
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_sim.rollout.replaying.rescored import LogScores


@verb_of("log_scores", named={"scores": "score", "topics": "topic"})
class Scores(Verb):
    """Compute scores from a log: of a run's trial, or of a robot (MCAP, ROS 2 bag).

    A run's trial is replayed and measured by the same code as in the run. A robot's log gives the
    scores that its topics allow; for the others, the missing topic is shown.
    """

    json: bool = False
    """Print JSON."""

    def show(self, result: LogScores) -> str:
        return scores_text(result)

    def shown_json(self, result: LogScores) -> str:
        return scores_json(result)


def scores_json(scores: LogScores) -> str:
    """Return the scores as a JSON object."""
    whole = {
        "log": str(scores.log),
        "seconds": scores.seconds,
        "scores": {
            name: {"value": value, "unit": scores.specs[name].unit}
            for name, value in scores.values.items()
        },
        "limit_passed_at": dict(scores.moments),
        "missing": dict(scores.missing),
        "topics": dict(scores.topics),
        "unused_topics": dict(scores.unused),
        "fields": {topic: dict(uses) for topic, uses in scores.fields.items()},
        "notes": list(scores.notes),
        "recorded": dict(scores.recorded),
    }
    return json.dumps(whole, indent=2)


def scores_text(scores: LogScores) -> str:
    """Return a line for each score, and where the numbers are from."""
    rows = [("score", "value", "unit", "")]
    for name, spec in scores.specs.items():
        value = scores.values.get(name)
        shown = "-" if value is None else f"{value:.6g}"
        said = clean(scores.missing.get(name, ""), at_most=200)
        if name in scores.moments:
            said = f"limit first passed at {scores.moments[name]:.3f} s"
        rows.append((name, shown, spec.unit, said))
    lines = aligned(rows, right=(1,))
    notes = [f"{scores.seconds:.2f} s"]
    notes += [f"{source}: {clean(topic, at_most=100)}" for source, topic in scores.topics.items()]
    if scores.recorded:
        apart = [
            name
            for name, value in scores.recorded.items()
            if not isclose(scores.values.get(name, nan), value, rel_tol=1e-9, abs_tol=1e-9)
        ]
        notes.append(
            f"the run recorded other values of {', '.join(apart)}"
            if apart
            else f"{plural(len(scores.recorded), 'score')} equal to what the run recorded, to 1e-9"
        )
    if scores.restored:
        notes.append(
            f"bits are others here than where it was recorded: the trial went on from a recorded "
            f"state {plural(scores.restored, 'time')}"
        )
    if scores.unused:
        notes.append(f"{plural(len(scores.unused), 'topic')} not read (--json lists them)")
    said = [f"note: {clean(each)}" for each in scores.notes]
    return "\n".join([*lines, "", "; ".join(notes), *said])
