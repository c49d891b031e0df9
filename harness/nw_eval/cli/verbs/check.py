"""`nw-eval check`: what would run, without running it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import tyro

from nw_eval.cli.verbs.options import Options
from nw_eval.cli.verbs.printed import json_text

if TYPE_CHECKING:
    from nw_eval.engine.plan import Forecast
    from nw_eval.suite import Gate


@dataclass(frozen=True, kw_only=True)
class Check(Options):
    """Show what a suite would run: scenes, trials, digests, expected minutes. Runs no physics.

    Takes the options of `run`. Lists all errors in the suite, its scenes and its policy at once
    (exit code 2).
    """

    suite: tyro.conf.Positional[str] = field()
    """A suite file or a shipped suite's name (`nw-eval suites` lists them)."""
    json: bool = False
    """Print JSON."""

    def __call__(self) -> int:
        from nw_eval import api

        forecast = api.check(self.request, workers=self.workers)
        print(forecast_json(forecast) if self.json else forecast_page(forecast))
        return 0


def forecast_json(forecast: Forecast) -> str:
    """Return what a run would be as JSON."""
    suite, bundle = forecast.suite, forecast.policy
    fields = {
        "suite": suite.name,
        "file": suite.source.file,
        "suite_digest": suite.content_digest,
        "seed_set": suite.digest,
        "protocol": suite.protocol,
        "robot": suite.robot,
        "seed": suite.seed,
        "duration": suite.episode.duration,
        "gate": suite.gate,
        "policy": bundle.name,
        "adapter": bundle.card.adapter,
        "origin": bundle.origin,
        "observations": {
            name: {"sensor": spec.sensor, "rate": spec.rate}
            for name, spec in bundle.card.observations.items()
        },
        "baseline": forecast.baseline,
        "trials": forecast.trials,
        "scenes": forecast.scenes,
        "left_out": forecast.left_out,
        "limits": forecast.suite.gate.limits,
        "shard": None if forecast.shard is None else str(forecast.shard),
        "power": forecast.power,
        "obstacles": forecast.obstacles,
        "warnings": forecast.warnings,
        "workers": forecast.workers,
        "minutes": forecast.minutes,
    }
    return json_text(fields)


def forecast_page(forecast: Forecast) -> str:
    """Return what a run would be as lines of text."""
    from nw_base.plural import plural
    from nw_policies.bundle import SCOPE

    suite, bundle, scenes = forecast.suite, forecast.policy, forecast.scenes
    duration = suite.episode.duration
    which = plural(len(scenes), "scene")
    if forecast.left_out:
        all_of_them = plural(len(scenes) + len(forecast.left_out), "scene")
        which = f"{len(scenes)} of the suite's {all_of_them}"
    count = f"{which}, {scenes[0].trials} in each"
    if forecast.baseline is not None:
        count = f"{which}; a maximum: the run stops when the verdict is decided"
    if forecast.shard is not None:
        count = f"{forecast.shard}, of {which}"
    width = max(len(scene.name) for scene in scenes)
    facts = f"protocol {suite.protocol}, robot {suite.robot}, seed {suite.seed}, {duration:g} s"
    lines = [
        f"suite     {suite.name}  ({suite.source.file}, {suite.content_digest[:16]})",
        f"seed set  {suite.digest[:16]}: {facts}",
        "          suites with the same seed set use the same initial states",
        f"gate      {_bar(suite.gate)}{_drop(suite.gate, forecast.baseline, bundle.name)}",
        f"policy    {bundle.name}  ({bundle.card.adapter}, {bundle.origin})",
        *([f"          {SCOPE}"] if bundle.code_sha256 else []),
        *(
            f"{'sees' if index == 0 else '':<9} {name}: {spec.sensor} at {spec.rate} Hz"
            for index, (name, spec) in enumerate(bundle.card.observations.items())
        ),
        f"trials    {forecast.trials} of {duration:g} s: {count}",
        *(f"          {scene.name:<{width}}  {scene.digest[:16]}" for scene in scenes),
        *_ladders(suite.gate),
        *_power(forecast.power),
        *(f"no PASS   {reason}" for reason in forecast.obstacles),
        *(f"warning   {sentence}" for sentence in forecast.warnings),
        f"expect    about {forecast.minutes:.1f} minutes with --workers {forecast.workers}",
    ]
    return "\n".join(lines)


def _ladders(gate: Gate) -> list[str]:
    """Return what the limits of the policy must be, a line for each ladder."""
    lines: list[str] = []
    for name, asked in gate.limits.items():
        least = [] if asked.at_least is None else [f"at_least {asked.at_least:g}"]
        most = [] if asked.max_drop is None else [f"max_drop {asked.max_drop:g}"]
        wanted = ", ".join([*least, *most])
        lines.append(
            f"{'' if lines else 'limits':<9} {name}: {wanted}; at most {asked.trials} trials"
        )
    return lines


def _power(sentence: str | None) -> list[str]:
    """Return what the gate can tell apart on two lines; how many trials it has is told above."""
    if sentence is None:
        return []
    flags, _, passes = sentence.partition("this gate ")[2].partition(", and ")
    return [f"power     {flags},", f"          {passes}"]


def _bar(gate: Gate) -> str:
    """Return what a run must show to pass, in words."""
    sure = f"({100 * gate.confidence:.4g} % confidence)"
    if gate.success_rate is not None:
        bar = f"success at least {gate.success_rate:g} {sure}"
    elif not gate.scores and not gate.limits:
        bar = "none (gate.success_rate): the verdict will be RAN"
    else:
        bar = "no bar for success (gate.success_rate)"
    for name, asked in gate.scores.items():
        bar += "" if asked.bar is None else f"; {name} by its bar {asked.bar:g} {sure}"
        bar += "" if asked.max_drop is None else f"; {name} by its max_drop {asked.max_drop:g}"
    return bar


def _drop(gate: Gate, baseline: str | None, policy: str) -> str:
    """Return what may be lost against the baseline, in words."""
    if baseline is not None:
        return f"; less than {gate.most_drop:g} below baseline {baseline}"
    if gate.max_drop is not None or gate.baseline not in {None, "none"}:
        return f"; max_drop is ignored: no baseline for {policy}"
    return ""
