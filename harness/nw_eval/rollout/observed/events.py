"""What happens to a robot on its way, as events of its log: waypoints, contacts, lost coverage."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.rollout.episode import Episode
    from nw_eval.rollout.mcap.trial_log import EventKind, TrialLog

# A camera image that the splat covers less than this is an event in the log.
LOW_COVERAGE = 0.9


class Events:
    """Writes an event when something begins, not again while it lasts.

    Args:
        episode: that is watched.
        log: where events are written.
    """

    def __init__(self, episode: Episode, log: TrialLog) -> None:
        self._episode = episode
        self._log = log
        self._cameras = [each for each in episode.sensors.values() if each.is_image]
        self._touching = False
        self._covered = True

    def is_due(self, *, credited: bool) -> bool:
        """Whether `notice` might find anything: it is cheaper to ask."""
        touches = self._episode.world.monitored_force() > 0.0
        return credited or touches != self._touching or bool(self._cameras)

    def notice(self, *, credited: bool) -> bool:
        """Write what began in the step that was just made.

        Args:
            credited: whether a waypoint was.

        Returns:
            Whether it is worth a restartable state: a waypoint, or a contact.
        """
        episode = self._episode
        progress = episode.progress
        if credited:
            number = progress.reached - 1
            self._log.waypoints(episode.world.time, reached=progress.reached)
            self.write("waypoint", f"waypoint {number + 1} of {progress.total}", number=number)
        force = episode.world.monitored_force()
        touches = force > 0.0 and not self._touching
        if touches:
            forces = episode.world.monitored_forces()
            geom = max(forces, key=forces.__getitem__)
            self.write("contact", f"{geom} touches with {force:.1f} N", value=force)
        self._touching = force > 0.0
        self._notice_coverage()
        return credited or touches

    def write(self, kind: EventKind, text: str, *, number: int = -1, value: float = 0.0) -> None:
        """Write an event of now."""
        episode = self._episode
        self._log.event(
            episode.world.time, kind, text, step=episode.step, waypoint=number, value=value
        )

    def _notice_coverage(self) -> None:
        if not self._cameras:
            return
        shares = [camera.coverage for camera in self._cameras if camera.coverage is not None]
        share = min(shares, default=1.0)
        covered = share >= LOW_COVERAGE
        if self._covered and not covered:
            self.write("coverage", f"the splat covers {share:.0%} of the image", value=share)
        self._covered = covered
