"""Places: listed, explained, checked, drawn, built ahead."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.message import Message
from nw_eval.clean import clean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.engine.listener import Listener


def list_scenes(patterns: Sequence[str] = ()) -> str:
    """Return a table of scenes: name, waypoints, split (train or eval), title."""
    from nw_eval.built_in.splits import split_of
    from nw_eval.catalogue import match_scenes

    found = match_scenes(tuple(patterns) or ("*",))
    width = max(len(scene.name) for scene in found)
    return "\n".join(
        f"{scene.name:{width}}  {len(scene.trail)} waypoints  {split_of(scene.name) or '-':5}  "
        f"{scene.title}"
        for scene in found
    )


def show_scene(reference: str, *, out: Path | None = None) -> str:
    """Return a scene's figures as lines of text, and draw it from above if asked.

    Raises:
        SceneError: there is no such scene, or it cannot be read.
        StoreError: the picture cannot be written.
    """
    from nw_eval.catalogue import get_scene
    from nw_eval.scenes.plan_view import draw_plan, figures

    scene = get_scene(reference)
    if out is not None:
        draw_plan(scene, out)
    return "\n".join([*figures(scene), *([str(out)] if out is not None else [])])


def check_scenes(references: Sequence[str]) -> Message:
    """Return what is wrong with scenes, one line a finding; exit code 2 if anything is.

    Raises:
        UsageError: no scene is named, so nothing would be checked.
    """
    from nw_eval.catalogue.inspect import inspect_scene
    from nw_eval.errors import SceneError, UsageError
    from nw_eval.scenes.health.finding import has_errors

    if not references:
        raise UsageError("no scene to check", fix="name one, or its folder")
    lines: list[str] = []
    is_bad = False
    for reference in references:
        findings = inspect_scene(reference)
        is_bad |= has_errors(findings)
        lines += [f"{clean(reference)}: {finding}" for finding in findings]
        if not findings:
            lines.append(f"{clean(reference)}: nothing wrong")
    return Message(text="\n".join(lines), exit_code=SceneError.exit_code if is_bad else 0)


def render_scenes(
    patterns: Sequence[str] = (), *, out: Path, width: int = 480, listener: Listener | None = None
) -> None:
    """Draw scenes from the robot's eye and from outside into one PNG.

    Raises:
        SceneError: no such scene. StoreError: the picture cannot be written.
    """
    from nw_eval.catalogue import match_scenes
    from nw_eval.engine.listener import Silence
    from nw_eval.engine.prepare import build_splats
    from nw_eval.rollout.replaying.contact_sheet import write_scene_sheet

    found = match_scenes(tuple(patterns) or ("*",))
    build_splats(found, listener or Silence())
    write_scene_sheet(found, out, width=width)


def warmup(scenes: Sequence[str] = (), *, listener: Listener | None = None) -> str:
    """Compile the kernels into the cache and build scenes ahead; return what was done, in words."""
    from nw_eval.catalogue import match_scenes
    from nw_eval.engine.listener import Silence
    from nw_eval.engine.prepare import build_splats
    from nw_eval.splat.warmup import warmup as compile_kernels

    seconds = compile_kernels()
    found = match_scenes(tuple(scenes)) if scenes else ()
    build_splats(found, listener or Silence())
    built = f", {len(found)} scenes built" if found else ""
    return f"kernels ready after {seconds:.1f} s{built}"
