"""A clock, a policy and a world that do as they are told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.trials import Trial
from nw_policies import Bundle
from nw_policies.bundle import instance_bundle
from nw_policies.cards import Card, mounted_robot
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.perturbed import TrialSetup
from nw_sim.sensors import StepContext
from nw_sim.tasks import Course

Array = NDArray[np.float64]


class FakeClock:
    """Seconds that pass when they are told to.

    Args:
        tick: seconds by which each look moves it on.
    """

    def __init__(self, tick: float = 0.0) -> None:
        self.seconds = 0.0
        self.tick = tick

    def __call__(self) -> float:
        """Return the seconds so far, and move on by a tick."""
        seconds = self.seconds
        self.seconds += self.tick
        return seconds

    def advance(self, seconds: float) -> None:
        """Let seconds pass."""
        self.seconds += seconds


class FakePolicy:
    """A policy that answers by the number of its step, and remembers what it saw.

    Args:
        acts: gets the number of the step, from 0, and returns the action, (joints,); or raises.
            Zeros for all joints if None.
        fails: what `reset`, `state`, `restore` and `close` raise, by name; an exception, or a
            function that raises or returns nothing.
        joints: of the robot.

    Attributes:
        seen: the observations of the trial so far.
        seeds: with which it was reset.
    """

    def __init__(
        self,
        acts: Callable[[int], Any] | None = None,
        *,
        fails: Mapping[str, BaseException | Callable[[], None]] | None = None,
        joints: int = 12,
    ) -> None:
        self._acts = acts or (lambda _: np.zeros(joints))
        self._fails = dict(fails or {})
        self.seen: list[Mapping[str, NDArray[Any]]] = []
        self.seeds: list[int] = []

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._fail("reset")
        self.seeds.append(seed)
        self.seen = []

    def act(self, observation: Mapping[str, NDArray[Any]]) -> Any:
        """Return the action of this step."""
        self.seen.append(observation)
        return self._acts(len(self.seen) - 1)

    def state(self) -> bytes:
        """Return nothing: what it answers follows from the step."""
        self._fail("state")
        return b""

    def restore(self, state: bytes) -> None:  # noqa: ARG002
        """Go back to nothing."""
        self._fail("restore")

    def close(self) -> None:
        """End."""
        self._fail("close")

    def bundle(self, card: Card | None = None) -> Bundle:
        """Return its bundle, for `Library(known=[...])` (default: its card is `fake_card()`)."""
        return instance_bundle(self, card or fake_card(), digest="fake")

    def _fail(self, method: str) -> None:
        error = self._fails.get(method)
        if isinstance(error, BaseException):
            raise error
        if error is not None:
            error()


class GlidingWorld(World):
    """A world whose robot glides in its default pose at a constant velocity, without physics.

    Readings are those of `World` in that pose: positions, contacts, rays, and the velocity.

    Args:
        arguments: of `World`.
        velocity: (3,) of the trunk, world frame, m/s.
        raises: what `step` raises, by the number of control steps that are done.
        options: of `World`.
    """

    def __init__(
        self,
        *arguments: Any,
        velocity: Sequence[float] = (0.8, 0.0, 0.0),
        raises: Mapping[int, BaseException] | None = None,
        **options: Any,
    ) -> None:
        self._velocity = np.asarray(velocity, dtype=np.float64)
        self._raises = dict(raises or {})
        super().__init__(*arguments, **options)

    def step(self, targets: Sequence[float] | Array) -> None:  # noqa: ARG002
        """Glide on by one control step, whatever the targets.

        Raises:
            BaseException: that which is to be raised now.
        """
        done = self.steps
        if done in self._raises:
            raise self._raises[done]
        place = self.trunk_position + self._velocity * self.control_period
        self.reset(position=place, yaw=self.start_yaw)
        self._data.qvel[self._linear] = self._velocity
        self.push((0.0, 0.0))  # What follows from the velocity is derived.
        self.steps = done + 1


def gliding_world(
    scene: str = "flat/carpet_room", *, robot: str = "go1", velocity: Sequence[float] = (0.8, 0, 0)
) -> GlidingWorld:
    """Return a world whose robot glides from the start of a scene.

    Args:
        scene: a built-in scene's name, or a folder.
        robot: its name.
        velocity: (3,) m/s, world frame.

    Raises:
        SceneError, UsageError: there is no such scene or robot.
    """
    return GlidingWorld(get_robot(robot), get_scene(scene), velocity=velocity)


def moment_of(world: World) -> StepContext:
    """Return what a sensor's `measure` gets, as a world stands; the actions so far are zeros."""
    nothing = np.zeros(len(world.robot.joints))
    return StepContext(
        world=world,
        task=Course.along(world.scene.trail),
        step=world.steps,
        applied_action=nothing,
        last_output=nothing,
    )


def fake_card(observations: Mapping[str, Any] | None = None, **fields: Any) -> Card:
    """Return the card of a policy of this process.

    Args:
        observations: as a card has them (default: the robot's joint positions).
        fields: other keys of the card.

    Raises:
        pydantic.ValidationError: they are none of a card.
    """
    body = {"body": {"sensor": "proprio", "terms": ["joint_pos"]}}
    settings = {
        "nw-policy": 1,
        "name": "fake",
        "robot": "go1",
        "adapter": "python:nw_eval.testing:FakePolicy",
        "control": {"action": "joint_position_offset", "scale": 0.25},
        "observations": dict(body if observations is None else observations),
    }
    return Card.model_validate(settings | fields)


def trial_setup(card: Card | None = None, *, seed: int = 1) -> TrialSetup:
    """Return the setup that `Axis.change` gets, of a trial that nothing has changed yet.

    Args:
        card: of the policy (default: `fake_card()`).
        seed: of the suite, from which the trial's random numbers follow.
    """
    card = card or fake_card()
    trial = Trial(
        suite="fake",
        suite_digest="0" * 64,
        suite_seed=seed,
        scene="flat/carpet_room",
        scene_digest="0" * 64,
        task="flat",
        index=0,
    )
    return TrialSetup.of(trial, mounted_robot(get_robot(card.robot), card), card)
