"""Cameras and points out of matches.

Of the cameras those count that common points tie together: what none ties to the rest may lie
anywhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.plural import plural
from nw_twin.calibrate.features import Matches
from nw_twin.calibrate.report import Pace, Say
from nw_twin.calibrate.solution import Placed, Solution, inverse
from nw_twin.lens import Lens
from nw_twin.packages import quiet

_ENOUGH = 0.9
"""Share of the photographs with which the first try is taken, without a second."""
_FAILURES = (RuntimeError, ValueError, IndexError)
_FITS = 4.0
"""Pixels from its epipolar line up to which a match fits two cameras: as it was verified."""
_AGREES = 0.6
"""Share of a camera's matches that fit its place. On a street of 14 photographs, whose far end and
clouds match in all, the last camera was placed 30 steps away with .49; placed well, none had less
than .64."""
_LOOKS = 1.0
"""Seconds between two looks at a mapping that runs."""
_Result = TypeVar("_Result")

_SHARED = 25
"""Points that two cameras must both see to be tied. Of 240 cameras of six built-in courses the one
that was placed wrongly, by metres, shared 17 with another one, the others 37 and more."""


@dataclass(frozen=True)
class Mapped:
    """Cameras that were placed.

    Attributes:
        solution: cameras and points of the largest group.
        how: what placed them: `incremental` or `global`.
        tries: photographs that each mapping placed.
        others: photographs, by name, of each other group: placed among themselves, with nothing
            that ties them to the largest.
    """

    solution: Solution
    how: str = "incremental"
    tries: dict[str, int] = field(default_factory=dict[str, int])
    others: tuple[tuple[str, ...], ...] = ()


def map_cameras(
    matches: Matches, names: Mapping[str, str], working: Path, *, seed: int, say: Say
) -> Mapped:
    """Place cameras one after the other; if many are left, or one does not fit, all at once.

    Of the two the one counts whose cameras more matches fit. With one thread, whose results are the
    same each time.

    Args:
        matches: of the photographs.
        names: of photographs by their files.
        working: gets `incremental` and `global`.
        seed: of random numbers.
        say: is given lines of progress.
    """
    best, most, tries = Mapped(Solution(placed=())), 0, dict[str, int]()
    files = {name: file for file, name in names.items()}
    for kind, mapper in (("incremental", _incremental), ("global", _global)):
        with quiet() as pycolmap:
            try:
                models = mapper(pycolmap, matches, working / kind, seed, say)
            except _FAILURES as error:
                say(f"{kind} mapping failed: {error}")
                models = {}
        mapped = _largest_of(models, names, kind)
        tries[kind] = len(mapped.solution.placed)
        say(f"{kind} mapping placed {tries[kind]} of {len(names)} photographs")
        fits = fitting(matches.database, mapped.solution, files)
        count = sum(fit for fit, _ in fits.values())
        if count > most:
            best, most = mapped, count
        unlike = [name for name, (fit, of) in fits.items() if fit < _AGREES * of]
        for name in unlike:
            say(f"the pose of {name} fits {fits[name][0] / fits[name][1]:.0%} of its matches")
        if tries[kind] >= _ENOUGH * len(names) and not unlike:
            break
    if best.others:
        sizes = " and ".join(str(len(group)) for group in best.others)
        say(
            f"{plural(len(best.others), 'other group')} with {sizes} of the photographs "
            "placed without a tie to these: left out"
        )
    return replace(best, tries=tries)


def _largest_of(models: Mapping[int, Any], names: Mapping[str, str], how: str) -> Mapped:
    """Return the model with most photographs, and who is in the others alone."""
    order = sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))
    if not order:
        return Mapped(Solution(placed=()), how)
    solution = solution_of(order[0], names)
    held = tied(solution)
    counted, others = set(held.by_name), list[tuple[str, ...]]()
    groups = [list(solution.by_name)]
    groups += [[names[m.images[key].name] for key in m.reg_image_ids()] for m in order[1:]]
    for group in groups:
        more = tuple(sorted(set(group) - counted))
        counted |= set(more)
        others += [more] if more else []
    return Mapped(held, how, others=tuple(sorted(others, key=lambda each: -len(each))))


def fitting(
    database: Path, solution: Solution, files: Mapping[str, str]
) -> dict[str, tuple[int, int]]:
    """Return how many matches of each placed photograph fit its camera, and of how many.

    Points that are far away fit wherever a camera stands, so that a camera can be placed by them
    alone, steps away; the matches of what is near do not fit there.

    Args:
        database: of COLMAP, with verified matches.
        solution: cameras.
        files: of photographs by their names.
    """
    counts = {one.name: (0, 0) for one in solution.placed}
    with quiet() as pycolmap, closing(pycolmap.Database.open(database)) as opened:
        numbers = {image.name: image.image_id for image in opened.read_all_images()}
        views: dict[str, tuple[int, float, NDArray[np.float64]]] = {}
        for one in solution.placed:
            number, camera = numbers[files[one.name]], one.lens.camera()
            points = np.asarray(opened.read_keypoints(number), dtype=np.float64)[:, :2]
            rays = np.column_stack([camera.cam_from_img(points), np.ones(len(points))])
            views[one.name] = number, camera.mean_focal_length(), rays
        for one, other in combinations(solution.placed, 2):
            (first, f, rays), (second, g, others) = views[one.name], views[other.name]
            if not opened.exists_two_view_geometry(first, second):
                continue
            geometry = opened.read_two_view_geometry(first, second)
            rows = np.asarray(geometry.inlier_matches).reshape(-1, 2)
            T = inverse(other.T_world_camera) @ one.T_world_camera
            E = np.cross(T[:3, 3], T[:3, :3], axisa=0, axisb=0, axisc=0)
            p, q = rays[rows[:, 0]], others[rows[:, 1]]
            there, back = p @ E.T, q @ E
            long = np.sqrt((there[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
            apart = np.abs((q * there).sum(axis=1)) / np.maximum(long, 1e-12) * (f + g) / 2
            fit = int((apart < _FITS).sum())
            for name in (one.name, other.name):
                counts[name] = counts[name][0] + fit, counts[name][1] + len(rows)
    return counts


def _attended(
    work: Callable[[], _Result], stop: Callable[[], None], at: Callable[[], None]
) -> _Result:
    """Return what work in a thread of its own returns: this thread receives signals meanwhile.

    Args:
        work: that takes long, and lets other threads run.
        stop: ends it soon, after a signal.
        at: is called about each second.
    """
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(work)
        try:
            while True:
                try:
                    return running.result(timeout=_LOOKS)
                except TimeoutError:
                    at()
        except BaseException:
            stop()
            raise


def _incremental(pycolmap: Any, matches: Matches, out: Path, seed: int, say: Say) -> dict[int, Any]:
    out.mkdir()
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed, options.num_threads, options.min_model_size = seed, 1, 3
    pace = Pace(say, "cameras placed", len(matches.features))
    token, done = pycolmap.CancellationToken(), 2  # The first two come without a call.

    def another() -> None:
        nonlocal done
        done += 1

    return _attended(
        lambda: pycolmap.incremental_mapping(
            matches.database,
            matches.pictures,
            out,
            options=options,
            next_image_callback=another,
            cancellation_token=token,
        ),
        token.cancel,
        lambda: pace.at(min(done, pace.total - 1)),  # A second model counts them again.
    )


def _global(pycolmap: Any, matches: Matches, out: Path, seed: int, say: Say) -> dict[int, Any]:
    out.mkdir()
    view_graph = pycolmap.ViewGraphCalibrationOptions()
    view_graph.random_seed = seed
    options = pycolmap.GlobalPipelineOptions()
    options.random_seed, options.num_threads = seed, 1
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.ceres.use_gpu = False
    pace = Pace(say, "global mapping of all photographs at once", 0)

    def work() -> dict[int, Any]:
        pycolmap.calibrate_view_graph(matches.database, options=view_graph)
        return pycolmap.global_mapping(matches.database, matches.pictures, out, options=options)

    def stop() -> None:
        say("global mapping cannot be stopped (pycolmap 4.2): a second signal ends at once")

    return _attended(work, stop, pace.goes_on)


def triangulate(
    matches: Matches,
    cameras: Solution,
    files: Mapping[str, str],
    working: Path,
    *,
    seed: int,
    say: Say,
) -> Solution:
    """Return points for cameras that are known; the cameras stay as they are.

    Args:
        matches: of photographs entered with these cameras' lenses.
        cameras: by photographs' names.
        files: of photographs by their names.
        working: gets `triangulated`.
        seed: of random numbers.
        say: is given lines of progress.

    Raises:
        SceneError: COLMAP fails.
    """
    names = {file: name for name, file in files.items()}
    with quiet() as pycolmap:
        try:
            posed = _posed(pycolmap, matches, {n: cameras.by_name[m] for n, m in names.items()})
            options = pycolmap.IncrementalPipelineOptions()
            options.random_seed, options.num_threads = seed, 1
            (working / "triangulated").mkdir()
            token, pace = pycolmap.CancellationToken(), Pace(say, "points looked for", 0)
            model = _attended(
                lambda: pycolmap.triangulate_points(
                    posed,
                    matches.database,
                    matches.pictures,
                    working / "triangulated",
                    options=options,
                    cancellation_token=token,
                ),
                token.cancel,
                pace.goes_on,
            )
        except _FAILURES as error:
            raise SceneError(
                f"COLMAP found no points with these cameras: {error}",
                fix="check that cameras and photographs belong together",
            ) from None
        return solution_of(model, names)


def _posed(pycolmap: Any, matches: Matches, placed: Mapping[str, Placed]) -> Any:
    """Return a model of COLMAP without points, its numbers those of the database."""
    model = pycolmap.Reconstruction()
    opened = pycolmap.Database.open(matches.database)
    try:
        for camera in opened.read_all_cameras():
            model.add_camera_with_trivial_rig(camera)
        for image in opened.read_all_images():
            T = inverse(placed[image.name].T_world_camera)
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3])
            one = pycolmap.Image(
                name=image.name, camera_id=image.camera_id, image_id=image.image_id
            )
            model.add_image_with_trivial_frame(one, pose)
    finally:
        opened.close()
    return model


def solution_of(model: Any, names: Mapping[str, str]) -> Solution:
    """Return the cameras and points of a COLMAP model, by photographs' names.

    Args:
        model: a `pycolmap.Reconstruction`.
        names: of photographs by their files.
    """
    model.update_point_3d_errors()
    rows = {key: row for row, key in enumerate(sorted(model.points3D))}
    placed: list[Placed] = []
    for key in model.reg_image_ids():
        image = model.images[key]
        camera = model.cameras[image.camera_id]
        T = np.eye(4)
        pose = image.cam_from_world()
        T[:3, :3], T[:3, 3] = pose.rotation.matrix(), pose.translation
        seen = {rows[p.point3D_id] for p in image.points2D if p.has_point3D()}
        placed.append(
            Placed(
                name=names[image.name],
                lens=Lens(
                    model=camera.model_name,
                    width=camera.width,
                    height=camera.height,
                    params=tuple(float(p) for p in camera.params),
                ),
                T_world_camera=inverse(T),
                seen=np.array(sorted(seen), dtype=np.int32),
            )
        )
    points = [model.points3D[key] for key in rows]
    return Solution(
        placed=tuple(placed),
        points=np.array([p.xyz for p in points], dtype=np.float64).reshape(-1, 3),
        colours=np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
        errors=np.array([p.error for p in points], dtype=np.float32),
    )


def tied(solution: Solution) -> Solution:
    """Return the largest part of a solution whose cameras hang together, with the points it sees.

    Global mapping places all cameras of its graph of turns, also a group of them that shares no
    point with the others: where it lies, and how large it is, is then chance.
    """
    part = _largest(solution)
    placed = [solution.placed[place] for place in part]
    if len(placed) == len(solution.placed):
        return solution
    seen = [one.seen for one in placed]
    kept = np.unique(np.concatenate(seen)) if seen else np.zeros(0, np.int32)
    renumbered = np.zeros(len(solution.points), np.int32)
    renumbered[kept] = np.arange(len(kept), dtype=np.int32)
    return Solution(
        placed=tuple(replace(one, seen=renumbered[one.seen]) for one in placed),
        points=solution.points[kept],
        colours=solution.colours[kept],
        errors=solution.errors[kept],
    )


def _largest(solution: Solution) -> list[int]:
    """Return the indices of the cameras of the largest part, in order; of equals the first."""
    parts = list(range(len(solution.placed)))
    for (one, other), count in sorted(_shared(solution).items()):
        if count >= _SHARED and parts[one] != parts[other]:
            old, new = parts[other], parts[one]
            parts = [new if part == old else part for part in parts]
    sizes = Counter(parts)
    largest = max(parts, key=lambda part: (sizes[part], -parts.index(part)), default=None)
    return [index for index, part in enumerate(parts) if part == largest]


def _shared(solution: Solution) -> Counter[tuple[int, int]]:
    watching: list[list[int]] = [[] for _ in range(len(solution.points))]
    for index, one in enumerate(solution.placed):
        for point in one.seen.tolist():
            watching[point].append(index)
    return Counter(pair for places in watching for pair in combinations(places, 2))
