"""Opens a live page: the stage, the splat of its place, and where the work of a player goes."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.splat.files import read_splat
from nw_eval.view.live.page import LivePage
from nw_eval.view.live.stage import open_stage
from nw_eval.viewing.browser import SplatPoints, splat_points

if TYPE_CHECKING:
    from nw_eval.scenes.scene import Scene


@contextmanager
def open_live(
    policy: str, scene: str, *, checkpoint: Path | None = None, allow_code: bool = False, port: int
) -> Generator[LivePage]:
    """Serve a policy in a place, standing still at first.

    Raises:
        NwEvalError: either cannot be used, or nothing can be served.
    """
    with open_stage(policy, scene, checkpoint=checkpoint, allow_code=allow_code) as stage:
        splat = _splat(stage.original)
        with LivePage(stage, splat, save_to=_free_folder(stage.original), port=port) as page:
            yield page


def _splat(scene: Scene) -> SplatPoints | None:
    if scene.splat is None:
        return None
    return splat_points(read_splat(scene.splat_store()), scene.T_world_splat)


def _free_folder(scene: Scene) -> Path:
    name = scene.name.rpartition("/")[2]
    number = 1
    while (folder := Path(f"played-{name}-{number}")).exists():
        number += 1
    return folder
