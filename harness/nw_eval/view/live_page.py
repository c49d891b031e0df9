"""The live page: a stage that goes on in real time, and whatever is done to it.

On its panel one runs, pushes, perturbs, stands in the way, and saves what was done to the stage as
a suite that meets it in every run.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from numpy.typing import NDArray

from nw_base.errors import NwEvalError, StoreError, UsageError
from nw_base.files.inside import what_is
from nw_eval.suite.load import write_ready_suite
from nw_eval.view.drawing import (
    MOTION_TINT,
    ServedPage,
    aim_along,
    draw_mesh,
    draw_robot,
    draw_splat,
    draw_waypoints,
    enlarged,
    plain,
)
from nw_eval.view.live_stage import COLOUR, Stage, open_stage
from nw_eval.viewing.browser import SplatPoints, splat_points
from nw_scenes.prop import prop_body
from nw_scenes.saving import write_place
from nw_sim.axes import AXES, axis_named
from nw_sim.rollout.mcap.drawn import place_update, props_update, robot_update
from nw_sim.rollout.observed import View, views_of
from nw_sim.sensors.drawing.pictures import picture_of
from nw_splat.files import read_splat

if TYPE_CHECKING:
    from nw_scenes.scene import Scene


@contextmanager
def open_live(
    policy: str, scene: str, *, checkpoint: Path | None = None, allow_code: bool = False, port: int
) -> Generator[LivePage]:
    """Serve a policy in a scene, standing still at first.

    Raises:
        NwEvalError: either cannot be used, or nothing can be served.
    """
    with open_stage(policy, scene, checkpoint=checkpoint, allow_code=allow_code) as stage:
        splat = _splat_of(stage.original)
        with LivePage(stage, splat, save_to=_free_folder(stage.original), port=port) as page:
            yield page


def _splat_of(scene: Scene) -> SplatPoints | None:
    if scene.splat is None:
        return None
    return splat_points(read_splat(scene.splat_store()), scene.T_world_splat)


def _free_folder(scene: Scene) -> Path:
    name = scene.name.rpartition("/")[2]
    number = 1
    while (folder := Path(f"played-{name}-{number}")).exists():
        number += 1
    return folder


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
        stage: the policy in its scene; no other code may use it meanwhile.
        splat: of the scene; None = its mesh is shown.
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

    def one_step(self) -> None:
        """Make one control step, and stop."""

        def step() -> None:
            self.runs = False
            self._step()

        self.do(step)

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

    def show_mesh(self, wanted: bool) -> None:
        """Show the mesh of the scene, or its splat alone."""
        for handle in self._mesh:
            handle.visible = wanted

    def _move(self) -> None:
        try:
            while True:
                self._try(self._todo.get_nowait())
        except Empty:
            pass
        now = clock.monotonic()
        if self.runs and now >= self._due:
            period = self._stage.trial.episode.world.control_period
            self._due = max(self._due + period, now - _LATE)
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
            self._say("")
        elif clock.monotonic() - self._said_at > _SAID_EVERY or not self.runs:
            self._say("")

    def _announce(self, title: str, text: str) -> None:
        self._say(text)  # For whoever comes later, too.
        for client in self.server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=10)

    def _say(self, more: str) -> None:
        episode, now = self._stage.trial.episode, clock.monotonic()
        parts = [
            f"{episode.world.time:.2f} s",
            episode.task.standing,
        ]
        if self.runs and self._done and now > self._said_at:
            done = self._done * episode.world.control_period
            parts.append(f"{done / (now - self._said_at):.2f} of real time")
        parts += [f"{axis} {value:g}" for axis, value in self._stage.cell.items()]
        if self._stage.run_end is not None:
            at, outcome, reason = self._stage.run_end
            how = _ENDS.get(outcome, outcome.replace("_", " "))
            parts.append(f"a run ends at {at:.2f} s: {how} ({reason})")
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
        moving = robot_update(trial.robot.bodies, trial.robot.visuals)
        robot = SceneUpdate.FromString(moving + props_update(trial.scene.props))
        self._bodies = draw_robot(scene, robot.entities, "/robot")
        parts = robot.entities if trial.episode.task.reference is not None else ()
        self._motion = draw_robot(scene, parts, "/motion", MOTION_TINT)
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
        heading = f"**{plain(trial.bundle.name)}** in {plain(trial.scene.name)}"
        self._panel = LivePanel(
            self, stage, heading, has_splat=self._splat is not None, save_to=save_to
        )

    @property
    def has_picture(self) -> bool:
        """Whether the policy has an observation that is an image."""
        return bool(self._views)

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
        numbers |= zip(
            (prop_body(prop.name) for prop in world.scene.props), world.props, strict=True
        )
        with self.server.atomic():
            for name, handle in self._bodies.items():
                number = numbers[name]
                handle.position, handle.wxyz = positions[number].copy(), quats[number].copy()
        if (placed := self._stage.trial.episode.task.reference) is not None:
            frame = placed.at(self._stage.trial.episode.step)
            root = np.concatenate([frame.root_position, frame.root_quat])[np.newaxis]
            bodies = world.robot.bodies
            own, turns = world.kinematics(root, frame.joint_positions[np.newaxis], bodies)
            with self.server.atomic():
                for number, name in enumerate(bodies):
                    if (handle := self._motion.get(name)) is not None:
                        handle.position, handle.wxyz = own[0, number], turns[0, number]

    def _show_pictures(self, observation: Any) -> None:
        sensors = self._stage.trial.episode.sensors
        for view in self._views[:1]:
            if view.observation in observation and sensors[view.observation].fresh:
                image = _picture(view, observation[view.observation])
                if image is not None:
                    self._panel.picture(enlarged(image))


def _picture(view: View, array: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Return what is to be seen of an observation, (H, W, 3)."""
    for form, image in view.pictures(array):
        if form in {"photo", "drawing"}:
            return image
        return picture_of(image, "class" if form == "classes" else "")
    return None


_WAYS = {"ahead": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}


_ENDS = {"completed": "success", "timeout": "time limit"}
"""Outcomes that a page calls otherwise than rows do."""


class LivePanel:
    """Draws the controls.

    Args:
        page: that they steer; viser's panel there is empty.
        stage: whose axes of perturbation have sliders.
        heading: names the policy and the scene.
        has_splat: of the scene.
        save_to: the folder that is proposed.
    """

    def __init__(
        self, page: LivePage, stage: Stage, heading: str, *, has_splat: bool, save_to: Path
    ) -> None:
        gui: Any = page.server.gui
        gui.add_markdown(heading)
        self._status = gui.add_markdown("")
        self._run = gui.add_button("Play")
        self._run.on_click(lambda _: page.run(not page.runs))
        gui.add_button("One step").on_click(lambda _: page.one_step())
        gui.add_button("Start again").on_click(lambda _: page.act(Stage.restart))
        if has_splat:
            mesh = gui.add_checkbox("Mesh", initial_value=False)
            mesh.on_update(lambda _: page.show_mesh(mesh.value))
        if not page.has_picture:
            gui.add_markdown("The policy has no camera.")
        self._ego = gui.add_image(np.zeros((9, 16, 3), np.uint8), label="What the policy sees")
        self._ego.visible = False
        with gui.add_folder("Push"):
            speed = gui.add_slider("m/s", min=0.1, max=2.0, step=0.1, initial_value=0.5)
            ways = gui.add_button_group("To", tuple(_WAYS))
            ways.on_click(lambda _: page.act(_push(ways.value, speed.value)))
        with gui.add_folder("In its way"):
            gui.add_button("Drop a box").on_click(lambda _: page.act(lambda s: s.drop_box()))
            gui.add_button("No boxes").on_click(lambda _: page.act(lambda s: s.clear_boxes()))
            gui.add_markdown("Drag the arrows at the last waypoint to move the goal.")
        with gui.add_folder("Perturb"):
            for axis in stage.axes:
                self._slider(page, axis)
        with gui.add_folder("Save"):
            folder = gui.add_text("Folder", str(save_to))
            gui.add_button("Save as a suite").on_click(lambda _: page.save(Path(folder.value)))

    def status(self, text: str, *, runs: bool) -> None:
        """Say how things are."""
        self._status.content = text
        self._run.label = "Pause" if runs else "Play"

    def picture(self, image: NDArray[np.uint8]) -> None:
        """Show what the policy sees, (H, W, 3)."""
        self._ego.visible = True
        self._ego.image = image

    def _slider(self, page: LivePage, axis: str) -> None:
        declared = axis_named(axis)
        least, most, step = declared.slides
        slider = page.server.gui.add_slider(
            declared.label, min=least, max=most, step=step, initial_value=declared.reference
        )
        slider.on_update(lambda _: page.perturb(axis, round(float(slider.value), 4)))


def _push(way: str, speed: float) -> Callable[[Stage], None]:
    ahead, left = _WAYS[way]
    return lambda stage: stage.push(speed * ahead, speed * left)


SUITE = "suite.yaml"


def save_played(stage: Stage, folder: Path) -> Path:
    """Write a suite of what was done, and the scene with its boxes and its goal if it was changed.

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
        cell["push"] = round(min(stage.pushed, AXES["push"].high), 3)
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
