"""What was done to a stage, as a suite that meets it in every run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import StoreError, UsageError
from nw_eval.files.inside import what_is
from nw_eval.suite.ready import write_ready_suite
from nw_eval.twin.label.copying import write_place

if TYPE_CHECKING:
    from nw_eval.view.live.stage import Stage

SUITE = "suite.yaml"
_MOST_PUSHED = 3.0
"""m/s, that a suite may name."""


def save_played(stage: Stage, folder: Path) -> Path:
    """Write a suite of what was done, and the place with its boxes and its goal if it was changed.

    The axes of perturbation stand in it as they are set. Pushes by hand become the axis `push`, as
    hard as the hardest of them, unless that is set.

    Returns:
        The suite's file.

    Raises:
        UsageError: something is in the folder already.
        StoreError: it cannot be written.
    """
    if what_is(folder) != "nothing":
        raise UsageError(f"{folder} is there already", fix="name another folder")
    cell = dict(stage.cell)
    if stage.pushed and "push" not in cell:
        cell["push"] = round(min(stage.pushed, _MOST_PUSHED), 3)
    try:
        folder.mkdir(parents=True)
        scene = stage.reference
        if stage.place.is_changed:
            place = replace(stage.place, scene=stage.original)
            write_place(place.changed(), folder)
            scene = "."
        write_ready_suite(
            folder / SUITE,
            stage.place.scene.name,
            [scene],
            robot=stage.trial.robot.name,
            policy=stage.policy,
            perturb={axis: [value] for axis, value in sorted(cell.items())},
        )
    except OSError as error:
        raise StoreError(f"cannot write {folder}: {error.strerror or error}") from error
    return folder / SUITE
