"""`nw-eval plan`: how many trials a gate takes and what it sees; or into which parts they go."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from nw_base.plural import plural
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.printed import json_text
from nw_eval.cli.verbs.shared import Scenes, Suite

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.api import BarPlan, ShardPlan, TrialPlan
    from nw_gate.baseline.informative import Item, Proposal
    from nw_gate.baseline.power_forecast import Outset
    from nw_gate.baseline.scores import ScoreForecast
    from nw_gate.stats.baseline.curve import CurvePoint


@dataclass(frozen=True, kw_only=True)
class PlanTrials:
    """Compute how many trials detect a drop against a baseline, and what else the gate detects.

    Simulates the gate with the scores of a baseline or of a run of the suite. For a suite with a
    bar and no baseline, it computes how many trials the bar needs. It lists the scenes that tell
    two policies apart, and with --limits or --write-suite proposes a suite that does so in fewer
    trials. Runs no physics. With --shards it lists the shards of a run instead; each shard runs on
    a machine of its own (`run --shard`).
    """

    suite: Suite
    detect: float | None = None
    """Drop of mean success to detect (default: the suite's `gate.max_drop`)."""
    baseline: str | None = None
    """The baseline to compare with, by name or path (default: the suite's `gate.baseline`, else its
    only baseline)."""
    run: Path | None = None
    """Use the scores of this run of the suite in place of a baseline's."""
    out: Path | None = None
    """Draw the curve into this PNG."""
    limits: tuple[Path, ...] = ()
    """Folders of `nw-eval limits`: a suite is proposed, with rungs that they have measured."""
    write_suite: Path | None = None
    """Write the proposed suite into this file; its name becomes the suite's."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes assumed for the estimate in minutes (default: one per core)."""

    shards: int | None = None
    """Split a run into this many shards."""
    json: bool = False
    """Print JSON; with --shards a GitHub matrix, in one line."""
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """A policy's name, folder or card; like --trials and --scenes, only with --shards (default: the
    suite's policy)."""
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    """Trials per scene (default: the suite's number)."""
    scenes: Scenes = None

    def __call__(self) -> int:
        self._check()
        return self._power_forecast() if self.shards is None else self._cut(self.shards)

    def _check(self) -> None:
        """Refuse options that say nothing about what is asked.

        Raises:
            UsageError: naming one.
        """
        from nw_base.errors import UsageError

        of_parts = ("policy", "trials", "scenes")
        of_curve = ("detect", "run", "out", "limits", "write_suite")
        for name in of_parts if self.shards is None else of_curve:
            if getattr(self, name) not in {None, ()}:
                without = "without" if self.shards is None else "with"
                option = f"--{name.replace('_', '-')}"
                raise UsageError(f"{option} {without} --shards", fix=f"drop {option}")

    def _cut(self, shards: int) -> int:
        from nw_eval import api

        planned = api.plan_shards(
            self.suite,
            shards,
            workers=self.workers,
            policy=self.policy,
            baseline=self.baseline,
            trials=self.trials,
            scenes=self.scenes,
        )
        print(shard_matrix(planned) if self.json else shard_page(planned))
        return 0

    def _power_forecast(self) -> int:
        from nw_eval import api

        planned = api.plan_trials(
            self.suite,
            detect=self.detect,
            baseline=self.baseline,
            run=self.run,
            out=self.out,
            workers=self.workers,
            limits=self.limits,
            write_suite=self.write_suite,
        )
        if isinstance(planned, api.BarPlan):
            print(bar_plan_json(planned) if self.json else bar_plan_page(planned))
            return 0
        print(trial_plan_json(planned) if self.json else trial_plan_page(planned))
        if self.out is not None and not self.json:
            print(f"drawn in {self.out}")
        if self.write_suite is not None and not self.json:
            print(f"written to {self.write_suite}; its first lines say what comes next")
        return 0


_CHANCES = (0.8, 0.9)


def bar_plan_page(planned: BarPlan) -> str:
    """Return what a bar takes as lines of text: how many trials, and who passes."""
    least = plural(planned.needed, "trial")
    rows = [("success", *(plural(size, "trial") for size in planned.sizes))]
    rows += [
        (f"{truth:.3f}", *(f"{100 * share:.0f} %" for share in shares))
        for truth, shares in planned.curve
    ]
    sure = f"({100 * planned.confidence:.4g} % confidence)"
    size = f"{plural(planned.trials, 'trial')} in each of {plural(planned.scenes, 'scene')}"
    lines = [
        f"suite     {planned.suite}: {size}",
        f"bar       success at least {planned.bar:g} {sure}; no baseline",
        f"needed    {least} in each scene, if none of them fails (--trials {planned.needed})",
        *(f"no PASS   {reason}" for reason in planned.obstacles),
        "",
        "PASS by true success and trials in each scene:",
        *aligned(rows, right=range(len(rows[0]))),
        "",
        "Simulated, 2,000 runs each: the standard error of a share is at most 1.1 %.",
    ]
    return "\n".join(lines)


def bar_plan_json(planned: BarPlan) -> str:
    """Return what a bar takes as JSON: of each true success, how often it passes at each size."""
    curve = [{"success": truth, "passed": shares} for truth, shares in planned.curve]
    return json_text({**vars(planned), "curve": curve})


def trial_plan_json(planned: TrialPlan) -> str:
    """Return a plan of trials as JSON; a number of trials that is never enough is null."""
    from nw_gate.stats.baseline.curve import trials_for

    outset = planned.outset
    margins = outset.rules.margins
    fields = {
        "suite": planned.suite,
        "source": planned.source,
        "success": outset.baseline,
        "initial_states": outset.starts,
        "scenes": outset.scenes,
        "most_trials": outset.budget,
        "max_drop": margins.max_drop,
        "tolerate": margins.tolerate,
        "detect": planned.detect,
        "flagged_within": {x: trials_for(planned.dropped.regressed, x) for x in _CHANCES},
        "equal_passes_within": {x: trials_for(planned.equal.passed, x) for x in _CHANCES},
        "curve": [
            {
                "drop": point.drop,
                "regressed": point.regressed,
                "passed": point.passed,
                "undecided": point.undecided,
                "trials": point.trials,
                "minutes": planned.minutes(point.trials),
            }
            for point in planned.curve
        ],
        "scores": planned.scores,
        "items": [_item_json(each) for each in planned.items],
        "proposal": None if planned.proposal is None else _proposal_json(planned.proposal),
    }
    return json_text(fields)


def _item_json(each: Item) -> dict[str, Any]:
    """Return what a trial of a scene says; trials that are never enough are null."""
    return {
        "scene": each.name,
        "in_suite": not each.rung,
        "success": each.success,
        "worse": each.worse,
        "information": each.information,
        "alone": each.alone,
        "tells": each.tells,
    }


def _proposal_json(found: Proposal) -> dict[str, Any]:
    return {
        "scenes": [each.name for each in found.items],
        "left_out": [each.name for each in found.left_out],
        "rounds": found.rounds,
        "starts": found.starts,
        "today": found.today,
        "proposed": found.proposed,
    }


def trial_plan_page(planned: TrialPlan) -> str:
    """Return a plan of trials as lines of text: how many, how long, and the curve."""
    outset = planned.outset
    rules, margins = outset.rules, outset.rules.margins
    drops = f"max_drop {margins.max_drop:g}, tolerate {margins.tolerate:g}"
    wrong_pass, wrong_regressed = (f"{100 * x:.4g} %" for x in (rules.alpha_pass, rules.alpha_regr))
    lines = [
        f"suite     {planned.suite}: {outset.in_words}",
        f"from      {planned.source}: success {outset.baseline:.3f}, {_baseline(outset)}",
        f"margins   {drops}; wrong PASS {wrong_pass}, wrong REGRESSED {wrong_regressed} at most",
        f"detect    {_detection(planned)}",
        f"equal     {_within(planned, planned.equal.passed, 'an equally good policy passes')}",
        "",
        *_curve(planned),
        "",
        "Simulated, 1,000 gates at each drop: the standard error of a share is at most 1.6 %.",
        "Between tolerate and max_drop, both verdicts are correct.",
        *(line for each in planned.scores for line in _score_lines(each)),
        "",
        *_item_lines(planned),
        *([] if planned.proposal is None else ["", *_proposal_lines(planned, planned.proposal)]),
    ]
    return "\n".join(lines)


_MOST_ITEMS = 20
"""Scenes in a table: the rest of them are in the JSON."""


def _item_lines(planned: TrialPlan) -> list[str]:
    """Return which scenes tell a policy of the drop from the baseline."""
    worse = f"{planned.detect:g} worse"
    telling = [each for each in planned.items if each.tells]
    rows = [("scene", "baseline", worse, "trials alone")]
    rows += [
        (each.name, f"{each.success:.3f}", f"{each.worse:.3f}", f"{each.alone:.0f}")
        for each in telling[:_MOST_ITEMS]
    ]
    lines = [
        f"Success of the baseline and of a policy {worse} that loses most where the baseline fails",
        "sometimes, and the fewest trials in which any test could tell them apart by this scene",
        f"alone ({_wrong(planned)}):",
        *aligned(rows, right=(1, 2, 3)),
    ]
    if more := len(telling) - _MOST_ITEMS:
        lines += [f"and {plural(more, 'scene')} more, in --json"] if more > 0 else []
    never = [each for each in planned.items if not each.tells]
    if never:
        lines.append(
            f"tell nothing in {planned.outset.budget} trials of such a policy: {_names(never)}"
        )
    if planned.ladders:
        policy = planned.policy or "POLICY"
        ladders = " ".join(planned.ladders)
        lines.append("Rungs of ladders may tell more. To measure them, and to propose a suite:")
        lines.append(f"  nw-eval limits {ladders} -p {policy} --out reports/limits")
        lines.append(f"  nw-eval plan {planned.suite} --limits reports/limits --write-suite FILE")
    return lines


def _proposal_lines(planned: TrialPlan, found: Proposal) -> list[str]:
    """Return what a proposed suite has, and what its gate does beside today's."""
    today, then = found.today, found.proposed
    rows = [("policy", "today", "", "proposed", "")]
    rows += [
        (who, *_end(word, getattr(today, kind)), *_end(word, getattr(then, kind)))
        for who, word, kind in (
            ("equally good", "passed", "equal"),
            (f"{planned.detect:g} worse", "regressed", "worse"),
            ("as much worse, evenly in all scenes", "regressed", "evenly"),
        )
    ]
    added = [each for each in found.items if each.rung]
    gates = planned.outset.few
    size = plural(len(found.items), "scene")
    return [
        f"Proposed: {size}, at most {found.rounds} trials of each, a baseline of {found.starts}",
        f"leaves out {_names(found.left_out)}",
        *([f"adds {_names(added)}"] if added else []),
        "",
        *aligned(rows),
        f"Simulated, {gates} gates of each: the standard error is at most {50 / gates**0.5:.1f} %.",
        "The second policy loses most where the baseline fails sometimes; the third loses the same",
        "share of success everywhere, which hard scenes show later. Scenes that are left out no",
        "longer show what fails only there: keep today's suite for releases.",
    ]


def _end(word: str, point: CurvePoint) -> tuple[str, str]:
    """Return how often a gate ends with a verdict, and its mean number of trials."""
    says = {"passed": "PASS", "regressed": "REGRESSED"}[word]
    return f"{says} {100 * getattr(point, word):.0f} %", f"{point.trials:.0f} trials"


def _names(items: Sequence[Item]) -> str:
    return ", ".join(each.name for each in items)


def _wrong(planned: TrialPlan) -> str:
    return f"wrong REGRESSED {100 * planned.outset.rules.alpha_regr:.4g} %"


def _score_lines(forecast: ScoreForecast) -> list[str]:
    """Return what the gate makes of a score, a line for each change."""
    spec = forecast.spec
    unit = f" {spec.unit}" if spec.unit else ""
    rows = [("worse by", "PASS", "REGRESSED", "undecided")]
    rows += [
        (
            f"{change:.4g}{unit}",
            *(f"{100 * share:.0f} %" for share in (passed, regressed, 1.0 - passed - regressed)),
        )
        for change, passed, regressed in forecast.points
    ]
    margins = f"max_drop {forecast.max_drop:g}, tolerate {forecast.tolerate:g}"
    error = f"{100 * 0.5 / forecast.gates**0.5:.1f} %"
    return [
        "",
        f"{spec.name}: {forecast.level:.4g}{unit}; {margins}; {plural(forecast.trials, 'trial')}",
        *aligned(rows, right=range(len(rows[0]))),
        f"Simulated, {forecast.gates} gates at each change: the standard error is at most {error}.",
    ]


def _baseline(outset: Outset) -> str:
    starts = f"{outset.starts} initial states per scene"
    return starts if outset.known else f"simulated for a baseline of {starts}"


def _detection(planned: TrialPlan) -> str:
    sentence = _within(
        planned, planned.dropped.regressed, f"a policy {planned.detect:g} worse is REGRESSED"
    )
    margins = planned.outset.rules.margins
    rare = planned.dropped.regressed[-1] < _CHANCES[-1]
    if rare and margins.tolerate < planned.detect < margins.max_drop:
        return f"{sentence}: the drop is below max_drop, and may pass"
    return sentence


def _within(planned: TrialPlan, shares: Sequence[float], what: str) -> str:
    """Return after how many trials something is so in 80 and in 90 %."""
    from nw_gate.stats.baseline.curve import trials_for

    counts = [(chance, trials_for(shares, chance)) for chance in _CHANCES]
    parts = [
        f"in {100 * chance:.0f} % within {_trials(planned, trials)}"
        for chance, trials in counts
        if trials is not None
    ]
    if len(parts) < len(counts):
        most = f"{100 * shares[-1]:.0f} %"
        parts.append(f"at most in {most}, even with all initial states")
    return f"{what} {', '.join(parts)}"


def _trials(planned: TrialPlan, trials: int) -> str:
    return f"{plural(trials, 'trial')} (about {planned.minutes(trials):.1f} minutes)"


def _curve(planned: TrialPlan) -> list[str]:
    rows = [("drop", "REGRESSED", "PASS", "undecided", "trials", "about min")]
    for point in planned.curve:
        shares = (f"{100 * x:.0f} %" for x in (point.regressed, point.passed, point.undecided))
        regressed, passed, undecided = shares
        minutes = f"{planned.minutes(point.trials):.1f}"
        rows.append(
            (f"{point.drop:.2f}", regressed, passed, undecided, f"{point.trials:.0f}", minutes)
        )
    return aligned(rows, right=range(6))


def shard_page(planned: ShardPlan) -> str:
    """Return the parts as lines of text: what to type for each, and about what it takes."""
    count = len(planned.parts)
    rows = [("shard", "trials", "about min")]
    rows += [
        (f"--shard {index}/{count}", str(part.trials), f"{part.minutes:.1f}")
        for index, part in enumerate(planned.parts, start=1)
    ]
    most = "at most " if planned.parts[0].baseline is not None else ""
    return "\n".join(
        [
            f"suite     {planned.suite}: {most}{plural(planned.trials, 'trial')} in {count} shards",
            "",
            *aligned(rows, right=(1, 2)),
            "",
            "`nw-eval merge RUN... --out FOLDER` merges and judges them.",
        ]
    )


def shard_matrix(planned: ShardPlan) -> str:
    """Return the parts as the JSON of a GitHub matrix, in one line: a job for each part."""
    count = len(planned.parts)
    jobs = [
        {
            "suite": planned.suite,
            "shard": f"{index}/{count}",
            "index": index,
            "count": count,
            "trials": part.trials,
        }
        for index, part in enumerate(planned.parts, start=1)
    ]
    return json.dumps({"include": jobs})
