"""What a run says of itself as it starts: run.json, and the first line of its journal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from nw_base.confinement import Fence, offered
from nw_base.plural import plural
from nw_base.words import Backend
from nw_eval.engine.identity import engine_of, fetched_info, policy_info, renderer_name
from nw_gate.results.journal import JournalHeader
from nw_gate.results.provenance import (
    RunInfo,
    SceneInfo,
    code_info,
    library_versions,
    machine_info,
    usable_cores,
)
from nw_places.entries import parted
from nw_places.splits import split_of
from nw_policies.bundle import senses_by_code
from nw_policies.cards import mounted_robot
from nw_policies.cards.card import LEFT_OUT
from nw_scenes.folder import FileSplat
from nw_scenes.neverwhere import reference_path
from nw_scenes.robots import get_robot
from nw_sim.catalogue import is_built_in, is_meant
from nw_sim.rendering import PUBLISHED
from nw_sim.rollout.confined.access import why_off
from nw_sim.tasks import declared_by

if TYPE_CHECKING:
    from nw_eval.engine.how import How
    from nw_eval.engine.plan import Plan
    from nw_gate.results.run_folder import RunFolder
    from nw_policies.cards import Card
    from nw_scenes.scene import Scene
    from nw_sim.catalogue import FoundScene
    from nw_sim.rendering import Rendering


def now() -> str:
    """Return the time as run.json has it: UTC in ISO 8601, to the second."""
    return datetime.now(tz=UTC).isoformat(timespec="seconds")


def run_info(
    plan: Plan,
    folder: RunFolder,
    how: How,
    *,
    workers: int | None = None,
) -> RunInfo:
    """Return a run's provenance as it starts.

    Args:
        plan: what is to be run.
        folder: of the run, absolute.
        how: how it is run.
        workers: processes that it has (default: one for each core).
    """
    suite = plan.suite
    return RunInfo(
        run=2,
        id=folder.id,
        started=now(),
        request=plan.request,
        suite_file=suite.source.file,
        suite_folder=str(suite.base.resolve()),
        suite=suite.model_dump(by_alias=True, mode="json"),
        suite_digest=suite.digest,
        scores={**{x.name: x for x in declared_by(suite.task)}, **suite.measured},
        policy=policy_info(plan.bundle),
        robot_fetched=None if plan.robot_folder is None else fetched_info(plan.robot_folder),
        own_policy=plan.own_policy,
        scenes=_scene_infos(plan),
        left_out=plan.left_out,
        panel=plan.panel,
        drawn_from=plan.drawn_from,
        drawn_for=None if plan.drawn is None else plan.drawn.candidate,
        shard=plan.shard,
        baseline=None if plan.against is None else plan.against.info,
        workers=usable_cores() if workers is None else workers,
        renderer=renderer_name(plan.render) + _pictures(suite.render) + _through_lenses(plan),
        fence=fence_of(
            plan.bundle.card.adapter,
            code=plan.request.allow_code and senses_by_code(plan.bundle.card),
            render=plan.render,
            in_process=how.in_process,
        ),
        command=how.command,
        labels=dict(how.labels or {}),
        code=code_info(),
        machine=machine_info(),
        versions=library_versions(),
        engine=engine_of(plan.render, plan.suite.plugins, plan.bundle.card),
        plugins=plan.plugins,
    )


def journal_header(plan: Plan) -> JournalHeader:
    """Return what the trials of a run have in common, for a resume to compare."""
    return JournalHeader(
        suite_digest=plan.suite.digest,
        policy_digest=plan.bundle.digest,
        scene_digests={scene.name: scene.digest for scene in plan.scenes},
        engine=engine_of(plan.render, plan.suite.plugins, plan.bundle.card),
    )


def split_for(card: Card, found: FoundScene) -> Literal["train", "eval"] | None:
    """Return whether a policy was trained in a scene, by what its card says.

    Args:
        card: the policy's; `trained_on` names scenes as suites do, and with `!` before a name
            those that were left out.
        found: the scene. A variant (`NAME~2`) counts as the scene that it is a variant of: it is
            the same course.

    Returns:
        None where the card names none, or the scene is not built in, or belongs to no split.
    """
    if not card.trained_on or not is_built_in(found.reference):
        return None
    name, _ = parted(found.scene.name)
    if _was_trained(name, card.trained_on):
        return "train"
    return None if split_of(name) is None else "eval"


def _was_trained(name: str, trained_on: Sequence[str]) -> bool:
    """Whether a scene, or a variant of it, is named by `trained_on` and not left out there."""
    out = [parted(words.removeprefix(LEFT_OUT)) for words in trained_on if words[0] == LEFT_OUT]
    numbers_out = {number for pattern, number in out if is_meant(name, pattern)}
    if None in numbers_out:  # With all of its variants.
        return False
    return any(
        # A glob over scenes means no rung of a ladder.
        is_meant(name, pattern) and ("@" in name) == ("@" in pattern) and number not in numbers_out
        for pattern, number in map(parted, trained_on)
    )


def _scene_infos(plan: Plan) -> dict[str, SceneInfo]:
    trials = Counter(trial.scene for trial in plan.trials)
    return {
        found.scene.name: SceneInfo(
            digest=found.scene.digest,
            task=found.scene.task,
            trials=trials[found.scene.name],
            split=split_for(plan.bundle.card, found),
            fetched=fetched_info(reference_path(found.reference)),
            **(_marks(found.scene) if plan.renders else {}),
        )
        for found in plan.found
    }


def _marks(scene: Scene) -> dict[str, Any]:
    """Return what a scene's splat file says of its training, or scene.yaml does."""
    if not isinstance(scene.splat, FileSplat):
        return {}
    from nw_splat.store import open_store

    store = open_store(scene.splat_store())
    return {"rasterize_mode": store.rasterize_mode, "projection": store.projection}


def _pictures(rendering: Rendering) -> str:
    """Return how pictures are drawn, where it is not as published."""
    if rendering == PUBLISHED:
        return ""
    said = f", {rendering.projection}, {plural(rendering.samples, 'sample')}"
    return said if rendering.near == PUBLISHED.near else f"{said}, near {rendering.near:g} m"


def _through_lenses(plan: Plan) -> str:
    """Return which cameras are drawn along the ray though the suite says `ewa`, and why."""
    if plan.suite.render.projection == "ray":
        return ""
    cameras = mounted_robot(get_robot(plan.suite.robot), plan.bundle.card).cameras
    bent = [
        name
        for name, mount in sorted(cameras.items())
        if mount.intrinsics is not None and mount.intrinsics.distortion is not None
    ]
    return f"; with distortion, along the ray: {', '.join(bent)}" if bent else ""


def fence_of(adapter: str, *, code: bool, render: Backend, in_process: bool = False) -> str:
    """Return what stands round the workers of a run on this machine.

    Args:
        adapter: of the policy's card.
        code: as for `why_off`.
        render: the splat renderer.
        in_process: whether there are none.
    """
    off = why_off(code=code, render=render, in_process=in_process)
    network = "all" if adapter == "remote" else "none"
    return str(Fence(off=off) if off else offered(network=network))
