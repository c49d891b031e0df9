"""Pictures that no log has: worst trials from outside, and scenes from above in their colours.

The robot is put where the states of a trial's log say that it was, and no policy is asked. One
confined process draws all that the user's cache does not hold. Of a run that somebody else may have
made only built-in scenes are opened: nothing that its files name.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from nw_base.digest import digest_of
from nw_base.errors import NwEvalError
from nw_eval.api.evidence import KeptEvidence, WantedLog
from nw_eval.api.evidence_log import PERIOD, SECONDS, Box, ReadClip, box_round, clip_of, sized, webp
from nw_eval.reporting.html.evidence import Film, LogEvidence, PlacePicture, PlaceView
from nw_gate.results.provenance import code_info

if TYPE_CHECKING:
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder
    from nw_scenes import Scene
    from nw_sim.rollout.library import Library
    from nw_sim.rollout.mcap.reader import LogReader

MOST_FILMS = 3
"""Trials that are shown from outside; each takes three seconds of processor time."""
FILM_BYTES = 240_000
"""Of one film."""
_VIEW = (256, 144)
"""Pixels of a picture from outside."""
_TOP_BYTES = 30_000
"""Of a scene from above: sixteen of them have half a megabyte."""
_TOP_SIDE = 560
"""Pixels of its longer side."""
_EYE = 200.0
"""Metres over the ground at which the camera looks down, along rays as good as parallel."""
_OVER = 1.2
"""Metres over the highest waypoint from which on nothing is drawn: lamps, ceilings, crowns."""
_TIME_LIMIT = 240.0
_AFTER = 0.5
"""Seconds that a film goes on after the waypoint that it is about."""


class Drawn(BaseModel):
    """What the confined process answers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", ser_json_bytes="base64", val_json_bytes="base64"
    )

    films: tuple[ReadClip | None, ...] = ()
    tops: tuple[bytes, ...] = ()
    """WebP; empty where there is no room for one."""


@dataclass(frozen=True, kw_only=True)
class _Top:
    """A scene that is to be drawn from above."""

    name: str
    reference: str
    scene: Scene
    box: Box

    @classmethod
    def of(cls, place: PlaceView, reference: str, scene: Scene) -> Self:
        if len(scene.trail) or place.picture is None:
            # Of the scene, and not of a trial, whose waypoints may be moved: runs share it.
            box = box_round(np.vstack([scene.trail[:, :2], [scene.spawn.position[:2]]]))
        else:
            known = place.picture
            box = known.west, known.south, known.east, known.north
        return cls(name=place.scene, reference=reference, scene=scene, box=box)

    @property
    def key(self) -> str:
        """Hex digest of all that the picture depends on."""
        splat = None if self.scene.splat is None else self.scene.splat.key
        return digest_of([code_info().digest, self.scene.digest, splat, list(self.box), _TOP_SIDE])


def with_drawn(
    evidence: LogEvidence,
    folder: RunFolder,
    rows: Sequence[Row],
    logs: Mapping[str, Path],
    *,
    digests: Mapping[str, str],
    kept: KeptEvidence | None,
    is_own: bool,
) -> LogEvidence:
    """Return evidence with pictures of the worst trials and of the scenes, as far as they can be.

    Args:
        evidence: of the logs; trials without a clip of what was seen are not drawn either.
        folder: of the run.
        rows: its trials.
        logs: where logs lie, by trial.
        digests: of the scenes, by name, as run.json has them.
        kept: where to keep what was drawn; None = nowhere.
        is_own: whether this machine has just made the run: its logs may name scenes.
    """
    filmed = [each for each in evidence.clips if each.trial_id in logs][:MOST_FILMS]
    if not evidence.places and not filmed:
        return evidence  # Without the simulator, which knows scenes.
    from nw_sim.rollout.replaying.logged import read_logged_trial

    known = {row.trial_id: row for row in rows}
    try:
        scenes = _scenes(evidence, known, logs, digests, is_own=is_own)
        jobs = {each.trial_id: read_logged_trial(logs[each.trial_id]).job for each in filmed}
        ready = [
            each
            for each in filmed
            if (row := known[each.trial_id]).scene in scenes
            and jobs[each.trial_id].scene == scenes[row.scene][0]
            and (is_own or jobs[each.trial_id].robot_folder is None)
        ]
        robots = [jobs[each.trial_id].robot_folder for each in ready]
        wanted = [
            WantedLog(path=logs[each.trial_id], scene=known[each.trial_id].scene, clip=True)
            for each in ready
        ]
        tops = [
            _Top.of(place, *scenes[place.scene])
            for place in evidence.places
            if place.scene in scenes and _is_ready(scenes[place.scene][1], rows, place.scene)
        ]
        also = [folder.path.resolve(), *(robot for robot in robots if robot is not None)]
        films, pictures = _found_or_drawn(wanted, tops, scenes, kept, also, _Means())
    except (NwEvalError, OSError) as error:
        remark = f"Scenes and trials could not be drawn from outside: {error}."
        return replace(evidence, remarks=(*evidence.remarks, remark))
    by_trial = {each.trial_id: film for each, film in zip(ready, films, strict=True) if film}
    return replace(
        evidence,
        clips=tuple(
            replace(each, outside=film_of(by_trial[each.trial_id]))
            if each.trial_id in by_trial
            else each
            for each in evidence.clips
        ),
        places=tuple(
            replace(place, picture=pictures.get(place.scene, place.picture))
            for place in evidence.places
        ),
    )


def _scenes(
    evidence: LogEvidence,
    rows: Mapping[str, Row],
    logs: Mapping[str, Path],
    digests: Mapping[str, str],
    *,
    is_own: bool,
) -> dict[str, tuple[str, Scene]]:
    """Return scenes that may be opened, with what opens them, by their names in the run."""
    from nw_sim.catalogue import is_built_in, open_scene
    from nw_sim.rollout.replaying.logged import read_logged_trial

    names = {place.scene for place in evidence.places}
    scenes: dict[str, tuple[str, Scene]] = {}
    for trial, row in rows.items():
        if row.scene not in names or row.scene in scenes:
            continue
        if is_built_in(row.scene):
            reference, scene = row.scene, open_scene(row.scene)
        elif is_own and trial in logs:
            job = read_logged_trial(logs[trial]).job
            reference, scene = job.scene, open_scene(job.scene, job.collision)
        else:
            continue
        if scene.digest == digests.get(row.scene):
            scenes[row.scene] = (reference, scene)
    return scenes


def _is_ready(scene: Scene, rows: Sequence[Row], name: str) -> bool:
    """Whether a scene can be drawn without a splat being made first, which may take minutes."""
    from nw_places.entry import BuiltInSplat

    if isinstance(scene.splat, BuiltInSplat):
        return scene.splat.path.is_file()
    is_seen = any(row.scene == name and row.coverage_mean is not None for row in rows)
    return scene.splat is None or is_seen


def films_of(
    logs: Sequence[tuple[Path, str]],
    folder: Path,
    *,
    kept: KeptEvidence | None,
    most_bytes: int,
    seconds: float,
) -> tuple[ReadClip | None, ...]:
    """Return films of trials from outside, in the order of their logs; None for one that fails.

    No Gaussians are made for them: where those of one scene are missing, meshes are drawn of all.

    Args:
        logs: of trials that this machine has run, each with the name of its scene.
        folder: of the run.
        kept: where to keep what was drawn; None = nowhere.
        most_bytes: of one film.
        seconds: wall time of all of them, at most.

    Raises:
        NwEvalError: a log or a scene cannot be opened, or the process that draws them failed.
    """
    from nw_sim.catalogue import open_scene
    from nw_sim.rollout.replaying.logged import read_logged_trial

    jobs = {name: read_logged_trial(path).job for path, name in logs}
    scenes = {name: (job.scene, open_scene(job.scene, job.collision)) for name, job in jobs.items()}
    robots = {job.robot_folder for job in jobs.values() if job.robot_folder is not None}
    wanted = [WantedLog(path=path, scene=name, clip=True) for path, name in logs]
    means = _Means(
        most_bytes=most_bytes,
        seconds=seconds,
        meshes=not all(_is_ready(scene, (), name) for name, (_, scene) in scenes.items()),
    )
    also = [folder.resolve(), *sorted(robots)]
    return _found_or_drawn(wanted, [], scenes, kept, also, means)[0]


@dataclass(frozen=True, kw_only=True)
class _Means:
    """With what films are drawn."""

    most_bytes: int = FILM_BYTES
    seconds: float = _TIME_LIMIT
    meshes: bool = False
    """Whether scenes are drawn without their Gaussians."""


def _found_or_drawn(
    wanted: Sequence[WantedLog],
    tops: Sequence[_Top],
    scenes: Mapping[str, tuple[str, Scene]],
    kept: KeptEvidence | None,
    also: Sequence[Path],
    means: _Means,
) -> tuple[tuple[ReadClip | None, ...], dict[str, PlacePicture]]:
    """Return films of logs and pictures of scenes, drawn where they are not kept."""
    room = {"film": means.most_bytes} | ({"meshes": 1} if means.meshes else {})
    key = "" if kept is None or not wanted else kept.key(wanted, room)
    old = read_drawn(kept, key)
    films = None if old is None or len(old.films) != len(wanted) else old.films
    pictures: dict[str, bytes] = {}
    missing: list[_Top] = []
    for top in tops:
        one = read_drawn(kept, top.key)
        if one is None or len(one.tops) != 1:
            missing.append(top)
        else:
            pictures[top.name] = one.tops[0]
    if missing or (films is None and wanted):
        drawn = drawn_apart([] if films is not None else wanted, missing, scenes, also, means)
        if films is None:
            films = drawn.films
            keep_drawn(kept, key, Drawn(films=films))
        for top, picture in zip(missing, drawn.tops, strict=True):
            pictures[top.name] = picture
            keep_drawn(kept, top.key, Drawn(tops=(picture,)))
    boxes = {top.name: top.box for top in tops}
    return films or (), {
        name: _picture(data, boxes[name]) for name, data in pictures.items() if data
    }


def read_drawn(kept: KeptEvidence | None, key: str) -> Drawn | None:
    """Return what was drawn before; None if nothing is kept under the key."""
    content = None if kept is None or not key else kept.find_text(key)
    try:
        return None if content is None else Drawn.model_validate_json(content)
    except ValidationError:
        return None


def keep_drawn(kept: KeptEvidence | None, key: str, drawn: Drawn) -> None:
    """Keep what was drawn, if there is a cache; nothing under an empty key."""
    if kept is not None and key:
        kept.keep_text(key, drawn.model_dump_json())


def drawn_apart(
    wanted: Sequence[WantedLog],
    tops: Sequence[_Top],
    scenes: Mapping[str, tuple[str, Scene]],
    also: Sequence[Path],
    means: _Means | None = None,
) -> Drawn:
    """Return films of logs and pictures of scenes, drawn by one confined process.

    Args:
        wanted: logs of which a film is wanted.
        tops: scenes of which a picture from above is wanted.
        scenes: what opens each scene, and the scene, by name.
        also: folders that the process may read besides the scenes.
        means: with what films are drawn; None = as those of a report.

    Raises:
        StoreError: the process gave no pictures.
        NwEvalError: it took more time or memory than it may.
    """
    from nw_base.errors import StoreError
    from nw_sim.rollout.confined.access import drawing_rules
    from nw_sim.rollout.confined.isolated import call_isolated

    means = means or _Means()
    used = {scenes[log.scene] for log in wanted} | {(top.reference, top.scene) for top in tops}
    splats = any(scene.splat is not None for _, scene in used) and not means.meshes
    if splats:
        for _, scene in used:
            scene.splat_stores()  # Their cache is out of reach there.
    answer = call_isolated(
        _draw,
        subject="the pictures of scenes",
        rules=drawing_rules(scenes=[reference for reference, _ in used], also=also),
        time_limit=means.seconds,
        renders=("ray", "rays") if splats else ("rays",),
        logs=[(str(log.path.resolve()), log.waypoint) for log in wanted],
        tops=[(top.reference, list(top.box)) for top in tops],
        most_bytes=means.most_bytes,
        meshes=means.meshes,
    )
    try:
        drawn = Drawn.model_validate_json(str(answer))
    except ValidationError:
        raise StoreError("the process that draws them gave no pictures") from None
    if (len(drawn.films), len(drawn.tops)) != (len(wanted), len(tops)):
        raise StoreError("the process that draws them gave other pictures")
    return drawn


def film_of(clip: ReadClip) -> Film:
    """Return a drawn clip as a page shows it."""
    return Film(data=clip.data, still=clip.still, width=clip.width, height=clip.height)


def _picture(data: bytes, box: Box) -> PlacePicture:
    west, south, east, north = box
    return PlacePicture(
        mime="image/webp",
        data=data,
        west=west,
        east=east,
        south=south,
        north=north,
        is_coloured=True,
    )


def _draw(
    *,
    logs: Sequence[tuple[str, int]],
    tops: Sequence[tuple[str, Sequence[float]]],
    most_bytes: int,
    meshes: bool,
) -> str:
    """Return JSON of `Drawn`; in a confined process.

    Args:
        logs: the path of each, and the waypoint until which its film goes; 0 = until its end.
        tops: what opens each scene, and its box.
        most_bytes: of one film.
        meshes: whether films show scenes without their Gaussians.
    """
    from nw_sim.rollout.library import Library

    library = Library()
    drawn = Drawn(
        films=tuple(
            _film_or_none(Path(log), library, waypoint, most_bytes, meshes=meshes)
            for log, waypoint in logs
        ),
        tops=tuple(_from_above(library.scene(reference), box) for reference, box in tops),
    )
    return drawn.model_dump_json()


def _film_or_none(
    path: Path, library: Library, waypoint: int, most_bytes: int, *, meshes: bool
) -> ReadClip | None:
    try:
        return _filmed(path, library, waypoint, most_bytes, meshes=meshes)
    except Exception:  # noqa: BLE001 - A log that cannot be drawn costs its own film alone.
        return None


def _filmed(
    path: Path, library: Library, waypoint: int, most_bytes: int, *, meshes: bool
) -> ReadClip | None:
    """Return seconds of a trial from behind the robot's shoulder; None without states.

    They are the last ones, or those until shortly after a waypoint was reached.
    """
    from PIL import Image

    from nw_scenes.robots import know_robot
    from nw_sim.rollout.replaying.logged import read_logged_trial
    from nw_sim.rollout.replaying.policy_switch import open_replayed
    from nw_sim.rollout.replaying.third_person import Spectator, ghost_of

    logged = read_logged_trial(path)
    know_robot(logged.job.robot, logged.job.robot_folder)
    width, height = _VIEW
    frames: list[tuple[float, Image.Image]] = []
    with open_replayed(logged, library) as trial:
        world, trail = trial.episode.world, trial.episode.task.goal.waypoints
        states = logged.log.states()
        if not states:
            return None
        times = [state.step / logged.control_rate for state in states]
        end = min(times[-1], _reached(logged.log, waypoint) + _AFTER) if waypoint else times[-1]
        is_mesh = meshes or trial.scene.splat is None
        spectator = Spectator(trial.scene, None if is_mesh else trial.shown())
        for time, pose in _poses(logged.log, end, world.robot.joints).items():
            # What moves besides the robot is where it was at the last state.
            world.restore(states[max(0, bisect_right(times, time + 1e-6) - 1)].world)
            world.pose(*pose)
            step = round(time * logged.control_rate)
            ghost = ghost_of(trial.episode.task, step)
            view = spectator.beside(world, trail, width=width, height=height, ghost=ghost)
            frames.append((time, sized(Image.fromarray(view))))
    return clip_of(frames, topic="", end=end, most_bytes=most_bytes) if frames else None


def _reached(log: LogReader, waypoint: int) -> float:
    """Return when a trial reached a waypoint, s; infinity if it did not."""
    events = log.messages("/nw/event")
    times = [
        t for _, t, event in events if event.kind == "waypoint" and event.waypoint == waypoint - 1
    ]
    return times[0] * 1e-9 if times else inf


_Pose = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Position (3,) m and quaternion (4,) of the trunk, and (J,) rad."""


def _poses(log: LogReader, end: float, joints: Sequence[str]) -> dict[float, _Pose]:
    """Return a robot's poses in the last seconds of a log, by time, s.

    They are those at whole periods, when cameras take pictures, and that at the end.
    """
    trunk: dict[float, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    turned: dict[float, NDArray[np.float64]] = {}
    for topic, time_ns, message in log.messages("/robot/odom", "/robot/joints"):
        time = time_ns * 1e-9
        since = time / PERIOD
        is_whole = abs(since - round(since)) < 1e-3 and end - SECONDS < time - 1e-6 <= end
        if not is_whole and abs(time - end) > 1e-6:
            continue
        if topic == "/robot/odom":
            p, q = message.pose.position, message.pose.orientation
            trunk[time] = np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z])
        else:
            angles = {joint.name: joint.position for joint in message.joints}
            turned[time] = np.array([angles[name] for name in joints])
    return {time: (*trunk[time], turned[time]) for time in sorted(trunk.keys() & turned.keys())}


def _from_above(scene: Scene, box: Sequence[float]) -> bytes:
    """Return a WebP of a scene from straight above; empty if it has no room."""
    from PIL import Image

    from nw_scenes.rays import RayScene
    from nw_sim.sensors.drawing.overlay import MeshPicture
    from nw_splat.camera import Camera
    from nw_splat.render import open_renderer
    from nw_splat.store import open_store

    west, south, east, north = box
    scale = _TOP_SIDE / max(east - west, north - south)
    width, height = max(1, round((east - west) * scale)), max(1, round((north - south) * scale))
    ground = float(scene.spawn.position[2])
    T_world_camera = np.diag([1.0, -1.0, -1.0, 1.0])  # x to the right, y up, looking down.
    T_world_camera[:3, 3] = (west + east) / 2, (south + north) / 2, ground + _EYE
    top = max(ground, float(scene.trail[:, 2].max(initial=ground))) + _OVER
    T_splat_camera = (np.linalg.inv(scene.T_world_splat) @ T_world_camera).astype(np.float64)
    if scene.splat is None:
        mesh = scene.mesh()
        below = mesh.triangles[:, :, 2].min(axis=1) < top
        mesh = replace(mesh, faces=mesh.faces[below], kinds=mesh.kinds[below])
        renderer = MeshPicture(RayScene(mesh), scene.T_world_splat)
    else:
        renderer = open_renderer(open_store(scene.splat_store()), projection="ray")
    image = renderer.render(
        Camera(
            width=width,
            height=height,
            fx=scale * _EYE,
            fy=scale * _EYE,
            cx=width / 2,
            cy=height / 2,
            T_world_camera=T_splat_camera,
            near=ground + _EYE - top,
        )
    )
    picture = Image.fromarray(image.bytes())
    for quality in (70, 45, 20):
        if len(data := webp(picture, quality)) <= _TOP_BYTES:
            return data
    return b""
