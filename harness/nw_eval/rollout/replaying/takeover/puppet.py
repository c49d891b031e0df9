"""A recorded trial without its policy: its robot and motors, moved by what the log says."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from nw_eval.policies import Bundle
from nw_eval.policies.bundle import NOTHING
from nw_eval.rollout.clock import StageClock
from nw_eval.rollout.library import Library
from nw_eval.rollout.prepare import OpenTrial, open_trial

if TYPE_CHECKING:
    from pathlib import Path

    from nw_eval.cards import Card
    from nw_eval.rollout.job import TrialJob
    from nw_eval.scenes import Scene
    from nw_eval.scenes.rays import RayScene
    from nw_eval.words import Collision


def open_puppet(job: TrialJob, card: Card, library: Library) -> OpenTrial:
    """Return a trial at its start whose motors are those of a card, and which sees nothing.

    Its checkpoint need not be there: `Episode.advance` takes what the log says was decided.

    Args:
        job: of the recorded trial; its policy does not matter.
        card: of the policy that made it.
        library: gives the scene.

    Raises:
        SceneError, UsageError, PolicyError: as `open_trial`.
    """
    changed = {"adapter": "zero", "checkpoint": None, "observations": {}, "networks": {}}
    moved = card.model_copy(update={**changed, "inputs": None, "options": {}})
    bundle = Bundle(card=moved, card_path=None, checkpoint=None, checkpoint_sha256=NOTHING)
    job = replace(
        job,
        policy=bundle.reference,
        checkpoint=None,
        checkpoint_digest=bundle.checkpoint_digest,
        mcap=None,
    )
    return open_trial(job, _WithPuppet(library, bundle), StageClock())


class _WithPuppet(Library):
    """The scenes of another library, and one bundle."""

    def __init__(self, library: Library, bundle: Bundle) -> None:
        super().__init__()
        self._library = library
        self._bundle = bundle

    def scene(self, reference: str, collision: Collision = "terrain") -> Scene:
        return self._library.scene(reference, collision)

    def rays(self, reference: str, collision: Collision = "terrain") -> RayScene:
        return self._library.rays(reference, collision)

    def bundle(self, reference: str, checkpoint: Path | None) -> Bundle:  # noqa: ARG002 - it has one.
        return self._bundle
