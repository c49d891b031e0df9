"""Where a policy is tried, through the same parts as every trial."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from nw_eval.cards import Card
from nw_eval.catalogue import parse_reference
from nw_eval.onboarding.probe.recording import Collector, Recording
from nw_eval.policies import Bundle
from nw_eval.rollout.clock import StageClock
from nw_eval.rollout.job import TrialJob
from nw_eval.rollout.library import Library
from nw_eval.rollout.prepare import open_trial
from nw_eval.scenes import Scene
from nw_eval.suite.trials import Trial

_IDENTITY = "0" * 64  # The suite digest of a trial that is part of no suite.


class ThisBundle(Library):
    """A library whose every bundle is the one that is looked at."""

    def __init__(self, bundle: Bundle) -> None:
        super().__init__(scenes=1)
        self._bundle = bundle

    def bundle(self, reference: str, checkpoint: Path | None) -> Bundle:  # noqa: ARG002 - see above.
        """Return it."""
        return self._bundle

    def with_card(self, card: Card) -> None:
        """Go on with the same checkpoint under another card."""
        self._bundle = replace(self._bundle, card=card)


class Rig(Protocol):
    """Records a checkpoint under one card after another."""

    def record(self, card: Card, *, seconds: float, level: float = math.inf) -> Recording:
        """Run the checkpoint under a card, while it leans less than `level`."""
        ...


class SceneRig:
    """A checkpoint in a scene, under one card after another.

    Args:
        bundle: checkpoint, and the card that is looked at.
        scene: its name.
        allow_code: whether Python code that the card names may be imported.
    """

    def __init__(self, bundle: Bundle, *, scene: str, allow_code: bool) -> None:
        self.bundle = bundle
        self._scene = scene
        self._allow_code = allow_code
        self._library = ThisBundle(bundle)

    def record(self, card: Card, *, seconds: float, level: float = math.inf) -> Recording:
        """Run the checkpoint under a card, while it leans less than `level`.

        Raises:
            NwEvalError: it cannot be run.
        """
        self._library.with_card(card)
        return record(
            replace(self.bundle, card=card),
            scene=self._scene,
            seconds=seconds,
            level=level,
            allow_code=self._allow_code,
            library=self._library,
        )


def record(
    bundle: Bundle,
    *,
    scene: str,
    seconds: float = 1.0,
    level: float = math.inf,
    allow_code: bool = False,
    library: ThisBundle | None = None,
) -> Recording:
    """Run a policy for a while, from the first start of a scene.

    Args:
        bundle: card and checkpoint.
        scene: its name.
        seconds: how long at most.
        level: roll or pitch with which the recording ends, rad.
        allow_code: whether Python code that the card names may be imported.
        library: keeps the scene from one recording to the next.

    Raises:
        NwEvalError: it cannot be run.
    """
    library = library or ThisBundle(bundle)
    job = _job(
        bundle,
        library.scene(*parse_reference(scene)),
        scene,
        seconds=seconds,
        allow_code=allow_code,
    )
    with open_trial(job, library, StageClock()) as trial:
        collector = Collector(trial.episode)
        for _ in trial.episode.steps(collector):
            if collector.tilt >= level:
                break
        return collector.recording()


def _job(bundle: Bundle, place: Scene, scene: str, *, seconds: float, allow_code: bool) -> TrialJob:
    trial = Trial(
        suite="check",
        suite_digest=_IDENTITY,
        suite_seed=0,
        scene=scene,
        scene_digest=place.digest,
        task=place.task,
        index=0,
    )
    reference, collision = parse_reference(scene)
    return TrialJob(
        trial=trial,
        robot=bundle.card.robot,
        duration=seconds,
        scene=reference,
        collision=collision,
        policy=bundle.reference,
        checkpoint=bundle.checkpoint,
        checkpoint_digest=bundle.checkpoint_digest,
        allow_code=allow_code,
    )
