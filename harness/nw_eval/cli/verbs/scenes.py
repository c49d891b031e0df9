"""`nw-eval scenes`: what places there are, what they look like, and those of a hub."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.plural import in_words, plural
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import CheckedScene, ListedScene, PushedScene
    from nw_scenes.overview import SceneFigures
    from nw_sim.ladders import Ladder, Rung


@verb_of("list_scenes")
class List(Printed, Verb):
    """List scenes with their waypoints, split (`split:eval` selects one) and obstacles."""

    def show(self, result: Sequence[ListedScene]) -> str:
        return scene_table(result)


@verb_of("ladders", named={"names": "ladders"})
class Ladders(Printed, Verb):
    """List ladders: scenes, perturbations and commands that grow harder by one number.

    A ladder that is named is listed with its rungs. A rung is a scene, such as hurdles/bar@0.34.
    """

    ladders: tuple[str, ...]

    def show(self, result: Sequence[Ladder]) -> str:
        return rungs_table(result) if self.ladders else ladder_table(result)


@verb_of("show_scene", named={"reference": "scene"})
class Show(Printed, Verb):
    """Show a scene, and draw it from above with its course and heights."""

    out: Path | None

    def show(self, result: SceneFigures) -> str:
        return scene_page(result) if self.out is None else f"{scene_page(result)}\n{self.out}"


@verb_of("check_scenes", without=("policy",), named={"references": "scenes"})
class Check(Printed, Verb):
    """Check scenes for errors: files, start, course, splat. Exit code 2 on an error.

    Along the course it checks for ground that does not support the robot's feet, steps and gaps
    that its legs cannot pass, and a splat that does not show what the mesh has.
    """

    out: Path | None
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    """With --out: the policy of the suite (default: one that has a card for the robot)."""

    def more(self) -> dict[str, Any]:
        return {"policy": self.policy}

    def show(self, result: Sequence[CheckedScene]) -> str:
        if self.out is None or self.code(result):
            return findings_text(result)
        return f"{findings_text(result)}\nready: nw-eval run {shlex.quote(str(self.out))}"

    def code(self, result: Sequence[CheckedScene]) -> int:
        return SceneError.exit_code if any(scene.has_errors for scene in result) else 0


@verb_of("render_scenes", listens=True)
class Render(Verb):
    """Draw scenes through the robot's camera and from outside on one sheet."""

    out = Path("scenes.png")


@dataclass(frozen=True, kw_only=True)
class FetchScenes:
    """Download the current version of scenes from their hub.

    Runs then use this copy and need no network. Nothing is executed. Run the same command again to
    resume a download. HF_TOKEN or `hf auth login` sets the user, HF_ENDPOINT the hub. Needs the
    extra `hub`.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """hub:org/name, hub:org/name@revision, neverwhere:NAME of the published release, or real:NAME
    for a real environment."""
    file: Path | None = None
    """For real:NAME: its file, downloaded on another machine. Its digest is checked."""

    def __call__(self) -> int:
        from nw_base.errors import UsageError
        from nw_eval import api
        from nw_eval.cli.terminal.lines import fetched_lines

        if not self.scenes:
            raise UsageError("no scene to fetch", fix="name one, such as hub:org/name")
        if self.file is not None and len(self.scenes) > 1:
            raise UsageError("--file is of one scene", fix="fetch the others without it")
        for scene in self.scenes:
            print(fetched_lines(api.fetch_scene(scene, file=self.file)))
        return 0


@verb_of("push_scene", named={"folder": "scene"})
class PushScene(Verb):
    """Upload a scene folder to a hub data set, as one commit. Needs the extra `hub`.

    Uploads the files of the scene, README and licence, and nothing else. A scene with errors
    (`scenes check`) is not uploaded.
    """

    def show(self, result: PushedScene) -> str:
        return pushed_line(result)


def scene_table(scenes: Sequence[ListedScene]) -> str:
    """Return a line for each scene: name, waypoints, split, title."""
    width = max(len(scene.name) for scene in scenes)
    return "\n".join(
        f"{scene.name:{width}}  {plural(scene.waypoints, 'waypoint'):11}  {scene.split or '-':5}  "
        f"{_asked(scene)}{scene.title}"
        for scene in scenes
    )


def ladder_table(ladders: Sequence[Ladder]) -> str:
    """Return a line for each ladder: name, easiest and hardest rung, number of rungs, title."""
    ends = [
        f"{each.told(each.rungs[0].value)} to {each.told(each.rungs[-1].value)}" for each in ladders
    ]
    wide, long = max(len(each.name) for each in ladders), max(map(len, ends))
    return "\n".join(
        f"{each.name:{wide}}  {end:{long}}  {plural(len(each.rungs), 'rung'):9}  {each.parameter}"
        for each, end in zip(ladders, ends, strict=True)
    )


def rungs_table(ladders: Sequence[Ladder]) -> str:
    """Return a line for each rung of ladders: value, scene, and what is changed there."""
    return "\n".join(
        f"{each.told(rung.value):24}  {_changed(rung)}" for each in ladders for rung in each.rungs
    )


def _changed(rung: Rung) -> str:
    cell = "".join(f"  {axis} {value:g}" for axis, value in rung.perturbation)
    return f"{clean(rung.scene)}{cell}"


def _asked(scene: ListedScene) -> str:
    """Return what a scene asks of legs, in columns; empty where no robot was asked for."""
    if scene.fit is None:
        return ""
    asked = scene.fit.demands
    gap = f"gap {asked.gap:.2f} m" if asked.gap else ""
    return f"step {max(asked.up, asked.down):.2f} m  {gap:10}  {scene.fit.asks_for:21}  "


def scene_page(scene: SceneFigures) -> str:
    """Return all figures of one scene."""
    x, y, z = scene.spawn
    solids = ", ".join(f"{count} {kind}" for kind, count in scene.solids.items())
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in scene.triangles.items())
    lines = [
        f"name       {scene.name}",
        f"title      {scene.title}",
        f"task       {scene.task}",
        f"digest     {scene.digest}",
        f"licence    {scene.licence}",
        f"spawn      x {x:.2f}  y {y:.2f}  z {z:.2f} m, heading {scene.heading:.2f} rad",
        f"ground     z {scene.ground:.3f} m",
        f"solids     {solids}",
        f"mesh       {sum(scene.triangles.values()):,} triangles: {kinds}",
        f"splat      {'none' if scene.splat is None else scene.splat[:16]}",
    ]
    for index, (px, py, pz) in enumerate(scene.trail):
        label = "trail" if index == 0 else ""
        lines.append(f"{label:<10} {index + 1}: x {px:.2f}  y {py:.2f}  z {pz:.2f} m")
    return "\n".join(lines)


def findings_text(scenes: Sequence[CheckedScene]) -> str:
    """Return a line for each figure and finding of each scene, and one where nothing is wrong."""
    from nw_sim.survey import survey_lines

    lines: list[str] = []
    for scene in scenes:
        name = clean(scene.reference)
        if scene.survey is not None:
            lines += [f"{name}: {line}" for line in survey_lines(scene.survey)]
        lines += [f"{name}: {finding}" for finding in scene.findings]
        if not scene.findings:
            lines.append(f"{name}: no findings")
    return "\n".join(lines)


def pushed_line(pushed: PushedScene) -> str:
    """Return what names the revision that was made."""
    return f"{pushed.reference}: {plural(len(pushed.files), 'file')}, {in_words(pushed.bytes)}"
