"""`nw-eval scores`: the scores of a log, of a run or of a robot."""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import isclose, nan
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from nw_base.clean import clean
from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned

if TYPE_CHECKING:
    from nw_sim.rollout.replaying.rescored import LogScores


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Compute scores from a log: of a trial of a run, or of a robot (MCAP, ROS 2 bag).

    A run's trial is led along its log again, and measured by the same code as in the run. A robot's
    log gives the scores that its topics allow, and says which topic the others need.
    """

    log: tyro.conf.Positional[Path]
    """A trial's MCAP file, or one with joint states and commands of a robot, or a bag's folder."""
    score: tuple[str, ...] = ()
    """Which scores; all if none is named."""
    robot: str | None = None
    """Whose log it is, if it is not that of a run."""
    topic: tuple[str, ...] = ()
    """Of a robot's log: joints=NAME, targets=NAME, pose=NAME or command=NAME, in place of those
    that are found by what their messages are."""
    json: bool = False
    """Print JSON."""
    allow_code: bool = False
    """Let scores that are Python functions of the run's suite run; its log holds them."""

    def __call__(self) -> int:
        from nw_eval import api

        found = api.log_scores(
            self.log,
            scores=self.score,
            robot=self.robot,
            topics=self.topic,
            allow_code=self.allow_code,
        )
        print(scores_json(found) if self.json else scores_text(found))
        return 0


def scores_json(found: LogScores) -> str:
    """Return the scores as a JSON object."""
    whole = {
        "log": str(found.log),
        "seconds": found.seconds,
        "scores": {
            name: {"value": value, "unit": found.specs[name].unit}
            for name, value in found.values.items()
        },
        "limit_passed_at": dict(found.moments),
        "missing": dict(found.missing),
        "topics": dict(found.topics),
        "unused_topics": dict(found.unused),
        "fields": {topic: dict(uses) for topic, uses in found.fields.items()},
        "notes": list(found.notes),
        "recorded": dict(found.recorded),
    }
    return json.dumps(whole, indent=2)


def scores_text(found: LogScores) -> str:
    """Return a line for each score, and where the numbers are from."""
    rows = [("score", "value", "unit", "")]
    for name, spec in found.specs.items():
        value = found.values.get(name)
        shown = "-" if value is None else f"{value:.6g}"
        said = clean(found.missing.get(name, ""), at_most=200)
        if name in found.moments:
            said = f"limit first passed at {found.moments[name]:.3f} s"
        rows.append((name, shown, spec.unit, said))
    lines = aligned(rows, right=(1,))
    notes = [f"{found.seconds:.2f} s"]
    notes += [f"{source}: {clean(topic, at_most=100)}" for source, topic in found.topics.items()]
    if found.recorded:
        apart = [
            name
            for name, value in found.recorded.items()
            if not isclose(found.values.get(name, nan), value, rel_tol=1e-9, abs_tol=1e-9)
        ]
        notes.append(
            f"the run recorded other values of {', '.join(apart)}"
            if apart
            else f"{plural(len(found.recorded), 'score')} equal to what the run recorded, to 1e-9"
        )
    if found.restored:
        notes.append(
            f"bits are others here than where it was recorded: the trial went on from a recorded "
            f"state {plural(found.restored, 'time')}"
        )
    if found.unused:
        notes.append(f"{plural(len(found.unused), 'topic')} not read (--json lists them)")
    said = [f"note: {clean(each)}" for each in found.notes]
    return "\n".join([*lines, "", "; ".join(notes), *said])
