"""`nw-eval scenes`: what places there are, and what they look like."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


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
    """A built-in name, a scene folder, or neverwhere:<folder>."""
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
    """Find what is wrong with scenes: files, scale, holes, trail, spawn. Exit code 2 if any is."""

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """Built-in names, scene folders, or neverwhere:<folder>."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.scenes import findings_text
        from nw_eval.errors import SceneError

        checked = api.check_scenes(self.scenes)
        print(findings_text(checked))
        return SceneError.exit_code if any(scene.has_errors for scene in checked) else 0


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
class Scenes:
    """List the places that suites can name, show, check or draw them."""

    action: (
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Render, tyro.conf.subcommand("render")]
    )

    def __call__(self) -> int:
        return self.action()
