"""Writes down what the policy was given: numbers as they are, and images as pictures.

Each observation is written when it is new: at its own rate, after its latency, behind noise and
wrappers. What is held between two samples is not repeated.

Numbers have names one by one, `joint_pos FR_hip`, `ang_vel x t-2`: a log says them once, so that a
plot can say which joint a line is, whatever order a card has.

A camera's image is shown as what the policy was given. Axes, stacks and types are the checkpoint's
affair; a picture for people has rows, columns and colours. Of a stack the newest image is shown:
the others were, when they were new.

Where the policy sees no pictures, the log has a camera of its own, `LogCamera`, for people. It
never touches the result, and in a run that keeps images of failures only it renders after the
trial, if the trial failed.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from math import prod
from operator import attrgetter
from typing import TYPE_CHECKING, Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.lens import Intrinsics
from nw_policies.cards import terms, wrappers
from nw_policies.cards.joints import all_joints, short_name
from nw_policies.cards.observations import (
    CameraObservation,
    DepthObservation,
    ProprioObservation,
    SemanticsObservation,
    SplatRgbObservation,
    selected_indices,
)
from nw_policies.cards.terms import AnyTerm, term_size

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from nw_policies.cards import Card
    from nw_scenes import Scene
    from nw_scenes.rays import RayScene
    from nw_scenes.robots import CameraMount, RobotSpec
    from nw_sim.physics import World
    from nw_sim.rollout.job import StageClock
    from nw_sim.rollout.mcap.images import PixelForm
    from nw_sim.rollout.mcap.trial_log import TrialLog
    from nw_sim.sensors.drawing.props import PropPictures
    from nw_sim.sensors.sensor import Sensor
    from nw_splat.camera import Camera
    from nw_splat.render import Renderer

_IS_NEW = attrgetter("fresh")  # of a sensor

MANY = 4096
"""More numbers than this, as a laser scanner gives, are kept where images are."""
Image = NDArray[Any]

_COLOURS = 3
_PLAIN = re.compile(r"[\w.-]{1,100}")
# After these a pixel's unit still is what it was.
_FAITHFUL = (
    wrappers.NoiseWrap
    | wrappers.Crop
    | wrappers.Resize
    | wrappers.Clip
    | wrappers.Quantize
    | wrappers.Stack
    | wrappers.Channels
)
Names = tuple[str, ...]

_AXES = ("x", "y", "z")
_PARTS = {
    "ang_vel": _AXES,
    "lin_vel": _AXES,
    "gravity": _AXES,
    "acceleration": _AXES,
    "imu": ("roll", "pitch", "zero"),
    "roll_pitch": ("roll", "pitch"),
    "command": ("forward", "left", "yaw_rate"),
}
# After these each number still stands in its place.
_IN_PLACE = (
    wrappers.NoiseWrap | wrappers.Normalize | wrappers.Scale | wrappers.Clip | wrappers.Quantize
)
Bytes = NDArray[np.uint8]

LOG_CAMERA = "ego"
_LOG_SIZE = (160, 90)  # pixels
_LOG_RATE = 10  # frames a second
LOG_TOPIC = f"/camera/{LOG_CAMERA}"


class Seen:
    """What one trial's policy is given.

    Args:
        card: whose observations they are.
        sensors: the trial's, by name.
        world: carries the cameras.
        log: where it is written.

    Attributes:
        rows: the observations that are rows of numbers.
        shows_pictures: whether there is anything for `record_images`.
    """

    def __init__(
        self, *, card: Card, sensors: Mapping[str, Sensor], world: World, log: TrialLog
    ) -> None:
        # Whoever only asks for names or views needs no protobuf.
        from nw_sim.rollout.mcap.images import SeenRow, SeenRows

        self._card = card
        self._sensors = sensors
        self._world = world
        self._log = log
        # An image that was flattened is a row of numbers.
        self._views = {
            view.observation: view
            for view in views_of(card)
            if len(sensors[view.observation].shape) > 1
        }
        self._names = topic_names(card)
        sizes = {name: prod(sensors[name].shape) for name in card.observations}
        self._images = [n for n in sizes if n in self._views or sizes[n] > MANY]
        joints = all_joints(card.control.joints, card.control.held, world.robot.joints)
        rows = {
            name: SeenRow(
                topic=f"/observation/{self._names[name]}",
                shape=sensors[name].shape,
                terms=term_sizes(name, spec, sizes[name], joints),
            )
            for name, spec in card.observations.items()
            if name not in self._images
        }
        self.shows_pictures = bool(self._images)
        self.rows = SeenRows(rows, is_all=not self._images)
        self._sensors_of_rows = [sensors[name] for name in rows]

    @property
    def views(self) -> tuple[View, ...]:
        """The observations that are pictures."""
        return tuple(self._views.values())

    def elements(self) -> dict[str, str]:
        """Return what the numbers of a log are called, by topic, or topic and field."""
        robot = self._world.robot
        by_topic = action_names(self._card, robot)
        for name, spec in self._card.observations.items():
            if name in self._views:
                continue
            names = element_names(spec, by_topic["/nw/policy.action"])
            if len(names) == prod(self._sensors[name].shape):
                by_topic[f"/observation/{self._names[name]}"] = names
        return {topic: ",".join(names) for topic, names in by_topic.items()}

    def shutters(self) -> dict[str, str]:
        """Return how long those cameras of the views take that take time, by name, as JSON."""
        cameras = self._world.robot.cameras
        mounts = {view.mount: cameras[view.mount] for view in self.views}
        return {
            name: json.dumps({"readout": mount.readout, "exposure": mount.exposure})
            for name, mount in mounts.items()
            if mount.readout or mount.exposure
        }

    def calibrate(self) -> None:
        """Write the calibration of every camera, if its pictures can be kept."""
        for view in self.views:
            lens = view.lens(self._world.robot.cameras[view.mount])
            if lens is not None and self._log.takes_images:
                self._log.calibration(
                    self._world.time,
                    view.topic,
                    mount=view.mount,
                    lens=lens,
                )

    @property
    def new(self) -> tuple[bool, ...]:
        """Which of `rows` are new in the observation of now."""
        return tuple(map(_IS_NEW, self._sensors_of_rows))

    def record_images(self, observation: Mapping[str, NDArray[Any]]) -> None:
        """Write what is new of a control step's pictures, and of rows as large as those."""
        for name in self._images:
            if name not in observation or not self._sensors[name].fresh:
                continue
            if name in self._views:
                self._pictures(self._views[name], observation[name])
            else:
                topic = self._names[name]
                self._log.many_numbers(self._world.time, topic, observation[name])

    def _pictures(self, view: View, array: NDArray[Any]) -> None:
        if not self._log.takes_images:
            return
        pictures = view.pictures(array)
        for number, (form, image) in enumerate(pictures):
            topic = view.topic if len(pictures) == 1 else f"{view.topic}/{number}"
            self._log.picture(self._world.time, topic, image, mount=view.mount, form=form)


@dataclass(frozen=True, kw_only=True)
class View:
    """One observation of a camera, as the log shows it.

    Attributes:
        observation: its name on the card.
        topic: the log's name for it.
        mount: the robot's camera.
        spec: what the card says.
    """

    observation: str
    topic: str
    mount: str
    spec: CameraObservation

    def pictures(self, array: Image) -> list[tuple[PixelForm, Image]]:
        """Return the newest sample of an observation: (H, W) or (H, W, 3) images, one or more.

        A wrapper of somebody else's may make several images of one; each is shown. Nothing is, if
        no axes are left that could be rows and columns.
        """
        if array.ndim < 2:
            return []
        planes = self._planes(array)
        step = _COLOURS if self._in_colour and planes.shape[-1] % _COLOURS == 0 else 1
        count = planes.shape[-1] // step
        images = [planes[..., k * step : (k + 1) * step] for k in range(count)]
        newest = images[-max(1, count // self._frames) :]
        return [self._form(image[..., 0] if step == 1 else image) for image in newest]

    def lens(self, mount: CameraMount) -> Intrinsics | None:
        """Return the calibration of the pictures; None after a wrapper that may bend images."""
        if any(
            isinstance(wrapper, wrappers.Flatten | wrappers.PluginWrap)
            for wrapper in self.spec.wrap
        ):
            return None
        return self._traced(mount.lens(self.spec.width, self.spec.height))

    @cached_property
    def _size(self) -> tuple[int, int]:
        """Rows and columns behind the wrappers, as far as those are ours."""
        seen = self._traced(Intrinsics.from_fovy(self.spec.width, self.spec.height, 1.0))
        return seen.height, seen.width

    def _traced(self, seen: Intrinsics) -> Intrinsics:
        """Return the lens behind all crops and changes of size."""
        for wrapper in self.spec.wrap:
            match wrapper:
                case wrappers.Crop():
                    seen = seen.cropped(
                        left=wrapper.left,
                        top=wrapper.top,
                        right=wrapper.right,
                        bottom=wrapper.bottom,
                    )
                case wrappers.Resize():
                    seen = seen.resized(wrapper.width, wrapper.height)
                case (
                    wrappers.NoiseWrap()
                    | wrappers.Normalize()
                    | wrappers.Scale()
                    | wrappers.Clip()
                    | wrappers.Grayscale()
                    | wrappers.Quantize()
                    | wrappers.Stack()
                    | wrappers.Channels()
                    | wrappers.Flatten()
                    | wrappers.PluginWrap()
                ):
                    pass
                case _:
                    assert_never(wrapper)
        return seen

    @cached_property
    def _in_colour(self) -> bool:
        if any(isinstance(wrapper, wrappers.Grayscale) for wrapper in self.spec.wrap):
            return False
        spec = self.spec
        if isinstance(spec, SemanticsObservation):
            return spec.values == "colors"
        return isinstance(spec, SplatRgbObservation)

    @cached_property
    def _frames(self) -> int:
        """How many samples an observation holds."""
        stacks = [
            wrapper.steps for wrapper in self.spec.wrap if isinstance(wrapper, wrappers.Stack)
        ]
        own = self.spec.stack if isinstance(self.spec, SplatRgbObservation) else 1
        return own * prod(stacks)

    def _planes(self, array: Image) -> Image:
        """Return (H, W, all else), oldest sample first and colours together."""
        pairs = list(pairwise(array.shape))
        # Of an image of unknown size, rows and columns are the two that make most pixels.
        rows = pairs.index(self._size if self._size in pairs else max(pairs, key=prod))
        array = np.moveaxis(array, (rows, rows + 1), (0, 1))
        stacks = [wrapper.axis for wrapper in self.spec.wrap if isinstance(wrapper, wrappers.Stack)]
        if self._in_colour and stacks[-1:] == ["last"]:
            array = np.moveaxis(array, -1, 2)  # The colours stood before the samples.
        return array.reshape(*array.shape[:2], -1)

    def _form(self, image: Image) -> tuple[PixelForm, Image]:
        spec = self.spec
        if image.ndim == _COLOURS:
            is_drawn = isinstance(spec, SemanticsObservation) and _is_bytes(image)
            return ("drawing", image) if is_drawn else ("photo", self._bytes(image))
        if isinstance(spec, SemanticsObservation) and spec.values == "ids" and _is_bytes(image):
            return "classes", image
        is_metric = isinstance(spec, DepthObservation) and spec.mode == "metres"
        if is_metric and all(isinstance(wrapper, _FAITHFUL) for wrapper in spec.wrap):
            return "metres", image
        return ("grey", image) if _is_bytes(image) else ("numbers", image)

    def _bytes(self, image: Image) -> NDArray[np.uint8]:
        """Return colours as bytes: exactly where the card says how they became numbers."""
        spec = self.spec
        if _is_bytes(image):
            return image
        if isinstance(spec, SplatRgbObservation) and spec.dtype == "float32" and not spec.wrap:
            image = image * spec.std + spec.mean
        else:  # From the darkest to the brightest.
            low, high = float(np.nanmin(image)), float(np.nanmax(image))
            image = (image - low) * (255.0 / max(high - low, 1e-12))
        return np.clip(np.rint(np.nan_to_num(image)), 0.0, 255.0).astype(np.uint8)


def topic_names(card: Card) -> dict[str, str]:
    """Return what stands for each observation in topics: its name, if that is a plain word.

    A card may be untrusted, and `calib` is taken by calibrations.
    """
    return {
        name: name if _PLAIN.fullmatch(name) and name != "calib" else f"~{number}"
        for number, name in enumerate(card.observations)
    }


def views_of(card: Card) -> tuple[View, ...]:
    """Return the views of a card's cameras, in its order.

    The first photograph from a camera is `/camera/<camera>`, every other image
    `/camera/<camera>/<observation>`.
    """
    views: list[View] = []
    names = topic_names(card)
    for name, spec in card.observations.items():
        if not isinstance(spec, CameraObservation):
            continue
        topic = f"/camera/{spec.camera}"
        is_first = isinstance(spec, SplatRgbObservation) and topic not in {v.topic for v in views}
        views.append(
            View(
                observation=name,
                topic=topic if is_first else f"{topic}/{names[name]}",
                mount=spec.camera,
                spec=spec,
            )
        )
    return tuple(views)


def _is_bytes(image: Image) -> bool:
    return image.dtype == np.uint8


def action_names(card: Card, robot: RobotSpec) -> dict[str, Names]:
    """Return the names of what `/nw/policy` holds, by topic and field."""
    own = tuple(map(short_name, all_joints(card.control.joints, card.control.held, robot.joints)))
    motors = tuple(map(short_name, robot.joints))
    return {
        "/nw/policy.action": own,
        "/nw/policy.applied": own,
        "/nw/policy.targets": motors,
    }


def element_names(spec: object, joints: Sequence[str]) -> Names:
    """Return a name for each number of an observation; empty where its numbers have none.

    Args:
        spec: what the card says of it.
        joints: in the policy's order.
    """
    if not isinstance(spec, ProprioObservation):
        return ()
    if not all(isinstance(wrapper, _IN_PLACE) for wrapper in spec.wrap):
        return ()
    groups = [_of_term(term, tuple(map(short_name, joints))) for term in spec.frame_terms]
    frame = [name for group in groups for name in group]
    if spec.select is not None:
        frame = [frame[index] for index in selected_indices(spec.select, len(frame))]
    history = spec.history
    if history is None:
        return tuple(frame)
    last = 0 if history.current else 1
    ages = list(range(last, last + history.steps))
    if history.order == "oldest_first":
        ages.reverse()
    if history.by == "step":
        return tuple(_aged(name, age) for age in ages for name in frame)
    return tuple(_aged(name, age) for group in groups for age in ages for name in group)


def term_sizes(
    name: str, spec: object, size: int, joints: Sequence[str]
) -> tuple[tuple[str, int], ...]:
    """Return name and size of the parts of a row: the card's terms, where they are all of it."""
    if isinstance(spec, ProprioObservation):
        sizes = tuple((term.term, term_size(term, joints)) for term in spec.frame_terms)
        is_whole = spec.select is None and spec.history is None and not spec.wrap
        if is_whole and sum(count for _, count in sizes) == size:
            return sizes
    return ((name, size),)


def value_paths(sizes: Sequence[tuple[str, int]]) -> list[str]:
    """Return where each number of an observation of such parts lies in its `nw.Observation`."""
    bounds = pairwise(accumulate((size for _, size in sizes), initial=0))
    return [
        f"terms[{part}].values[{index}]"
        for part, (first, end) in enumerate(bounds)
        for index in range(end - first)
    ]


def _aged(name: str, age: int) -> str:
    return f"{name} t-{age}" if age else name


def _of_term(term: AnyTerm, joints: Names) -> list[str]:
    parts = _parts(term, joints)
    return [f"{term.term} {part}" if part else term.term for part in parts]


def _parts(term: AnyTerm, joints: Names) -> Sequence[str]:
    match term:
        case (
            terms.JointPosition()
            | terms.JointVelocity()
            | terms.AppliedAction()
            | terms.LastOutput()
        ):
            return [joints[index] for index in terms.seen_joints(term, joints)]
        case terms.FootContacts():
            return term.feet
        case terms.GaitClock():
            return [f"{kind} {foot}" for kind in term.values for foot in range(len(term.offsets))]
        case terms.Yaw():
            return ("",) if term.values == "angle" else ("sine", "cosine")
        case terms.Orientation():
            return tuple(term.order)
        case terms.Target():
            return tuple(map(short_name, term.of))
        case terms.Command() if term.parts is not None:
            whole = dict(zip(("vx", "vy", "yaw"), _PARTS[term.term], strict=True))
            return [whole[part] for part in term.parts]
        case terms.Speed() | terms.Moving() | terms.DeltaYaw() | terms.Constant():
            size = term_size(term, joints)
            return ("",) if size == 1 else [str(number) for number in range(size)]
        case _:
            return _PARTS[term.term]


class LogCamera:
    """The camera of one trial's log.

    Args:
        needed: whether no other code makes pictures.
        world: carries the camera.
        scene: what it sees.
        renderer: makes the renderer of the scene's splat; called only if a frame is rendered.
        log: where the frames go.
        clock: rendering for the log counts as `render`.
    """

    def __init__(
        self,
        *,
        needed: bool,
        world: World,
        scene: Scene,
        renderer: Callable[[], Renderer],
        log: TrialLog,
        clock: StageClock,
    ) -> None:
        self._world = world
        self._scene = scene
        self._renderer = renderer
        self._log = log
        self._clock = clock
        can_see = scene.splat is not None and LOG_CAMERA in world.robot.cameras
        self.is_on = needed and can_see and log.takes_images

    def calibrate(self) -> None:
        """Write the camera's calibration."""
        if self.is_on:
            self._log.calibration(self._world.time, LOG_TOPIC, mount=LOG_CAMERA, lens=self._lens)

    def record(self, step: int) -> None:
        """Write the frame of a control step, if it has one."""
        if self.is_on and step % max(1, round(self._world.control_rate / _LOG_RATE)) == 0:
            T_world_camera = self._world.camera_pose(LOG_CAMERA)
            poses = self._world.prop_poses()
            self._log.later_picture(
                self._world.time,
                LOG_TOPIC,
                lambda: self._render(T_world_camera, poses),
                mount=LOG_CAMERA,
            )

    @property
    def _lens(self) -> Intrinsics:
        return self._world.robot.cameras[LOG_CAMERA].lens(*_LOG_SIZE)

    def _camera(self, T: NDArray[np.float64]) -> Camera:
        from nw_splat.camera import Camera

        return Camera.of(self._lens, T)

    @cached_property
    def _rays(self) -> RayScene:
        from nw_scenes.rays import RayScene

        return RayScene(self._scene.mesh())

    @cached_property
    def _props(self) -> PropPictures:
        from nw_sim.sensors.drawing.props import PropPictures

        return PropPictures(self._scene)

    def _render(
        self, T_world_camera: NDArray[np.float64], poses: Sequence[NDArray[np.float64]]
    ) -> Bytes:
        camera = self._camera(same_bits.inverse(self._scene.T_world_splat) @ T_world_camera)
        try:
            with self._clock("render"):
                image = self._renderer().render(camera)
                if poses:
                    from nw_sim.sensors.drawing.overlay import ray_directions
                    from nw_splat.camera import Pixels

                    image = self._props.into(
                        image,
                        poses,
                        self._camera,
                        directions=ray_directions(camera, Pixels()),
                        T_world_camera=T_world_camera,
                        static=self._rays,
                    )
                return image.bytes()
        except Exception as error:
            # The policy never sees these frames, so whatever fails here costs the log alone.
            raise OSError(f"its camera failed: {error}") from error
