"""Pictures of a trial: its film while it runs, in real time, and sheets of a few moments.

A film shows it from outside, and through the policy's own eyes. Sheets show a trial at six moments,
and scenes from the robot's eye and from outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from importlib import import_module
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import NwEvalError, PrerequisiteError, StoreError, is_interrupt
from nw_base.files.cache import atomic_path, followed
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.rollout.episode import Observer
from nw_sim.rollout.fault import one_line
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.library import Library
from nw_sim.rollout.observed import views_of
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.replaying.third_person import Spectator, ghost_of
from nw_sim.sensors.drawing.pictures import Cell, draw_sheet, enlarged, picture_of
from nw_splat.render import open_renderer
from nw_splat.store import open_store

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from PIL import ImageDraw

    from nw_scenes import Scene
    from nw_sim.rollout.episode import Decision
    from nw_sim.rollout.job import TrialResult
    from nw_sim.rollout.opening import OpenTrial
    from nw_sim.rollout.replaying.logged import LoggedTrial


RATE = 25
"""Pictures a second."""

_NEWS = 1.0  # s for which it is said who has taken over
_HOLD = 1.5  # s for which the last picture stands
Bytes = NDArray[np.uint8]

VIEW = (400, 225)
"""Width and height of each of the two views, pixels."""
FRAME = (2 * VIEW[0], VIEW[1] + 67)
"""Of the whole picture; even, as video wants it."""

_BAND = 6  # pixels
_GROUND, _INK, _FAINT = (18, 22, 28), (240, 242, 245), (160, 168, 178)
_DRIVERS = ((74, 144, 226), (245, 140, 40))
"""The band's colours: of whoever began, of whoever took over."""
_LARGE, _SMALL, _LABEL = 18, 14, 12  # pixels, of letters
_EGO = "ego"
_BLIND = (320, 180)  # pixels of a picture that no policy sees
_LOG_RATE = 10  # of these a second, as cameras of policies have
# The first that FFmpeg has: H.264 plays everywhere, and some builds leave it out for its patents.
_CODECS: tuple[tuple[str, dict[str, str]], ...] = (
    ("libx264", {"crf": "20", "preset": "veryfast"}),
    ("libvpx-vp9", {"crf": "30", "b": "0", "deadline": "realtime"}),
    ("mpeg4", {"qscale": "3"}),
)


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
        self._video = _VideoFile(self._path, size=FRAME, rate=RATE)
        self._spectator = Spectator(
            trial.scene, None if trial.scene.splat is None else trial.shown()
        )
        self._own = _OwnView(trial, self._spectator)
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
                fix="free space, or drop --video",
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
        share = RATE / self._episode.world.control_rate
        step = self._episode.step
        if pictures := int(step * share + 1e-6) - math.floor((step - 1) * share + 1e-6):
            since = self._episode.world.time - self._taken_over_at
            news = f"{self._driver} takes over" if 0.0 <= since < _NEWS else ""
            self._take(news, pictures=pictures)

    def _last(self, result: TrialResult) -> None:
        how = result.outcome or result.error_type or ""
        self._take(
            f"{how} ({result.end_reason})" if result.end_reason else how,
            pictures=1 + round(_HOLD * RATE),
        )

    def _take(self, news: str, *, pictures: int) -> None:
        episode = self._episode
        width, height = VIEW
        beside = self._spectator.beside(
            episode.world,
            episode.task.goal.waypoints,
            width=width,
            height=height,
            ghost=ghost_of(episode.task, episode.step),
        )
        words = Words(
            time=episode.world.time,
            waypoints=episode.task.standing,
            driver=self._driver,
            has_taken_over=episode.world.time >= self._taken_over_at,
            own=self._own.name,
            news=news,
        )
        picture = composed(beside, self._own.picture(), words)
        for _ in range(pictures):
            self._video.add(picture)


@dataclass(frozen=True, kw_only=True)
class Words:
    """What stands under the views, and in them."""

    time: float
    """s"""
    waypoints: str
    """Such as `2 of 4 waypoints`."""
    driver: str
    """Who drives."""
    has_taken_over: bool
    own: str
    """What the policy's own view is."""
    news: str = ""
    """What has just happened, or how it ended; drawn across the picture's middle."""


def composed(beside: Bytes, own: Bytes, words: Words) -> Bytes:
    """Return one picture, (`FRAME` height, width, 3).

    Args:
        beside: the view from outside, (H, W, 3).
        own: the policy's own view, as above; both are fitted into `VIEW`.
        words: see there.
    """
    from PIL import Image, ImageDraw

    width, height = VIEW
    colour = _DRIVERS[words.has_taken_over]
    picture = Image.new("RGB", FRAME, _GROUND)
    picture.paste(Image.fromarray(enlarged(beside, VIEW)), (0, 0))
    picture.paste(Image.fromarray(enlarged(own, VIEW)), (width, 0))
    pen = ImageDraw.Draw(picture)
    _label(pen, (8, 6), "from outside")
    _label(pen, (width + 8, 6), words.own)
    pen.rectangle((0, height, FRAME[0], height + _BAND), fill=colour)
    y = height + _BAND + 8
    _write(pen, (12, y), f"{words.time:5.2f} s", _LARGE, _INK)
    _write(pen, (110, y), words.waypoints, _LARGE, _INK)
    _write(pen, (12, y + 27), f"driven by {words.driver}", _SMALL, colour)
    if words.news:
        _announce(pen, words.news, colour)
    return np.asarray(picture)


def _announce(pen: ImageDraw.ImageDraw, text: str, colour: tuple[int, int, int]) -> None:
    """Draw a frame round the views, and a line of words across their foot."""
    width, height = FRAME[0], VIEW[1]
    pen.rectangle((0, 0, width - 1, height - 1), outline=colour, width=_BAND)
    pen.rectangle((0, height - 34, width, height), fill=colour)
    _write(pen, (14, height - 29), text, _LARGE, _GROUND)


def _label(pen: ImageDraw.ImageDraw, at: tuple[int, int], text: str) -> None:
    from PIL import ImageFont

    box = pen.textbbox(at, text, font=ImageFont.load_default(size=_LABEL))
    pen.rectangle((box[0] - 4, box[1] - 3, box[2] + 4, box[3] + 3), fill=_GROUND)
    _write(pen, at, text, _LABEL, _FAINT)


def _write(
    pen: ImageDraw.ImageDraw,
    at: tuple[int, int],
    text: str,
    size: int,
    colour: tuple[int, int, int],
) -> None:
    from PIL import ImageFont

    words = clean(text, at_most=140)  # Names of policies may be untrusted.
    pen.text(at, words, fill=colour, font=ImageFont.load_default(size=size))


class _OwnView:
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
        self._period = max(1, round(self._episode.world.control_rate / _LOG_RATE))
        self._drawn_at = -self._period
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
        if self._view is None and episode.step - self._drawn_at >= self._period:
            width, height = _BLIND
            self._drawn_at = episode.step
            self._shown = self._spectator.aboard(
                episode.world, episode.task.goal.waypoints, _EGO, width=width, height=height
            )
        return self._shown


def video_library() -> Any:
    """Return the package `av`.

    Raises:
        PrerequisiteError: it is missing, or does not start.
    """
    try:
        return import_module("av")
    except ImportError as error:
        raise PrerequisiteError(
            f"videos need the package av (PyAV): {error}", fix="pip install 'nw-eval[video]'"
        ) from error


class _VideoFile:
    """An MP4 file that pictures are added to; a context manager.

    Args:
        path: of the file.
        size: width and height, even numbers of pixels.
        rate: pictures a second.

    Raises:
        PrerequisiteError: PyAV is not installed, or its FFmpeg has no encoder for such a file.
        OSError: (every method) the file cannot be written.
    """

    def __init__(self, path: Path, *, size: tuple[int, int], rate: int) -> None:
        self._av = video_library()
        codec, options = self._codec()
        self._file: Any = self._av.open(str(path), "w", format="mp4")
        self._stream: Any = self._file.add_stream(codec, rate=rate, options=options)
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"
        self._stream.time_base = Fraction(1, rate)
        # One, so that the same pictures make the same bytes.
        self._stream.thread_count = 1
        self._count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, picture: Bytes) -> None:
        """Add the next picture, (height, width, 3) sRGB."""
        frame = self._av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame.pts = self._count
        self._count += 1
        for packet in self._stream.encode(frame):
            self._file.mux(packet)

    def close(self) -> None:
        """Write what waits, and the file's end; calling it again does nothing."""
        if self._file is not None:
            for packet in self._stream.encode():
                self._file.mux(packet)
            self._file.close()
            self._file = None

    def _codec(self) -> tuple[str, dict[str, str]]:
        known: Any = self._av.codecs_available
        for name, options in _CODECS:
            if name in known:
                return name, options
        raise PrerequisiteError(
            "the FFmpeg of the installed av writes neither H.264, nor VP9, nor MPEG-4",
            fix="pip install --force-reinstall --only-binary av av",
        )


_MOMENTS = 6
_ON_SHEET = VIEW
_ROBOT = "go1"
_SETTLING = 40  # control steps until a robot that was put down stands


def contact_sheet(logged: LoggedTrial) -> bytes:
    """Draw a recorded trial at six moments: from outside, and what the robot's camera saw.

    Returns:
        A PNG.

    Raises:
        StoreError: the log has no states.
    """
    states = logged.log.states()
    if not states:
        raise StoreError(f"{logged.path} has no recorded states", fix="run the trial again")
    chosen = np.unique(np.linspace(0, len(states) - 1, _MOMENTS).round().astype(int))
    width, height = _ON_SHEET
    cells: list[Cell] = []
    with open_trial(logged.job, Library(), StageClock()) as trial:
        splat = None if trial.scene.splat is None else trial.shown()
        spectator = Spectator(trial.scene, splat)
        drawn = _as_drawn(trial.scene)
        world, trail = trial.episode.world, trial.episode.task.goal.waypoints
        for index in chosen:
            trial.episode.restore(states[index])
            label = f"{world.time:.2f} s, {trial.episode.task.standing}"
            views = [
                spectator.beside(
                    world,
                    trail,
                    width=width,
                    height=height,
                    ghost=ghost_of(trial.episode.task, trial.episode.step),
                ),
                spectator.aboard(world, trail, _EGO, width=width, height=height),
            ]
            cells.append(Cell(name=label, images=views))
    return draw_sheet(cells, across=len(cells) // 2 or 1, title=_title(logged, drawn))


def write_scene_sheet(scenes: Sequence[Scene], path: Path, *, width: int = 480) -> None:
    """Draw each scene twice: from outside, and through the camera of a Go1 at its start.

    Raises:
        StoreError: the picture cannot be written.
    """
    cells = [
        Cell(
            name=scene.name,
            caption=f"{scene.title}{_as_drawn(scene)}",
            images=scene_views(scene, width=width),
        )
        for scene in scenes
    ]
    picture = draw_sheet(cells, across=max(1, round(len(cells) ** 0.5)))
    with atomic_path(followed(path)) as temporary:
        temporary.write_bytes(picture)


def scene_views(scene: Scene, *, width: int) -> list[NDArray[np.uint8]]:
    """Return a scene from outside, and through the camera of a Go1 at its start.

    Args:
        scene: its splat, or its mesh if it has none.
        width: of each view (H, W, 3), pixels; 16 to 9.
    """
    height = width * 9 // 16
    splat = None
    if scene.splat is not None:
        splat = open_renderer(open_store(scene.splat_store()), projection="ray")
    spectator, robot = Spectator(scene, splat), get_robot(_ROBOT)
    with World(robot, scene) as world:
        for _ in range(_SETTLING):
            world.step(robot.standing_targets)
        return [
            spectator.beside(world, scene.trail, width=width, height=height),
            spectator.aboard(world, scene.trail, _EGO, width=width, height=height),
        ]


def _as_drawn(scene: Scene) -> str:
    return "" if scene.splat is not None else " (no splat: its mesh is drawn)"


def _title(logged: LoggedTrial, drawn: str) -> str:
    """Return which trial this was and how it ended."""
    verdict, job = logged.verdict, logged.job
    end = verdict.get("outcome") or verdict.get("error_type") or "no outcome"
    reason = verdict.get("end_reason") or verdict.get("error_text")
    end = f"{end} ({reason})" if reason else end
    trial = f"{job.trial.scene}, trial {job.trial.index:03d}"
    return f"{trial} of {job.policy_name or job.policy}: {end}{drawn}"
