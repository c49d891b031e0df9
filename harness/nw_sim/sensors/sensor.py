"""What a sensor is, what it is asked about, and what it measures, noise and wrappers aside.

A `Measurement` is sampled in a `SceneView`; `Wrapper`s turn the sample into what the policy sees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.memory import Arrays, Forgetful, Memory, read_only
from nw_policies.cards import Action
from nw_scenes.rays import RayScene
from nw_scenes.scene import Nearness
from nw_sim.physics import World
from nw_sim.tasks import Task
from nw_splat.image import Image

if TYPE_CHECKING:
    from nw_splat.render import Renderer


Array = NDArray[np.float64]


@dataclass(kw_only=True)
class StepContext:
    """One instant of a trial: after a control step, after the task's update for it.

    The rollout makes one for each control step and shows it to every sensor; what nearly all of
    them need is computed once, at the start.
    """

    world: World
    task: Task
    step: int
    """Control steps done: 0 at the start of the trial."""
    applied_action: Action
    """(12,) the raw action of the last control step, in the policy's order; zeros first."""
    last_output: Action
    """(12,) what the policy returned last, before any delay; zeros first."""
    earlier_outputs: tuple[Action, ...] = ()
    """What it returned before that, (12,) each, the newest first; zeros where there is no more."""
    standing_cones: Array | None = None
    """(K, 3) waypoints that have a cone, m; None = all of the task's."""
    position: Array = field(init=False)
    """Trunk origin in the world, (3,) m."""
    roll_pitch_yaw: tuple[float, float, float] = field(init=False)
    """Euler angles of the trunk, rad; as `World.roll_pitch_yaw`, on plain numbers for speed."""
    shared: dict[str, Any] = field(default_factory=dict[str, Any], init=False)
    """What one sensor has worked out and another one can use, by a key of their own."""

    def __post_init__(self) -> None:
        self.position = read_only(self.world.trunk_position)
        w, x, y, z = self.world.trunk_quat.tolist()
        self.roll_pitch_yaw = (
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)),
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        )

    @property
    def cones(self) -> Array:
        """Where cones stand, (K, 3) m, world."""
        return self.task.goal.waypoints if self.standing_cones is None else self.standing_cones

    @property
    def rotation(self) -> Array:
        """R_world_trunk, (3, 3)."""
        return self.world.trunk_rotation

    @cached_property
    def delta_yaw(self) -> float:
        """Angle from the heading to the task's target, rad in [-pi, pi), positive to the left.

        0 where the task names no target.
        """
        target = self.task.target
        if target is None:
            return 0.0
        goal_x, goal_y, _ = target.tolist()
        x, y, _ = self.position.tolist()
        bearing = math.atan2(goal_y - y, goal_x - x)
        return (bearing - self.roll_pitch_yaw[2] + math.pi) % (2.0 * math.pi) - math.pi


class Sensor(Memory[bytes], Protocol):
    """One observation of a card in one trial.

    `read` is called once at every control step, from step 0 on. It computes a new sample only at
    the sensor's own rate and returns the last one between.
    """

    name: str
    """The observation's name on the card."""
    shape: tuple[int, ...]
    """Shape of what `read` returns."""
    dtype: np.dtype[Any]
    """Type of what `read` returns."""
    unit: str
    """What the numbers are, for logs: "m", "rgb", or "mixed"."""
    rate: float
    """Samples per second, Hz."""
    is_image: bool
    """Whether this is a rendered image, which costs far more than numbers do."""
    fresh: bool
    """Whether the last `read` returned another sample than the one before it."""

    @property
    def coverage(self) -> float | None:
        """Share of the newest camera image that the splat covers, 0..1; None without an image."""
        ...

    @property
    def nearness(self) -> Nearness | None:
        """How far the newest camera image was taken from the nearest capture camera of the scene.

        None without an image of the splat, or without such cameras.
        """
        ...

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        ...

    def read(self, moment: StepContext) -> NDArray[Any]:
        """Return the observation that the policy sees now. Do not change the array."""
        ...


FOG = 0.8
"""How bright fog is, of white."""


@dataclass(frozen=True, kw_only=True)
class Air:
    """What lies between a camera and the scene, and how long it is exposed.

    Attributes:
        exposure: factor of all colours.
        fog: share of the light that is lost per metre, as the exponent, 1/m.
    """

    exposure: float = 1.0
    fog: float = 0.0

    def seen(self, image: Image) -> Image:
        """Return an image, depth in m, as it is seen through this air."""
        rgb = image.rgb
        if self.fog:
            # Where nothing was drawn there is no end to the fog.
            metres = np.where(image.depth > 0.0, image.depth, np.float32(np.inf))
            clear = same_bits.exp(-np.float32(self.fog) * metres)[..., np.newaxis]
            rgb = rgb * clear + np.float32(FOG) * (np.float32(1.0) - clear)
        if self.exposure != 1.0:
            rgb = rgb * np.float32(self.exposure)
        return Image(rgb=rgb, depth=image.depth, alpha=image.alpha)


CLEAR = Air()
"""As the scene was captured."""


@dataclass(frozen=True, kw_only=True)
class SceneView:
    """The world of one trial, and what its sensors share.

    Attributes:
        world: the robot in its scene (`world.scene`).
        rays: gives the scene's static geometry for ray casting; made on the first call.
        renderer: gives the renderer of the scene's splat; made on the first call.
        air: through which cameras see it.
    """

    world: World
    rays: Callable[[], RayScene]
    renderer: Callable[[], Renderer]
    air: Air = CLEAR


Sample = NDArray[Any]


@dataclass(frozen=True)
class Spec:
    """Shape and type of a sample."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


@dataclass
class Shot:
    """What a wrapper may know beside the sample itself.

    Attributes:
        step: control steps done; 0 at the start of a trial.
        moment: world and task; None while shapes are worked out, before there is a world.
    """

    step: int
    moment: StepContext | None
    generator: Callable[[int], np.random.Generator]

    @property
    def time(self) -> float:
        """Seconds since the start of the trial."""
        return 0.0 if self.moment is None else self.moment.world.time

    @cached_property
    def rng(self) -> np.random.Generator:
        """Randomness of this sample alone: from the trial's seed, the wrapper's place and `step`.

        It depends on nothing that was drawn before, so a trial continued from its middle sees the
        same noise.
        """
        return self.generator(self.step)


class Wrapper(Memory[Arrays], Protocol):
    """A wrapper as the chain uses it; classes of plug-ins need `__call__` only."""

    def __call__(self, sample: Sample, shot: Shot) -> Sample:
        """Return the sample that comes out, in memory of its own or unchanged."""
        ...

    def reset(self, rng: np.random.Generator) -> None:
        """Begin a trial; `rng` is the same for all of it."""
        ...


class Plain(Forgetful):
    """A wrapper without memory."""

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to forget."""


class Measurement(Memory[Arrays], Protocol):
    """What is sampled; by default numbers that depend on the moment alone, seen as measured."""

    shape: tuple[int, ...]
    """Shape of a measurement."""
    dtype: np.dtype[Any]
    """Type of a measurement."""
    unit: str
    """As `Sensor.unit`."""
    is_image: bool = False
    """As `Sensor.is_image`."""
    coverage: float | None = None
    """As `Sensor.coverage`."""
    nearness: Nearness | None = None
    """As `Sensor.nearness`."""
    nothing: float = 0.0
    """What a number reads where there is nothing, and where noise loses it."""
    form: Sequence[Wrapper] = ()
    """What brings a measurement, behind its noise, into the form that the card asks for."""
    sum_of: str = ""
    """What its size is the sum or the product of: `3 + 3 + 12`; empty if that says nothing."""

    def attach(self, place: SceneView) -> None:
        """Take what it needs of the scene; called once, before `reset`."""

    def reset(self) -> None:
        """Forget earlier measurements."""

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Return a new measurement, which will not be changed."""
        ...

    def state(self) -> Arrays:
        """Return what the next measurements depend on beside the moment."""
        return {}

    def restore(self, state: Arrays) -> None:
        """Go back to a `state`."""
