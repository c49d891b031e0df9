"""What one trial writes down, topic by topic: see the table in docs/reference/mcap.md and `topics`.

Log time is simulated time. A message says all that its topic shows: a viewer whose time is moved
looks at the latest one only. A log that cannot be written costs the log, never the trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import Concatenate, Literal, ParamSpec

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from nw_base.clean import clean
from nw_base.lens import Intrinsics
from nw_base.words import Record
from nw_scenes.mesh import TriangleMesh
from nw_scenes.prop import Prop, prop_body
from nw_scenes.robots import RobotSpec
from nw_sim.rollout.mcap.drawn import (
    CourseClouds,
    Discs,
    place_cloud,
    place_update,
    props_update,
    robot_clouds,
    robot_update,
    trail_update,
)
from nw_sim.rollout.mcap.file import Images, McapFile
from nw_sim.rollout.mcap.images import (
    PixelForm,
    SeenRows,
    calibration_message,
    image_message,
    observation_message,
)
from nw_sim.rollout.mcap.messages import (
    Event,
    Observation,
    Saved,
    States,
    Term,
    nanoseconds,
    stamp,
)
from nw_sim.rollout.mcap.steps import BodyForms, StepNote, Steps
from nw_sim.rollout.mcap.topics import MOTION, MOTORS

EventKind = Literal["start", "waypoint", "task", "contact", "coverage", "end", "error"]

_IMAGES: dict[Record, Images] = {
    "all": "keep",
    "failures": "decide",
    "none": "drop",
    "summary": "drop",
}
_P = ParamSpec("_P")


def _costs_only_the_log(
    method: Callable[Concatenate[TrialLog, _P], None],
) -> Callable[Concatenate[TrialLog, _P], None]:
    @wraps(method)
    def guarded(self: TrialLog, /, *args: _P.args, **kwargs: _P.kwargs) -> None:
        if self.is_open:
            try:
                method(self, *args, **kwargs)
            except OSError as error:
                self.lose(error)

    return guarded


class TrialLog:
    """The log of one trial. Without a path, and once writing has failed, every method is free.

    Of a summary (`record: summary`) there is what names the trial, the course, the walked path,
    events and scores: no message of each control step, no state, no image, nothing of the scene.

    Call order: `start`, then any of the others with times that do not decrease, then `finish` or
    `discard`.
    """

    def __init__(self, path: Path | None, *, record: Record) -> None:
        self.error = ""  # why there is no log, one line
        self.bytes = 0  # size of the finished file
        self._path = path
        self._is_summary = record == "summary"
        self._states = States()
        self._steps: Steps | None = None
        self._place: tuple[Discs, CourseClouds] | None = None
        self._file: McapFile | None = None
        if path is not None:
            try:
                self._file = McapFile(path, images=_IMAGES[record])
            except OSError as error:
                self.lose(error)

    @property
    def is_open(self) -> bool:
        """Whether anything is written at all."""
        return self._file is not None

    @property
    def takes_images(self) -> bool:
        """Whether an image that is added now can still end up in the file."""
        return self._file is not None and self._file.takes_images

    def lose(self, error: OSError) -> None:
        """Give the log up and remember why."""
        # Only errors of the operating system have a number, and only they are about the disk.
        fix = "" if error.errno is None else "; free space or choose another --out"
        self.error = f"{self._path}: {error.strerror or error}{fix}"
        self.discard()

    def discard(self) -> None:
        """Remove what was written so far."""
        if self._file is not None:
            self._file.discard()
            self._file = None

    @property
    def _out(self) -> McapFile:
        assert self._file is not None, "only reached through _costs_only_the_log"
        return self._file

    @_costs_only_the_log
    def start(
        self,
        *,
        robot: RobotSpec,
        mesh: TriangleMesh,
        start: Sequence[float],
        trail: np.ndarray,
        bodies: Sequence[int],
        in_model: int,
        cameras: Mapping[str, np.ndarray],
        seen: SeenRows,
        command: Callable[[float], tuple[float, float, float]],
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[tuple[str, str]],
        motion: bytes = b"",
        motors: bytes = b"",
        props: Sequence[Prop] = (),
        prop_bodies: Sequence[int] = (),
    ) -> None:
        """Write what does not change: the trial, the scene, the robot, the course (K, 3).

        Args:
            robot: in whose bodies' frames its parts stand.
            mesh: of the scene.
            start: ground under the robot, (3,) m.
            trail: waypoints, (K, 3) m.
            bodies: numbers of the robot's bodies, trunk first, among those of the model.
            in_model: how many bodies the model has.
            cameras: those that have a frame, by name: position and quaternion wxyz in the trunk,
                (7,).
            seen: the policy's observations that are rows of numbers.
            command: from a heading error, rad, to what is asked for: see `Steps`.
            metadata: records of texts by name.
            attachments: name and text of each.
            motion: that is to be tracked, from `packed_motion`; empty = none.
            motors: their networks, from `packed_programs`; empty = none.
            props: of the scene.
            prop_bodies: their numbers among those of the model.
        """
        for name, values in metadata.items():
            self._out.add_metadata(name, dict(values))
        for name, text in attachments:
            self._out.attach(name, "text/plain", text.encode())
        if motion:
            self._out.attach(MOTION, "application/octet-stream", motion)
        if motors:
            self._out.attach(MOTORS, "application/octet-stream", motors)
        self._place = Discs(trail), CourseClouds(start, trail)
        parts = robot.bodies, robot.visuals
        scene = robot_update(*parts) + trail_update(start, trail) + props_update(props)
        if not self._is_summary:
            scene = place_update(mesh) + scene
        self._out.add_bytes("/scene", 0, SceneUpdate, scene)
        if not self._is_summary:
            self._out.add_bytes("/points/place", 0, PointCloud, place_cloud(mesh))
            for body, cloud in robot_clouds(*parts).items():
                self._out.add_bytes(f"/points/robot/{body}", 0, PointCloud, cloud)
        self._waypoints(0, 0)
        frames = {camera_frame(name): pose for name, pose in cameras.items()}
        body = BodyForms(
            names=robot.bodies,
            bodies=bodies,
            in_model=in_model,
            joints=robot.joints,
            cameras=frames,
            carriers=[
                robot.bodies.index(robot.cameras[name].body or robot.root) for name in cameras
            ],
            props={
                prop_body(prop.name): number
                for prop, number in zip(props, prop_bodies, strict=True)
            },
        )
        self._steps = Steps(
            body,
            joints=len(robot.joints),
            seen=seen,
            command=command,
            is_summary=self._is_summary,
        )

    def step(self, step: StepNote) -> None:
        """Write a control step."""
        file, steps = self._file, self._steps
        if file is None:
            return
        assert steps is not None, "start comes first"
        steps.note(step)
        try:  # As `_costs_only_the_log`, without a call of its own: this happens most often.
            file.add_noted(steps, step.time)
        except OSError as error:
            self.lose(error)

    @_costs_only_the_log
    def state(self, time: float, saved: Saved) -> None:
        """Write a restartable state; a summary has none."""
        if self._is_summary:
            return
        self._states.note(nanoseconds(time), saved)
        self._out.add_noted(self._states, time, holds=saved.size)

    @_costs_only_the_log
    def many_numbers(self, time: float, name: str, array: np.ndarray) -> None:
        """Write an observation that is as large as an image, where images are kept."""
        when = nanoseconds(time)
        message = partial(observation_message, when, name, array)
        self._out.add_image(f"/observation/{name}", when, message)

    @_costs_only_the_log
    def calibration(
        self,
        time: float,
        topic: str,
        *,
        mount: str,
        lens: Intrinsics,
    ) -> None:
        """Write the calibration of a topic's pictures; `mount` is the camera."""
        when = nanoseconds(time)
        message = calibration_message(when, camera_frame(mount), lens)
        self._out.add(f"{topic}/calib", when, message)

    @_costs_only_the_log
    def picture(
        self, time: float, topic: str, image: np.ndarray, *, mount: str, form: PixelForm
    ) -> None:
        """Write a picture that is there; see `images.PixelForm` for its shape and type.

        Whether it is kept is known at the trial's end, and only then is it compressed.
        """
        when, own = nanoseconds(time), image.copy()
        make = partial(image_message, when, camera_frame(mount), own, form)
        self._out.add_image(topic, when, make, holds=own.nbytes)

    @_costs_only_the_log
    def later_picture(
        self, time: float, topic: str, make: Callable[[], np.ndarray], *, mount: str
    ) -> None:
        """Write the photo that `make` returns, (H, W, 3) uint8; it runs only if images are kept."""
        when = nanoseconds(time)
        frame = camera_frame(mount)
        self._out.add_image(topic, when, lambda: image_message(when, frame, make()))

    @_costs_only_the_log
    def waypoints(self, time: float, *, reached: int) -> None:
        """Colour the waypoints that are reached, and the course as far as the last of them."""
        self._waypoints(nanoseconds(time), reached)

    @_costs_only_the_log
    def event(
        self,
        time: float,
        kind: EventKind,
        text: str,
        *,
        step: int,
        waypoint: int = -1,
        value: float = 0.0,
    ) -> None:
        """Write that something happened, for programs and for people."""
        when = nanoseconds(time)
        text = clean(text)
        event = Event(
            timestamp=stamp(when), step=step, kind=kind, text=text, waypoint=waypoint, value=value
        )
        level = Log.ERROR if kind == "error" else Log.INFO
        self._out.add("/nw/event", when, event)
        line = Log(timestamp=stamp(when), level=level, message=text, name=f"nw.{kind}")
        self._out.add("/log", when, line)

    @_costs_only_the_log
    def scores(self, time: float, values: Mapping[str, float]) -> None:
        """Write scores of the trial until now, by name, each in its unit."""
        if not values:
            return
        when = nanoseconds(time)
        terms = [Term(name=name, values=[value]) for name, value in values.items()]
        self._out.add(
            "/scores", when, Observation(timestamp=stamp(when), shape=[len(terms)], terms=terms)
        )

    @_costs_only_the_log
    def finish(self, *, keep_images: bool, verdict: Mapping[str, str]) -> None:
        """Write what waited for the trial's end, and move the file into place."""
        self._out.settle(keep_images=keep_images)
        self._out.add_metadata("nw.verdict", dict(verdict))
        self.bytes = self._out.close()
        self._file = None

    def _waypoints(self, when: int, reached: int) -> None:
        assert self._place is not None, "start comes first"
        discs, clouds = self._place
        self._out.add_bytes("/waypoints", when, SceneUpdate, discs.update(when, reached=reached))
        for topic, cloud in (
            ("/points/trail", clouds.trail(when, reached=reached)),
            ("/points/waypoints", clouds.waypoints(when, reached=reached)),
        ):
            self._out.add_bytes(topic, when, PointCloud, cloud)


def camera_frame(camera: str) -> str:
    """Return the name of a camera's frame in `/tf`; its axes are OpenCV's."""
    return f"camera/{camera}"
