"""Films a trial while it runs, in real time: from outside, and through the policy's own eyes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cards.model import CONTROL_RATE
from nw_eval.errors import NwEvalError, StoreError
from nw_eval.plural import plural
from nw_eval.rollout.episode import Observer
from nw_eval.rollout.fault import is_interrupt, one_line
from nw_eval.rollout.pictures.third_person import Spectator
from nw_eval.rollout.replaying.film.encoder import VideoFile
from nw_eval.rollout.replaying.film.frame import FRAME, VIEW, Words, composed
from nw_eval.rollout.replaying.film.own_view import OwnView

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from nw_eval.rollout.episode import Decision
    from nw_eval.rollout.prepare import OpenTrial
    from nw_eval.rollout.result import TrialResult

RATE = 25
"""Pictures a second."""

_PERIOD = CONTROL_RATE // RATE  # control steps between two of them
_NEWS = 1.0  # s for which it is said who has taken over
_HOLD = 1.5  # s for which the last picture stands


class Film(Observer):
    """The film of one trial. It changes no bit of it, and its own failure is none of the trial's.

    Call order: `begun`, then an episode runs with it as an observer, then `end`.

    Args:
        path: of the file, an MP4.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._error: BaseException | None = None
        self._driver, self._taken_over_at = "", float("inf")

    def begun(self, trial: OpenTrial, *, driver: str) -> Film:
        """Begin with a trial that stands where it is to be filmed from.

        Args:
            trial: of the policy whose view is shown.
            driver: who acts.

        Raises:
            PrerequisiteError: PyAV is not installed.
        """
        self._driver = driver
        self._episode = trial.episode
        self._video = VideoFile(self._path, size=FRAME, rate=RATE)
        self._spectator = Spectator(
            trial.scene, None if trial.scene.splat is None else trial.renderer()
        )
        self._own = OwnView(trial, self._spectator)
        return self

    def hand_over(self, driver: str) -> None:
        """From here on somebody else acts."""
        self._driver, self._taken_over_at = driver, self._episode.world.time

    def decided(self, decision: Decision) -> None:
        """Take a picture, if it is time for one."""
        if self._error is None:
            self._guarded(lambda: self._see(decision))

    def end(self, result: TrialResult) -> None:
        """Take the last picture, say how the trial ended, and close the file.

        Raises:
            StoreError: a picture could not be taken, or the file not be written.
        """
        if self._error is None:
            self._guarded(lambda: self._last(result))
        self._guarded(self._video.close)
        if isinstance(self._error, NwEvalError):
            raise self._error
        if self._error is not None:
            raise StoreError(
                f"the video could not be made: {one_line(self._error)}",
                fix="free space, or leave --video out",
            ) from self._error

    def _guarded(self, act: Callable[[], None]) -> None:
        """Act; what fails is kept for the end, for it is no failure of the policy."""
        try:
            act()
        except BaseException as error:
            if is_interrupt(error):
                raise
            self._error = self._error or error

    def _see(self, decision: Decision) -> None:
        self._own.see(decision.observation)
        if self._episode.step % _PERIOD == 0:
            since = self._episode.world.time - self._taken_over_at
            news = f"{self._driver} takes over" if 0.0 <= since < _NEWS else ""
            self._take(news, pictures=1)

    def _last(self, result: TrialResult) -> None:
        how = result.outcome or result.error_type or ""
        self._take(
            f"{how} ({result.end_reason})" if result.end_reason else how,
            pictures=1 + round(_HOLD * RATE),
        )

    def _take(self, news: str, *, pictures: int) -> None:
        episode = self._episode
        progress = episode.progress
        width, height = VIEW
        beside = self._spectator.beside(
            episode.world, progress.waypoints, width=width, height=height
        )
        words = Words(
            time=episode.world.time,
            waypoints=f"{progress.reached} of {plural(progress.total, 'waypoint')}",
            driver=self._driver,
            has_taken_over=episode.world.time >= self._taken_over_at,
            own=self._own.name,
            news=news,
        )
        picture = composed(beside, self._own.picture(), words)
        for _ in range(pictures):
            self._video.add(picture)
