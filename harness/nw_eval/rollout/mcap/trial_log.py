"""What one trial writes down, topic by topic.

    /tf                  foxglove.FrameTransforms    every control step: bodies and cameras
    /robot/joints        foxglove.JointStates        every control step
    /robot/odom          foxglove.PoseInFrame        every control step
    /scene               foxglove.SceneUpdate        at the start, and when a waypoint is reached
    /camera/<name>       foxglove.CompressedImage    at the camera's rate
    /camera/<name>/calib foxglove.CameraCalibration  once
    /nw/policy           nw.PolicyStep               every control step
    /nw/state            nw.SimState                 10 Hz (2 Hz with images), at waypoints and
                                                     first contacts, and at the end
    /nw/event, /log      nw.Event, foxglove.Log      when something happens

Log time is simulated time. A log that cannot be written costs the log, never the trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, Literal, ParamSpec

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from nw_eval.clean import clean
from nw_eval.robots import RobotSpec
from nw_eval.rollout.job import Record
from nw_eval.rollout.mcap.body import BodyMessages, BodyPoses
from nw_eval.rollout.mcap.entities import place_entities, robot_entities, waypoint_entity
from nw_eval.rollout.mcap.file import Images, McapFile
from nw_eval.rollout.mcap.images import calibration_message, image_message
from nw_eval.rollout.mcap.messages import Event, PolicyStep
from nw_eval.rollout.mcap.stamps import nanoseconds, stamp
from nw_eval.scenes.mesh import TriangleMesh

EventKind = Literal["start", "waypoint", "contact", "coverage", "end", "error"]

_IMAGES: dict[Record, Images] = {"all": "keep", "failures": "decide", "none": "drop"}
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

    Call order: `start`, then any of the others with times that do not decrease, then `finish` or
    `discard`.
    """

    def __init__(self, path: Path | None, *, record: Record, joints: Sequence[str]) -> None:
        self.error = ""  # why there is no log, one line
        self.bytes = 0  # size of the finished file
        self._path = path
        self._bodies = BodyMessages(joints)
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
        trail: np.ndarray,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[tuple[str, str]],
    ) -> None:
        """Write what does not change: the trial, the place, the robot, the trail (K, 3)."""
        for name, values in metadata.items():
            self._out.add_metadata(name, dict(values))
        for name, text in attachments:
            self._out.attach(name, "text/plain", text.encode())
        update = SceneUpdate()
        update.entities.extend(place_entities(mesh))
        update.entities.extend(robot_entities(robot))
        update.entities.extend(
            waypoint_entity(k, position, reached=False) for k, position in enumerate(trail)
        )
        for entity in update.entities:
            entity.timestamp.CopyFrom(stamp(0))
        self._out.add("/scene", 0, update)

    @_costs_only_the_log
    def body(
        self,
        time: float,
        *,
        frames: BodyPoses,
        trunk: str,
        joints: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """Write where the robot is: frames in the world; angles, velocities, torques (12)."""
        when = nanoseconds(time)
        self._out.add("/tf", when, self._bodies.transforms(when, frames))
        self._out.add("/robot/joints", when, self._bodies.joints(when, *joints))
        self._out.add("/robot/odom", when, self._bodies.odom(when, *frames[trunk]))

    @_costs_only_the_log
    def policy(
        self,
        time: float,
        *,
        step: int,
        observation_digest: bytes,
        state_digest: bytes,
        action: np.ndarray,
        applied: np.ndarray,
        targets: np.ndarray,
    ) -> None:
        """Write one call of the policy: raw, applied (12) and joint targets (12) rad."""
        when = nanoseconds(time)
        message = PolicyStep(
            timestamp=stamp(when),
            step=step,
            observation_digest=observation_digest,
            action=action.tolist(),
            applied=applied.tolist(),
            targets=targets.tolist(),
            state_digest=state_digest,
        )
        self._out.add("/nw/policy", when, message)

    @_costs_only_the_log
    def state(self, time: float, message: Any) -> None:
        """Write a restartable state, an `nw.SimState`."""
        when = nanoseconds(time)
        message.timestamp.CopyFrom(stamp(when))
        self._out.add("/nw/state", when, message)

    @_costs_only_the_log
    def calibration(
        self, time: float, camera: str, *, width: int, height: int, fovy: float
    ) -> None:
        """Write a camera's calibration: size in pixels, vertical field of view in rad."""
        when = nanoseconds(time)
        message = calibration_message(
            when, camera_frame(camera), width=width, height=height, fovy=fovy
        )
        self._out.add(f"/camera/{camera}/calib", when, message)

    @_costs_only_the_log
    def frame(self, time: float, camera: str, rgb: np.ndarray) -> None:
        """Write a frame that is there, (H, W, 3) uint8.

        It is compressed at once: a trial's raw frames may not fit the memory.
        """
        when = nanoseconds(time)
        message = image_message(when, camera_frame(camera), rgb)
        self._out.add_image(f"/camera/{camera}", when, lambda: message)

    @_costs_only_the_log
    def later_frame(self, time: float, camera: str, make: Callable[[], np.ndarray]) -> None:
        """Write the frame that `make` returns, (H, W, 3) uint8; it runs only if images are kept."""
        when = nanoseconds(time)
        self._out.add_image(
            f"/camera/{camera}", when, lambda: image_message(when, camera_frame(camera), make())
        )

    @_costs_only_the_log
    def waypoint(self, time: float, number: int, position: Sequence[float]) -> None:
        """Colour a waypoint as reached."""
        when = nanoseconds(time)
        entity = waypoint_entity(number, position, reached=True)
        entity.timestamp.CopyFrom(stamp(when))
        self._out.add("/scene", when, SceneUpdate(entities=[entity]))

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
    def finish(self, *, keep_images: bool, verdict: Mapping[str, str]) -> None:
        """Write what waited for the trial's end, and move the file into place."""
        self._out.settle(keep_images=keep_images)
        self._out.add_metadata("nw.verdict", dict(verdict))
        self.bytes = self._out.close()
        self._file = None


def camera_frame(camera: str) -> str:
    """Return the name of a camera's frame in `/tf`; its axes are OpenCV's."""
    return f"camera/{camera}"
