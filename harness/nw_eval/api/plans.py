"""What a run would be: suite, policy and scenes resolved and checked before anything runs."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.message import Message
from nw_eval.errors import UsageError, nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.engine.plan import Plan
    from nw_eval.policies import Bundle
    from nw_eval.rollout.job import Record
    from nw_eval.scenes.terrain.options import Collision
    from nw_eval.suite import Suite


def plan(
    suite: str | Path | Suite,
    *,
    robot: str | None = None,
    policy: str | None = None,
    card: Path | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    scenes: Sequence[str] = (),
    seed: int | None = None,
    record: Record | None = None,
    allow_code: bool = False,
    collision: Collision = "terrain",
    bundle: Bundle | None = None,
) -> Plan:
    """Resolve a suite and a policy to the trials that they mean, and check all of it.

    Args:
        suite: a suite file, the name of a shipped one, or a suite that was read already.
        robot: in place of the suite's own; its trials are others then.
        policy: a bundle's name, folder or card; the suite's own if None.
        card: where that policy lies, if that is known: a run that is resumed elsewhere still names
            its policy as it was asked for, and finds it where it was.
        checkpoint: weights to use with the card.
        trials: per scene; the suite's own number if None.
        scenes: globs; only scenes that match one of them.
        seed: in place of the suite's own: another panel of starts, so other trials.
        record: whose camera images the logs keep; the suite's own choice if None.
        allow_code: whether Python code that the card names may be imported.
        collision: how scan meshes collide: as compiled terrain, or by their own triangles.
        bundle: a policy that is loaded already, in place of one by name.

    Raises:
        UsageError: an option cannot be used, there is no such suite, or the policy needs images of
            a scene that has no splat.
        SuiteError: what is wrong with the suite, its scenes and its policy, all of it.
        PolicyError: only the policy cannot be used, and its own files are to blame.
    """
    from nw_eval import catalogue
    from nw_eval.api.faults import Faults, open_policy, open_scenes, vet_policy
    from nw_eval.engine.plan import Plan
    from nw_eval.engine.prepare import check_splats
    from nw_eval.suite import Suite, draft_of, draft_suite, expand, override

    draft = draft_of(suite) if isinstance(suite, Suite) else draft_suite(suite)
    told = None
    if draft.suite is not None:
        told = override(
            draft.suite,
            robot=robot,
            policy=policy if bundle is None else bundle.name,
            trials=trials,
            seed=seed,
            record=record,
        )
    faults = Faults(draft)
    found = open_scenes(draft, faults, collision)
    if bundle is not None:
        bundle = vet_policy(draft, faults, bundle, robot=robot, allow_code=allow_code)
    else:
        bundle = open_policy(
            draft,
            faults,
            given=policy if card is None else str(card),
            checkpoint=checkpoint,
            robot=robot,
            allow_code=allow_code,
        )
    faults.raise_any()
    assert told is not None, "a suite that cannot be used has faults"
    assert bundle is not None, "a policy that cannot be used has faults"
    chosen = tuple(s for s in found if not scenes or any(fnmatchcase(s.name, p) for p in scenes))
    if not chosen:
        asked = ", ".join(scenes)
        raise UsageError(
            f"--scenes {asked} matches no scene of suite {told.name!r}",
            fix=nearest(asked.replace("*", ""), [scene.name for scene in found]),
        )
    check_splats(bundle.card, chosen)
    return Plan(
        suite=told,
        bundle=bundle,
        scenes=chosen,
        references=catalogue.references(told.scenes, told.base, collision=collision),
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
    seed: int | None = None,
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
        seed=seed,
        allow_code=allow_code,
        collision=collision,
    )
    return Message(text=forecast(made.suite, made.bundle, made.scenes, made.trials, workers))
