"""The live page: a stage that goes on in real time, and whatever is done to it."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from numpy.typing import NDArray

from nw_eval.errors import NwEvalError
from nw_eval.plural import plural
from nw_eval.rollout.mcap.content.entities import place_update, robot_update
from nw_eval.rollout.observed.views import View, views_of
from nw_eval.sensors.drawing.pictures import picture_of
from nw_eval.view.drawing import aim_along, draw_mesh, draw_robot, draw_splat, draw_waypoints
from nw_eval.view.live.boxes import COLOUR
from nw_eval.view.live.controls import Doings, LivePanel
from nw_eval.view.live.saving import save_played
from nw_eval.view.live.stage import Stage
from nw_eval.view.panel import STEP, enlarged, plain
from nw_eval.view.served import ServedPage

if TYPE_CHECKING:
    from nw_eval.viewing.browser import SplatPoints

_TICK = 0.002
"""Seconds between two looks at what is to be done."""
_DRAWN_EVERY = 2
"""Control steps between two poses that are sent."""
_SAID_EVERY = 0.5
"""Seconds between two words on how it goes."""
_LATE = 0.1
"""Seconds by which it may be late and catch up."""


class LivePage(ServedPage):
    """Serves a stage to browsers, where it stands still at first.

    Args:
        stage: the policy in its place; nobody else may use it meanwhile.
        splat: of the place; None = its mesh is shown.
        save_to: the folder that is proposed for what was done.
        port: to listen at; 0 = one that is free.

    Attributes:
        runs: whether it goes on.
        words: how things are.

    Raises:
        PrerequisiteError, UsageError: as `ServedPage`.
    """

    def __init__(
        self, stage: Stage, splat: SplatPoints | None, *, save_to: Path, port: int = 0
    ) -> None:
        super().__init__(port)
        self._stage, self._splat = stage, splat
        self._todo: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._pending: dict[str, float] = {}
        self.runs, self.words = False, ""
        self._due = self._said_at = 0.0
        self._done = 0
        try:
            self._draw(save_to)
            self._show()
            self._say("")
        except BaseException:
            self.close()
            raise
        self.start(self._move, _TICK)

    def do(self, action: Callable[[], None]) -> None:
        """Do something between two control steps; what goes wrong is said on the page."""
        self._todo.put(action)

    def run(self, wanted: bool) -> None:
        """Go on, or stop."""

        def begin() -> None:
            self.runs, self._due = wanted, clock.monotonic()
            self._said_at, self._done = self._due, 0
            self._say("")

        self.do(begin)

    def perturb(self, axis: str, value: float) -> None:
        """Set an axis of perturbation; only the last of many values counts."""

        def change() -> None:
            values, self._pending = self._pending, {}
            if values:
                self._stage.perturb(values)
                self._say("")

        self._pending[axis] = value
        self.do(change)

    def act(self, action: Callable[[Stage], None]) -> None:
        """Do something to the stage."""

        def acts() -> None:
            action(self._stage)
            self._draw_changed()
            self._show()
            self._say("")

        self.do(acts)

    def save(self, folder: Path) -> None:
        """Write what was done as a suite, and its place with it if that was changed."""

        def write() -> None:
            suite = save_played(self._stage, folder)
            self._announce("Saved", f"nw-eval run {suite}")

        self.do(write)

    def _move(self) -> None:
        try:
            while True:
                self._try(self._todo.get_nowait())
        except Empty:
            pass
        now = clock.monotonic()
        if self.runs and now >= self._due:
            self._due = max(self._due + STEP, now - _LATE)
            self._try(self._step)

    def _try(self, action: Callable[[], None]) -> None:
        try:
            action()
        except NwEvalError as error:
            self.runs = False
            self._announce("That does not work", str(error))

    def _step(self) -> None:
        decision, outcome = self._stage.step()
        self._done += 1
        if not self.runs or self._stage.trial.episode.step % _DRAWN_EVERY == 0 or outcome:
            self._show()
        self._show_pictures(decision.observation)
        if outcome is not None:
            self.runs = False
            self._say(self._stage.trial.episode.end_reason(outcome))
        elif clock.monotonic() - self._said_at > _SAID_EVERY or not self.runs:
            self._say("")

    def _announce(self, title: str, words: str) -> None:
        self._say(words)  # For whoever comes later, too.
        for client in self.server.get_clients().values():
            client.add_notification(title, words, auto_close_seconds=10)

    def _say(self, more: str) -> None:
        episode, now = self._stage.trial.episode, clock.monotonic()
        parts = [
            f"{episode.world.time:.2f} s",
            f"{episode.progress.reached} of {plural(episode.progress.total, 'waypoint')}",
        ]
        if self.runs and self._done and now > self._said_at:
            parts.append(f"{self._done * STEP / (now - self._said_at):.2f} of real time")
        parts += [f"{axis} {value:g}" for axis, value in self._stage.cell.items()]
        self._said_at, self._done = now, 0
        self.words = " · ".join([*parts, *filter(None, [more])])
        self._panel.status(plain(self.words), runs=self.runs)

    def _draw(self, save_to: Path) -> None:
        stage, scene = self._stage, self.server.scene
        trial = stage.trial
        scene.set_up_direction("+z")
        if self._splat is not None:
            draw_splat(scene, self._splat)
        place = SceneUpdate.FromString(place_update(stage.place.scene.mesh())).entities
        self._mesh = draw_mesh(scene, place, visible=self._splat is None)
        robot = SceneUpdate.FromString(robot_update(trial.robot.bodies, trial.robot.visuals))
        self._bodies = draw_robot(scene, robot.entities, "/robot")
        self._boxes: list[Any] = []
        self._views = tuple(
            view
            for view in views_of(trial.bundle.card)
            if len(trial.episode.sensors[view.observation].shape) > 1
        )
        trail = trial.scene.trail
        draw_waypoints(scene, trail)
        self._goal = scene.add_transform_controls(
            "/goal",
            scale=0.4,
            disable_rotations=True,
            active_axes=(True, True, False),
            position=tuple(trail[-1]),
        )
        self._goal.on_update(self._on_goal)
        aim_along(
            self.server.initial_camera, np.vstack([trial.episode.world.trunk_position, trail])
        )
        self._panel = LivePanel(
            self.server.gui,
            f"**{plain(trial.bundle.name)}** in {plain(trial.scene.name)}",
            axes=stage.axes,
            doings=Doings(
                run=lambda: self.run(not self.runs),
                step=lambda: self.do(self._one_step),
                restart=lambda: self.act(Stage.restart),
                act=self.act,
                perturb=self.perturb,
                save=self.save,
                show_mesh=self._show_mesh,
            ),
            has_splat=self._splat is not None,
            save_to=save_to,
        )

    def _one_step(self) -> None:
        self.runs = False
        self._step()

    def _on_goal(self, event: Any) -> None:
        x, y, _ = (float(value) for value in self._goal.position)
        if event.phase == "end" and math.isfinite(x) and math.isfinite(y):
            self.act(lambda stage: stage.move_goal(x, y))

    def _draw_changed(self) -> None:
        stage, scene = self._stage, self.server.scene
        draw_waypoints(scene, stage.trial.scene.trail)
        for handle in self._boxes:
            handle.remove()
        self._boxes = [
            scene.add_box(
                f"/box/{number}",
                dimensions=tuple(2.0 * half for half in box.half_size),
                color=COLOUR,
                position=box.center,
                wxyz=box.quat,
            )
            for number, box in enumerate(stage.place.boxes)
        ]

    def _show(self) -> None:
        world = self._stage.trial.episode.world
        positions, quats, *_ = world.moving()
        numbers = dict(zip(world.robot.bodies, world.bodies, strict=True))
        with self.server.atomic():
            for name, handle in self._bodies.items():
                number = numbers[name]
                handle.position, handle.wxyz = positions[number].copy(), quats[number].copy()

    def _show_pictures(self, observation: Any) -> None:
        sensors = self._stage.trial.episode.sensors
        for view in self._views[:1]:
            if view.observation in observation and sensors[view.observation].fresh:
                image = _picture(view, observation[view.observation])
                if image is not None:
                    self._panel.picture(enlarged(image))

    def _show_mesh(self, wanted: bool) -> None:
        for handle in self._mesh:
            handle.visible = wanted


def _picture(view: View, array: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Return what is to be seen of an observation, (H, W, 3)."""
    for form, image in view.pictures(array):
        if form in {"photo", "drawing"}:
            return image
        return picture_of(image, "class" if form == "classes" else "")
    return None
