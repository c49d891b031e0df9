"""What the policy of a trial sees, as a picture; for a blind one, what it would see."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.observed.views import views_of
from nw_eval.sensors.drawing.pictures import picture_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_eval.rollout.pictures.third_person import Spectator
    from nw_eval.rollout.prepare import OpenTrial

Bytes = NDArray[np.uint8]

_EGO = "ego"
_BLIND = (320, 180)  # pixels of a picture that no policy sees
_PERIOD = 5  # control steps between two of these: 10 Hz, as cameras of policies have


class OwnView:
    """The policy's own view in one trial.

    Args:
        trial: whose policy it is.
        spectator: draws what a blind policy's robot has before it.
    """

    def __init__(self, trial: OpenTrial, spectator: Spectator) -> None:
        self._episode = trial.episode
        self._spectator = spectator
        sensors = trial.episode.sensors
        views = [v for v in views_of(trial.bundle.card) if len(sensors[v.observation].shape) > 1]
        self._view = views[0] if views else None
        self._shown: Bytes = np.zeros((*_BLIND[::-1], 3), dtype=np.uint8)
        self._drawn_at = -_PERIOD
        self.name = (
            "the robot's camera; the policy has none"
            if self._view is None
            else f"what {trial.bundle.name} sees: {self._view.observation}"
        )

    def see(self, observation: Mapping[str, NDArray[Any]]) -> None:
        """Take what the policy sees at this control step; empty where it sees nothing."""
        if self._view is None or self._view.observation not in observation:
            return
        for form, image in self._view.pictures(observation[self._view.observation])[:1]:
            drawn = picture_of(image, "class" if form == "classes" else "")
            self._shown = self._shown if drawn is None else drawn

    def picture(self) -> Bytes:
        """Return the newest picture, (H, W, 3) of any size."""
        episode = self._episode
        if self._view is None and episode.step - self._drawn_at >= _PERIOD:
            width, height = _BLIND
            self._drawn_at = episode.step
            self._shown = self._spectator.aboard(
                episode.world, episode.progress.waypoints, _EGO, width=width, height=height
            )
        return self._shown
