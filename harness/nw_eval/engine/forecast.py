"""What a run would be and about how long it would take, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.engine.run import default_workers
from nw_eval.policies.code_digest import SCOPE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.policies import Bundle
    from nw_eval.scenes import Scene
    from nw_eval.suite import Suite, Trial

# Wall seconds for one simulated second of a trial that lasts its whole duration, on one core of the
# class that the benchmarks name: physics, scandots, policy and log, and a camera's frames on top.
_BLIND = 0.06
_SEEING = 0.10
# Wall seconds until a worker has its libraries and kernels.
_START = 4.0


def forecast(
    suite: Suite,
    bundle: Bundle,
    scenes: Sequence[Scene],
    trials: Sequence[Trial],
    workers: int | None,
) -> str:
    """Return the plan of a run as lines of text.

    Args:
        suite: with what the command line changed of it.
        bundle: the policy, checked.
        scenes: those that will be run.
        trials: those that will be run.
        workers: processes; one for each core if None.
    """
    count = max(1, min(workers or default_workers(), len(trials)))
    sees = bool(bundle.card.splat_images)
    each = (_SEEING if sees or suite.record == "all" else _BLIND) * suite.episode.duration
    duration = suite.episode.duration
    minutes = (_START + each * len(trials) / count) / 60.0
    width = max(len(scene.name) for scene in scenes)
    per_scene = len(trials) // len(scenes)
    panel = f"protocol {suite.protocol}, robot {suite.robot}, seed {suite.seed}, {duration:g} s"
    lines = [
        f"suite     {suite.name}  ({suite.source.file}, {suite.content_digest[:16]})",
        f"panel     {suite.digest[:16]}: {panel}",
        "          suites of one panel meet the same starts in a scene",
        f"gate      {_gate(suite)}",
        f"policy    {bundle.name}  ({bundle.card.adapter}, {bundle.origin})",
        *([f"          {SCOPE}"] if bundle.code_sha256 else []),
        *(
            f"{'sees' if index == 0 else '':<9} {name}: {spec.sensor} at {spec.rate} Hz"
            for index, (name, spec) in enumerate(bundle.card.observations.items())
        ),
        f"trials    {len(trials)} of {duration:g} s: {len(scenes)} scenes, {per_scene} in each",
        *(f"          {scene.name:<{width}}  {scene.digest[:16]}" for scene in scenes),
        f"expect    at most about {max(minutes, 0.1):.1f} minutes with --workers {count}",
    ]
    return "\n".join(lines)


def _gate(suite: Suite) -> str:
    """Return what a run must show to pass, in words."""
    gate = suite.gate
    if gate.success_rate is None:
        told = "none (gate.success_rate): the verdict will be RAN"
    else:
        told = f"success of at least {gate.success_rate:g}, {100 * gate.confidence:.4g} % sure"
    unread = "; max_drop will not be judged: there is no baseline"
    return told + (unread if gate.max_drop is not None else "")
