"""From a source to a capture, in five steps: find, take in, compare, map, develop.

What lies at a path is the most particular kind of source that it can be.

Which photographs are compared is chosen here, and why some could not be placed is said here, in
words that help whoever took them.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import is_zipfile

import numpy as np

from nw_base.errors import NwEvalError, SceneError, StoreError, UsageError
from nw_base.files.cache import made_folder, unwritable
from nw_base.files.inside import what_is
from nw_base.files.pictures import open_picture
from nw_base.plural import plural
from nw_twin.calibrate.colmap import colmap_in
from nw_twin.calibrate.develop import develop
from nw_twin.calibrate.exports import (
    arkit_scenes_in,
    keyframes_in,
    nerfstudio_in,
    record3d_in,
)
from nw_twin.calibrate.features import Matches, match
from nw_twin.calibrate.kept import Kept
from nw_twin.calibrate.mapping import map_cameras, triangulate
from nw_twin.calibrate.photographs import (
    DAMAGE,
    UNREADABLE,
    Footage,
    Photograph,
    are_numbered,
    photographs_in,
    take_in,
)
from nw_twin.calibrate.report import CalibrationReport, LeftOut, Say, by_reason
from nw_twin.calibrate.solution import Placed, Solution
from nw_twin.calibrate.video import VIDEOS, frames_of
from nw_twin.capture import write_capture
from nw_twin.options import CalibrateOptions

_KINDS = (
    "give a folder of photographs, a video, or a folder of COLMAP, nerfstudio (transforms.json), "
    "Polycam (keyframes/), Record3D (metadata), 3D Scanner App (frame_*.json) or ARKitScenes"
)


def find_source(
    path: Path, working: Path, *, frames: int, say: Say, per_second: float | None = None
) -> Footage:
    """Return what lies at a path.

    Args:
        path: of a folder, a video or a transforms.json.
        working: folder that frames of a video are written to.
        frames: taken of a video, at most.
        say: is given lines of progress.
        per_second: frames taken of a second of video; None = as the picture moves.

    Raises:
        SceneError: there is nothing that can be read, or it is damaged.
        PrerequisiteError: a package is missing.
    """
    kind = what_is(path)
    if kind == "nothing":
        raise SceneError(f"{path} is not there", fix=_KINDS)
    if kind == "folder":
        source = _in_folder(path, working, frames, say)
        if source is not None:
            return source
        films = [one for one in path.iterdir() if one.suffix.lower() in VIDEOS]
        if len(films) != 1 or what_is(films[0]) != "file":
            if len(films) > 1:
                raise SceneError(f"{path} holds {len(films)} videos", fix="give one of them")
            raise SceneError(f"nothing in {path} is a photograph", fix=_KINDS)
        path = films[0]
    elif path.name.startswith("transforms") and path.suffix == ".json":
        source = nerfstudio_in(path.parent, _size, path.name)
        if source is not None:
            return source
    elif path.suffix.lower() not in VIDEOS:
        if is_zipfile(path):
            raise SceneError(
                f"{path} is a zip archive, as Record3D's .r3d and other exports are",
                fix="unpack it, and give the folder",
            )
        raise SceneError(f"{path} is not a video", fix=_KINDS)
    return frames_of(path, working, frames, say, per_second=per_second)


def _in_folder(path: Path, working: Path, frames: int, say: Say) -> Footage | None:
    return (
        nerfstudio_in(path, _size)
        or keyframes_in(path, working, _size)
        or record3d_in(path, frames, say)
        or arkit_scenes_in(path, frames, say)
        or colmap_in(path, say)
        or photographs_in(path)
    )


def _size(path: Path) -> tuple[int, int] | None:
    try:
        with open_picture(path) as image:
            return image.size
    except DAMAGE:
        return None


_LEAST = 3
"""Photographs without which there is nothing to calibrate."""
_LEAST_POINTS = 20
"""Without which cameras and photographs have nothing to do with each other."""
_TURNED = 0.95
"""Share of the matching pairs without parallax at which there is no place to be found."""
_FIX = (
    "photograph again, in enough light: hold still, move so that each picture shares two thirds "
    "with the previous one, and keep something with texture in view"
)

BLURRED, PLAIN, DARK = "blurred", "no texture", "too dark"
APART, UNFIT = "too far from the others", "does not fit the others"
GROUP = "in a group apart from the largest"

_WORKING = ".calibrate-"
_KEPT = ".calibrate.sqlite"
"""Features and matches, until the capture is written."""

_FEW_FEATURES = 150
_FEW_MATCHES = 30
"""COLMAP's own least number of points by which a camera is placed."""
_BLURRED = 0.3
"""Of the sharpness of the others, their contrast allowed for."""
_BLACK = 20.0
"""Grey value, of 255: a picture that is darker on average shows little."""
_SHAKEN = 0.02
"""Sharpness in squares of the contrast: what has edges at all has more."""


@dataclass(frozen=True)
class _Solved:
    """Cameras, and how they were come by."""

    solution: Solution
    left_out: list[LeftOut]
    matching: str
    mapping: str
    pairs: int = 0
    tries: dict[str, int] = field(default_factory=dict[str, int])
    groups: tuple[int, ...] = ()


def calibrate(
    source: Path,
    out: Path,
    options: CalibrateOptions | None = None,
    say: Say = lambda _: None,
    found: Callable[[Footage], object] = lambda _: None,
) -> CalibrationReport:
    """Turn photographs into a capture: find where each was taken from, and remove distortion.

    The capture's frame has any rotation and scale, except that cameras which the source knows stay
    where they are. Its pictures are at most `options.side` pixels long.

    Features and matches that are found lie in the folder until the end: a calibration that a signal
    cut off goes on from there, and ends with the same bytes.

    Args:
        source: folder of photographs, with `masks/` beside them or not; a video; or a folder of
            COLMAP, nerfstudio or an app, whose cameras are taken as they are.
        out: folder that gets capture.json, points.npz, pictures/, masks/ and report.json.
        options: of the calibration; None = the defaults.
        say: is given lines of progress, with estimates of what is left.
        found: is given the source in the first seconds, before anything is computed of it.

    Raises:
        SceneError: the source cannot be read, has fewer than 3 photographs, or fewer of them than
            `options.share` could be placed; then a line for each reason names those left out, and
            report.json is written without a capture.
        StoreError: the folder cannot be written.
        PrerequisiteError: pycolmap, OpenCV or PyAV is not installed.
    """
    options = options or CalibrateOptions()
    with _working_in(out, say) as (working, kept):
        return _calibrate(source, out, working, kept, options, say, found)


@contextmanager
def _working_in(out: Path, say: Say) -> Generator[tuple[Path, Kept]]:
    """Give a working folder that goes with the context, and what an earlier one has kept.

    That is kept on where a signal ends the context, the disk is full, or an option is refused; else
    it goes too.

    Raises:
        UsageError: a folder is where a file is to be.
        StoreError: the folder cannot be written.
    """
    path = out / _KEPT
    for one in (path, out / "capture.json"):
        if what_is(one) == "folder":
            raise UsageError(f"{one} is a folder", fix="remove it, or choose another --out")
    with ExitStack() as stack:
        try:
            stack.enter_context(made_folder(out))
            for left in out.glob(f"{_WORKING}*"):  # By a process that was killed.
                if left.is_dir() and not left.is_symlink():
                    shutil.rmtree(left)
            name = stack.enter_context(TemporaryDirectory(prefix=_WORKING, dir=out))
        except OSError as error:
            raise unwritable(out, error) from None
        before = path.exists()
        kept, is_over = Kept(path), False
        try:
            yield Path(name), kept
            is_over = True
        except NwEvalError as error:
            is_over = not isinstance(error, (StoreError, UsageError) if before else StoreError)
            raise
        except KeyboardInterrupt:
            say(f"cut off: what was found is kept in {path}, and the same command resumes")
            raise
        finally:
            kept.close()
            if is_over:
                path.unlink(missing_ok=True)


def _calibrate(
    path: Path,
    out: Path,
    working: Path,
    kept: Kept,
    options: CalibrateOptions,
    say: Say,
    found: Callable[[Footage], object],
) -> CalibrationReport:
    source = find_source(
        path, working, frames=options.frames, say=say, per_second=options.per_second
    )
    say(f"{path}: {source.kind}, {plural(len(source.files), 'photograph')}")
    for note in source.notes:
        say(f"note: {note}")
    found(source)
    try:
        (out / "capture.json").unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(out, error) from None
    photographs, unreadable = take_in(
        source.files, working, say, cameras=source.cameras, megapixels=options.megapixels
    )
    if len(photographs) < _LEAST:
        raise SceneError(
            [
                f"{path}: {plural(len(photographs), 'photograph')} can be read, of {_LEAST} needed",
                *by_reason(tuple(unreadable)),
            ],
            fix="give twenty or more",
        )
    solved = _Solver(source, kept, options, say).solve(photographs, working)
    report = _report(source, [*unreadable, *solved.left_out], solved, options)
    if report.share < options.share:
        report.write(out)
        raise SceneError(
            [
                f"{report.placed} of {report.photographs} placed, fewer than {options.share:.0%}",
                *by_reason(report.left_out),
            ],
            fix=f"{_FIX}; or continue with a part of the scene: --share",
        )
    capture = develop(photographs, solved.solution, out, side=options.side, say=say)
    capture = replace(capture, metric=source.metric, up=source.up)
    write_capture(capture, out)
    masked = sum(shot.mask is not None for shot in capture.shots)
    report = replace(report, masked=masked, written=True)
    report.write(out)
    for line in by_reason(report.left_out):
        say(f"left out, {line}")
    return report


@dataclass(frozen=True)
class _Solver:
    """Cameras and points of a source's photographs, which lie in a working folder."""

    source: Footage
    kept: Kept
    options: CalibrateOptions
    say: Say

    def solve(self, photographs: Sequence[Photograph], working: Path) -> _Solved:
        """Return cameras as the source knows them, with points; else those that are found."""
        if self.source.cameras is None:
            return self._find(photographs, working)
        known = _fitting(self.source.cameras, photographs)
        left = [
            LeftOut(name=one.name, reason=UNREADABLE, detail="the source has no camera for it")
            for one in photographs
            if one.name not in known.by_name
        ]
        solved = _Solved(solution=known, left_out=left, matching="none", mapping="known")
        if len(known.points):
            return solved
        self.say("the source has no points that photographs share: they are looked for")
        some = [one for one in photographs if one.name in known.by_name]
        matching = self._matching(some)
        lenses = [known.by_name[one.name].lens for one in some]
        matches = match(some, lenses, matching, working, self.options, self.say, self.kept)
        files = {one.name: one.file for one in some}
        seed = self.options.seed
        solution = triangulate(matches, known, files, working, seed=seed, say=self.say)
        if len(solution.points) < _LEAST_POINTS:
            raise SceneError(
                f"with the cameras of {self.source.kind} the photographs share "
                f"{plural(len(solution.points), 'point')}",
                fix="check that cameras and photographs belong together, or give the photographs "
                "alone",
            )
        return replace(solved, solution=solution, matching=matching, pairs=matches.pairs)

    def _find(self, photographs: Sequence[Photograph], working: Path) -> _Solved:
        """Return cameras by the photographs alone; where EXIF's focal length misleads, without."""
        solved = self._find_once(photographs, working)
        enough = self.options.share * len(photographs)
        if len(solved.solution.placed) >= enough or all(one.focal is None for one in photographs):
            return solved
        self.say("the focal lengths in EXIF may be wrong: once more without them")
        second = working / "again"
        second.mkdir()
        (second / "masks").symlink_to(working / "masks")
        other = self._find_once([replace(one, focal=None) for one in photographs], second)
        return max(solved, other, key=lambda each: len(each.solution.placed))

    def _find_once(self, photographs: Sequence[Photograph], working: Path) -> _Solved:
        matching, nothing = self._matching(photographs), [None] * len(photographs)
        matches = match(photographs, nothing, matching, working, self.options, self.say, self.kept)
        _check_motion(matches)
        names = {one.file: one.name for one in photographs}
        mapped = map_cameras(matches, names, working, seed=self.options.seed, say=self.say)
        solution, groups = mapped.solution, mapped.others
        left = why_not(photographs, solution.by_name, matches, groups)
        sizes = tuple(len(group) for group in groups)
        return _Solved(solution, left, matching, mapped.how, matches.pairs, mapped.tries, sizes)

    def _matching(self, photographs: Sequence[Photograph]) -> str:
        """Return which photographs are compared, as a report calls it."""
        if self.options.matching != "auto":
            return self.options.matching
        names = [one.name for one in photographs]
        return "sequential" if self.source.is_film or are_numbered(names) else "retrieval"


def _check_motion(matches: Matches) -> None:
    """Refuse photographs without parallax: what is made of them may look like a scene, and is none.

    Raises:
        SceneError: a mere turn of the camera explains nearly all pairs that match.
    """
    alike = len(matches.inliers)
    if alike >= _LEAST and matches.turned >= _TURNED * alike:
        raise SceneError(
            f"{matches.turned} of {alike} matching pairs suggest that the camera turned on one "
            "spot, or had one flat surface in view: distances cannot be measured",
            fix="walk while you photograph, half a metre from one photograph to the next, and "
            "keep the ground and what stands on it in view together",
        )


def _fitting(cameras: Solution, photographs: Sequence[Photograph]) -> Solution:
    """Return cameras with lenses of the size that their photographs have.

    Raises:
        SceneError: a photograph has another shape than its camera.
    """
    sizes = {one.name: (one.width, one.height) for one in photographs}
    placed: list[Placed] = []
    for one in cameras.placed:
        if one.name not in sizes:
            continue
        lens, (width, height) = one.lens, sizes[one.name]
        if (lens.width, lens.height) != (width, height):
            if abs(lens.width * height - lens.height * width) > max(lens.width, width) + max(
                lens.height, height
            ):
                raise SceneError(
                    f"{one.name} has {width} x {height} pixels, its camera "
                    f"{lens.width} x {lens.height}",
                    fix="give the photographs that the cameras were made for",
                )
            lens = lens.resized(width, height)
        lens.camera()  # One that makes no sense is named here.
        placed.append(replace(one, lens=lens))
    return replace(cameras, placed=tuple(placed))


def _report(
    source: Footage, left_out: list[LeftOut], solved: _Solved, options: CalibrateOptions
) -> CalibrationReport:
    solution = solved.solution
    lenses = dict.fromkeys(one.lens for one in solution.placed)
    errors = solution.errors
    return CalibrationReport(
        source=source.kind,
        photographs=len(source.files),
        placed=len(solution.placed),
        left_out=tuple(left_out),
        matching=solved.matching,
        pairs=solved.pairs,
        mapping=solved.mapping,
        tries=solved.tries,
        lenses=tuple(
            f"{l.model} {l.width} x {l.height}: " + ", ".join(f"{p:.6g}" for p in l.params)
            for l in lenses
        ),
        points=len(solution.points),
        reprojection_error=float(errors.mean()) if len(errors) else None,
        groups=solved.groups,
        seed=options.seed,
    )


def why_not(
    photographs: Sequence[Photograph],
    placed: Iterable[str],
    matches: Matches,
    groups: Sequence[Sequence[str]] = (),
) -> list[LeftOut]:
    """Return each photograph that is not among the placed, with the likeliest reason.

    Blurred: far less fine detail than the others, though not less contrast; or few features, and
    none of what there is has an edge. No texture: few features. Too far: few matches with any that
    is placed, or with any at all if none is. In a group apart: placed among others that nothing
    ties to the largest group.

    Args:
        photographs: all.
        placed: names of those that are placed.
        matches: of all.
        groups: names of those that were placed among themselves.
    """
    known = set(placed)
    files = {one.file for one in photographs if one.name in known}
    files = files or {one.file for one in photographs}
    left = [one for one in photographs if one.name not in known]
    good = [one for one in photographs if one.name in known] or photographs
    sharp = float(np.median([one.sharpness for one in good]))
    contrast = float(np.median([one.contrast for one in good]))
    most = {one.file: _most(one.file, files, matches) for one in left}
    reasons = [_reason(one, sharp, contrast, most[one.file], matches) for one in left]
    apart = {name: _of_group(group, photographs, most) for group in groups for name in group}
    return [
        LeftOut(name=one.name, reason=GROUP, detail=apart[one.name]) if one.name in apart else one
        for one in reasons
    ]


def _of_group(group: Sequence[str], photographs: Sequence[Photograph], most: dict[str, int]) -> str:
    """Return how large a group is, and why it likely is apart."""
    bridge = max(most.get(one.file, 0) for one in photographs if one.name in group)
    why = (
        f"at most {bridge} matches with one of the largest: photograph the way between them"
        if bridge < _FEW_MATCHES
        else f"{bridge} matches with one of the largest, but no common pose: identical objects may "
        "stand in both"
    )
    return f"a group of {len(group)}, {why}"


def _most(file: str, others: set[str], matches: Matches) -> int:
    counts = [
        count
        for pair, count in matches.inliers.items()
        if file in pair and (pair[0] if pair[1] == file else pair[1]) in others
    ]
    return max(counts, default=0)


def _reason(one: Photograph, sharp: float, contrast: float, most: int, matches: Matches) -> LeftOut:
    share = one.sharpness / max(sharp, 1e-9)
    features = matches.features.get(one.file, 0)
    if share < _BLURRED and one.contrast > 0.4 * contrast:
        reason, detail = BLURRED, f"{share:.0%} of the others' sharpness"
    elif features < _FEW_FEATURES and one.brightness < _BLACK:
        reason, detail = DARK, f"{features} features, mean grey value {one.brightness:.0f} of 255"
    elif features < _FEW_FEATURES and one.sharpness < _SHAKEN * one.contrast**2:
        reason, detail = BLURRED, f"{features} features, none of its edges is sharp"
    elif features < _FEW_FEATURES:
        reason, detail = PLAIN, f"{features} features"
    elif most < _FEW_MATCHES:
        reason, detail = APART, f"at most {most} matches with one of them"
    else:
        reason, detail = UNFIT, f"{most} matches with one of them, but no pose fits it"
    return LeftOut(name=one.name, reason=reason, detail=detail)
