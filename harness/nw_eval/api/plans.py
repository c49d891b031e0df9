"""What a run would be: suite, policy and scenes resolved and checked before anything runs."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.message import Message
from nw_eval.errors import UsageError, nearest
from nw_eval.inside import what_is

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.engine.plan import Plan
    from nw_eval.rollout.job import Record
    from nw_eval.scenes.terrain.options import Collision
    from nw_eval.suite import Suite


def plan(
    suite: str | Path,
    *,
    robot: str | None = None,
    policy: str | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    scenes: Sequence[str] = (),
    record: Record | None = None,
    allow_code: bool = False,
    collision: Collision = "terrain",
) -> Plan:
    """Resolve a suite and a policy to the trials that they mean, and check all of it.

    Args:
        suite: a suite file or the name of a shipped one.
        robot: in place of the suite's own; its trials are others then.
        policy: a bundle's name, folder or card; the suite's own if None.
        checkpoint: weights to use with the card.
        trials: per scene; the suite's own number if None.
        scenes: globs; only scenes that match one of them.
        record: whose camera images the logs keep; the suite's own choice if None.
        allow_code: whether Python code that the card names may be imported.
        collision: how scan meshes collide: as compiled terrain, or by their own triangles.

    Raises:
        UsageError, SuiteError, SceneError, PolicyError: something cannot be used as given.
    """
    from nw_eval import scenes as places
    from nw_eval.engine.plan import Plan
    from nw_eval.policies import load_bundle
    from nw_eval.rollout.vetting import vet_bundle
    from nw_eval.suite import check_scenes, check_tiers, expand, load_suite, override

    told = override(load_suite(suite), robot=robot, policy=policy, trials=trials, record=record)
    check_scenes(told, places.names())
    found = places.match_scenes(told.scenes, told.base, collision=collision)
    check_tiers(told, [scene.name for scene in found])
    chosen = tuple(s for s in found if not scenes or any(fnmatchcase(s.name, p) for p in scenes))
    if not chosen:
        asked = ", ".join(scenes)
        raise UsageError(
            f"--scenes {asked} matches no scene of suite {told.name!r}",
            fix=nearest(asked.replace("*", ""), [scene.name for scene in found]),
        )
    bundle = load_bundle(_policy_reference(told, policy), checkpoint=checkpoint)
    bundle = vet_bundle(bundle, told.robot, protocol=told.protocol, allow_code=allow_code)
    return Plan(
        suite=told,
        bundle=bundle,
        scenes=chosen,
        references=places.references(told.scenes, told.base, collision=collision),
        trials=expand(told, chosen),
        checkpoint=checkpoint,
        allow_code=allow_code,
    )


def check(
    suite: str | Path,
    *,
    robot: str | None = None,
    policy: str | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    scenes: Sequence[str] = (),
    workers: int | None = None,
    allow_code: bool = False,
    collision: Collision = "terrain",
) -> Message:
    """Say what a run would be, without running it: scenes, trials, digests, expected minutes."""
    from nw_eval.engine.forecast import forecast

    made = plan(
        suite,
        robot=robot,
        policy=policy,
        checkpoint=checkpoint,
        trials=trials,
        scenes=scenes,
        allow_code=allow_code,
        collision=collision,
    )
    return Message(text=forecast(made.suite, made.bundle, made.scenes, made.trials, workers))


def _policy_reference(suite: Suite, given: str | None) -> str:
    """Return what names the policy: a suite's own relative path starts from the suite's folder."""
    own = suite.base / suite.policy
    if (
        given is None
        and ("/" in suite.policy or own.suffix == ".yaml")
        and what_is(own) != "nothing"
    ):
        return str(own)
    return suite.policy
