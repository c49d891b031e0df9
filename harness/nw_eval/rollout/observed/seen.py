"""Writes down what the policy was given: numbers as they are, and images as pictures.

Each observation is written when it is new: at its own rate, after its latency, behind noise and
wrappers. What is held between two samples is not repeated.
"""

from __future__ import annotations

from math import prod
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from nw_eval.rollout.mcap.content.seen import SeenRow, SeenRows
from nw_eval.rollout.observed.names import action_names, element_names, term_sizes
from nw_eval.rollout.observed.views import View, topic_names, views_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_eval.cards import Card
    from nw_eval.rollout.mcap.trial_log import TrialLog
    from nw_eval.sensors.sensor import Sensor
    from nw_eval.sim import World

_IS_NEW = attrgetter("fresh")  # of a sensor

MANY = 4096
"""More numbers than this, as a laser scanner gives, are kept where images are."""


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
        rows = {
            name: SeenRow(
                topic=f"/observation/{self._names[name]}",
                shape=sensors[name].shape,
                terms=term_sizes(name, spec, sizes[name]),
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
        found = action_names(self._card, robot)
        for name, spec in self._card.observations.items():
            if name in self._views:
                continue
            names = element_names(spec, found["/nw/policy.action"])
            if len(names) == prod(self._sensors[name].shape):
                found[f"/observation/{self._names[name]}"] = names
        return {topic: ",".join(names) for topic, names in found.items()}

    def calibrate(self) -> None:
        """Write the calibration of every camera, if its pictures can be kept."""
        for view in self.views:
            pinhole = view.pinhole(self._world.robot.cameras[view.mount])
            if pinhole is not None and self._log.takes_images:
                self._log.calibration(
                    self._world.time,
                    view.topic,
                    mount=view.mount,
                    size=(pinhole.width, pinhole.height),
                    focal=(pinhole.fx, pinhole.fy),
                    center=(pinhole.cx, pinhole.cy),
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
