"""`nw-eval scenes`: what places there are, what they look like, and those of a hub."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from nw_eval.words import Robot


@dataclass(frozen=True, kw_only=True)
class List:
    """List scenes with their waypoints, split (`split:eval` names its scenes) and obstacles."""

    patterns: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names or globs; every built-in scene when absent."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.scenes import scene_table

        print(scene_table(api.list_scenes(self.patterns)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Show:
    """Say everything about one scene, and draw it from above with its trail and heights."""

    scene: tyro.conf.Positional[str]
    """A built-in name, a scene folder, neverwhere:<folder or published name>, or hub:org/name."""
    out: Path | None = None
    """A PNG of the view from above."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.scenes import scene_page

        print(scene_page(api.show_scene(self.scene, out=self.out)))
        if self.out is not None:
            print(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class Check:
    """Find what is wrong with scenes: files, start, trail, splat. Exit code 2 if any is.

    Along the trail: ground that does not carry the robot's feet, and a splat that does not show its
    camera what the mesh has there.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """Built-in names, scene folders, neverwhere:<folder or published name>, or hub:org/name."""
    robot: Robot = "go1"
    """Whose feet, camera and length count."""
    suite: Path | None = None
    """Write a suite of them to this file, ready to run, unless something is wrong."""
    policy: str | None = None
    """With --suite: the policy of the suite. One that nw-eval has a card of when absent."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.scenes import findings_text
        from nw_eval.errors import SceneError

        checked = api.check_scenes(
            self.scenes, robot=self.robot, suite=self.suite, policy=self.policy
        )
        print(findings_text(checked))
        if any(scene.has_errors for scene in checked):
            return SceneError.exit_code
        if self.suite is not None:
            print(f"ready: nw-eval run {shlex.quote(str(self.suite))}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Render:
    """Draw scenes from the robot's eye and from outside on one sheet; by mesh without a splat."""

    patterns: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names or globs; every built-in scene when absent."""
    out: Path = Path("scenes.png")
    """The PNG to write."""
    width: int = 480
    """Pixels across each view."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.progress import build_progress

        with build_progress() as listener:
            picture = api.render_scenes(
                self.patterns, out=self.out, width=self.width, listener=listener
            )
        print(picture)
        return 0


@dataclass(frozen=True, kw_only=True)
class FetchScenes:
    """Fetch places as their hub has them now; runs use them from then on, without a network.

    A download that breaks goes on where it broke when the command is given again. HF_TOKEN or
    `hf auth login` says who you are, HF_ENDPOINT which hub. Needs the extra `hub`.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """hub:org/name, hub:org/name@revision, or neverwhere:NAME of the published release."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.elsewhere import fetched_lines
        from nw_eval.errors import UsageError

        if not self.scenes:
            raise UsageError("no scene to fetch", fix="name one, such as hub:org/name")
        for scene in self.scenes:
            print(fetched_lines(api.fetch_scene(scene)))
        return 0


@dataclass(frozen=True, kw_only=True)
class PushScene:
    """Put a scene folder into a data set of a hub, as one commit. Needs the extra `hub`.

    The files that the scene is made of are pushed, README and licence if they lie beside them, and
    nothing else. A scene that `scenes check` finds errors in is not.
    """

    scene: tyro.conf.Positional[Path]
    """The folder, with its scene.yaml."""
    to: tyro.conf.Positional[str]
    """hub:org/name; the repository is made if it is not there."""
    private: bool = False
    """Make a repository that only its owner sees."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.elsewhere import pushed_line

        print(pushed_line(api.push_scene(self.scene, self.to, private=self.private)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Scenes:
    """List the places that suites can name, show, check or draw them; fetch and push them."""

    action: (
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Render, tyro.conf.subcommand("render")]
        | Annotated[FetchScenes, tyro.conf.subcommand("fetch")]
        | Annotated[PushScene, tyro.conf.subcommand("push")]
    )

    def __call__(self) -> int:
        return self.action()
