"""Photographs whose cameras an app or another program wrote down, one reader a kind of file.

nerfstudio and Instant-NGP write transforms.json:
https://docs.nerf.studio/quickstart/data_conventions.html. Axes are OpenGL's: x of the camera right,
y up, z back; the world's unit and up are anything.

Apps on iPhones write poses of ARKit, in metres and in the same axes of the camera:

* Polycam's raw data is `keyframes/images` and one JSON of a camera beside each, where `t_00` to
  `t_23` are the rows of T_world_camera, y of the world up: https://github.com/PolyCam/polyform.
* 3D Scanner App's "All Data" is `frame_00012.jpg` and `frame_00012.json`, with matrices in rows, y
  of the world up: https://github.com/laanlabs/3dScannerApp_samples.
* Record3D's .r3d, unpacked, is `rgbd/12.jpg` and `metadata`, with K in columns and poses as
  (qx, qy, qz, qw, x, y, z) relative to the first camera: https://github.com/marek-simonik/record3d,
  issues 27 and 36. Which way is up is lost.
* ARKitScenes has `lowres_wide.traj`, lines of time, axis times angle, and translation of
  T_camera_world in OpenCV's axes, z of the world up, and a `.pincam` for each picture:
  https://github.com/apple/ARKitScenes/blob/main/DATA.md, issue 81.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, bounded_bytes, inside
from nw_base.plural import plural
from nw_scenes.limits import SCALES
from nw_twin.calibrate.colmap import pose_of
from nw_twin.calibrate.photographs import (
    SUFFIXES,
    Footage,
    Found,
    found_in,
    in_order,
    names_in,
    natural,
    number,
    read_json,
)
from nw_twin.calibrate.report import Say
from nw_twin.calibrate.solution import Placed, Solution, check_pose, inverse, rigid
from nw_twin.calibrate.video import choose
from nw_twin.lens import Lens

SizeOf = Callable[[Path], tuple[int, int] | None]
FILE = "transforms.json"
_SPLITS = [f"transforms_{split}.json" for split in ("train", "val", "test")]
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenCV's camera axes (y down, z forward) to OpenGL's (y up, z back)."""
_FISHEYES = {"OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
"""All with k1 (and k2) before the angle's odd powers."""
_KINDS = _FISHEYES | {
    "OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL",
}  # fmt: skip
_FIX = "export transforms.json again"
_MOST_BYTES = 64 * 2**20
_MOST = 1e15
"""Of a number in an app's file: what is larger is damage, or not finite."""
_LISTED = 12
"""Fields that a note names."""
_MOST_TURN = 2.0 * math.pi + 0.01
"""Of an axis times an angle: a whole turn, rad."""
_AGAIN = "export it again, or give the photographs alone"


_FIELDS = {
    "nerfstudio": "frames applied_transform applied_scale file_path transform_matrix mask_path w h "
    "camera_model is_fisheye fl_x fl_y cx cy camera_angle_x camera_angle_y k1 k2 k3 k4 k5 k6 p1 p2",
    "polycam": "fx fy cx cy width height t_00 t_01 t_02 t_03 t_10 t_11 t_12 t_13 t_20 t_21 t_22 "
    "t_23",
    "scanner": "intrinsics cameraPoseARFrame",
    "record3d": "w h K poses perFrameIntrinsicCoeffs",
}
"""Of each kind of file, what cameras are made of."""
_PASSED = {
    "depth is measured again": "depth_file_path ply_file_path integer_depth_scale center_depth "
    "dw dh",
    "ranges of another renderer": "aabb_scale scale offset render_aabb aabb projectionMatrix",
    "splits of another trainer": "train_filenames val_filenames test_filenames",
    "frames are chosen by how far the picture moves": "sharpness blur_score neighbors timestamp "
    "time manual_keyframe frame_index motionQuality fps frameTimestamps colmap_im_id camera_id",
    "how a picture was made": "angular_velocity averageVelocity averageAngularVelocity cameraGrain "
    "exposureDuration cameraType image_name",
    "transform_matrix and poses have it": "rotation initPose orientation_override",
}
"""Fields that change nothing here, by the reason."""
_HARMLESS = frozenset(" ".join(_PASSED.values()).split())


def unused(kind: str, keys: Iterable[str], where: str) -> tuple[str, ...]:
    """Return a note of the fields that nothing is made of and that are not known to be harmless."""
    names = sorted(set(keys) - set(_FIELDS[kind].split()) - _HARMLESS)
    if not names:
        return ()
    listed = ", ".join(clean(name, at_most=40) for name in names[:_LISTED])
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return (f"nothing is made of these fields of {where}: {listed}{more}",)


def nerfstudio_in(folder: Path, size_of: SizeOf, name: str = FILE) -> Footage | None:
    """Return the cameras and photographs of a folder with transforms.json; None without one.

    The capture's frame is the one before `applied_transform`, which nerfstudio's own
    dataparser_transforms.json refers to as well.

    Args:
        folder: that holds it and the photographs.
        size_of: gives width and height of a picture file, where the JSON does not.
        name: of the file. Without a transforms.json, those of Blender's splits are read together:
            transforms_train.json, transforms_val.json, transforms_test.json.

    Raises:
        SceneError: the file is damaged or names nothing.
    """
    names = [name] if (folder / name).is_file() or name != FILE else _SPLITS
    paths = [folder / one for one in names if (folder / one).is_file()]
    alone: dict[str, Found] = {}
    poses: dict[str, Placed] = {}
    notes: list[str] = []
    for path in paths:
        for one, camera in _frames(folder, path, size_of, notes):
            alone[one.name] = one
            if camera is None:
                continue
            before = poses.setdefault(one.name, camera)
            # Twice the same is what splits into training and test write.
            if not np.array_equal(before.T_world_camera, camera.T_world_camera):
                raise SceneError(
                    f"{path} names the photograph {clean(one.name, at_most=100)} twice, with "
                    "two poses",
                    fix=_FIX,
                )
    if not paths:
        return None
    said = tuple(dict.fromkeys(notes))
    return _footage("nerfstudio", alone.values(), poses.values(), notes=said)


def _footage(kind: Any, files: Iterable[Found], placed: Iterable[Placed], **facts: Any) -> Footage:
    cameras = Solution(placed=tuple(placed))
    return Footage(kind=kind, files=in_order(files), cameras=cameras, **facts)


def _frames(
    folder: Path, path: Path, size_of: SizeOf, notes: list[str]
) -> Iterator[tuple[Found, Placed | None]]:
    whole = read_json(path)
    frames = whole.get("frames")
    if not isinstance(frames, list) or not frames:
        raise SceneError(f"{path} names no frames", fix=_FIX)
    applied, scale = _applied(whole, path)
    keys = set(whole).union(*(frame for frame in frames if isinstance(frame, dict)))
    notes += unused("nerfstudio", keys, path.name)
    for index, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise SceneError(f"frame {index} of {path} has no file_path", fix=_FIX)
        one = _file(folder, frame)
        whose = f"{clean(one.name, at_most=100)} in {path}"
        lens = _lens({**whole, **frame}, one, whose, size_of)
        notes += _unlike({**whole, **frame}, lens, path.name)
        if lens is None:
            yield one, None
            continue
        lens.check(whose)
        pose = _pose(frame.get("transform_matrix"), f"transform_matrix of {whose}")
        check_pose(pose, whose)
        pose[:3, 3] /= scale
        pose = rigid(inverse(applied) @ pose @ OPENGL, whose)
        yield one, Placed(name=one.name, lens=lens, T_world_camera=pose)


def _file(folder: Path, frame: dict[str, Any]) -> Found:
    """Return a frame's photograph: where file_path says, else as the end of that path says.

    Instant-NGP writes paths from where it was started, or from the root of another computer.
    """
    name = frame["file_path"].replace("\\", "/").removeprefix("./")
    parts = PurePosixPath(name).parts
    endings = ("",) if Path(name).suffix else (".png", *sorted(SUFFIXES))  # Blender writes none.
    tails = ("/".join(parts[first:]) + end for first in range(len(parts)) for end in endings)
    name = next((one for one in tails if _is_file(folder, one)), name + endings[0])
    photograph = found_in(folder, name)
    mask = frame.get("mask_path")
    if not isinstance(mask, str):
        return photograph
    try:
        return replace(photograph, mask=inside(folder, mask))
    except OutsideError as error:
        raise SceneError(f"the mask {mask} is not in {folder}: {error}", fix=_FIX) from None


def _is_file(folder: Path, name: str) -> bool:
    path = found_in(folder, name).path
    return path is not None and path.is_file()


def _pose(value: Any, what: str) -> NDArray[np.float64]:
    """(4, 4) of a matrix that may lack its last row, which says nothing."""
    rows = len(value) if isinstance(value, list) else 0
    T = np.eye(4)
    T[:rows] = _array(value, (3 if rows == 3 else 4, 4), what)
    return T


def _array(value: Any, shape: tuple[int, int], what: str) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise SceneError(f"{what} is not a finite matrix of shape {shape}", fix=_FIX)
    return array


def _applied(whole: dict[str, Any], file: Path) -> tuple[NDArray[np.float64], float]:
    """Return `applied_transform` (4, 4) and `applied_scale`, which came after it."""
    applied = np.eye(4)
    if "applied_transform" in whole:
        applied[:3] = _pose(whole["applied_transform"], f"applied_transform of {file}")[:3]
    scale = number(whole.get("applied_scale", 1.0), f"applied_scale of {file}")
    if not SCALES[0] <= scale <= SCALES[1]:
        raise SceneError(f"applied_scale of {file} is {scale:g}", fix=_FIX)
    return rigid(applied, f"applied_transform of {file}"), scale


def _angle(values: dict[str, Any], key: str, whose: str) -> float:
    angle = number(values.get(key), f"{key} of {whose}")
    if not 0.001 < angle < math.pi:
        raise SceneError(f"{key} of {whose} is {angle:g}, no angle of view in rad", fix=_FIX)
    return angle


def _lens(values: dict[str, Any], one: Found, whose: str, size_of: SizeOf) -> Lens | None:
    """Return a frame's lens; None if its size must be looked up and its picture cannot be read."""

    def value(key: str, otherwise: float | None = None) -> float:
        if values.get(key) is None and otherwise is not None:
            return otherwise
        return number(values.get(key), f"{key} of {whose}")

    if values.get("w") is not None and values.get("h") is not None:
        width, height = round(value("w")), round(value("h"))
    else:
        size = size_of(one.path) if one.path is not None else None
        if size is None:
            return None
        width, height = size
    if values.get("fl_x") is not None:
        fx = value("fl_x")
        fy = value("fl_y", fx)
    elif values.get("camera_angle_x") is not None:
        fx = 0.5 * width / math.tan(0.5 * _angle(values, "camera_angle_x", whose))
        fy = fx  # Blender's pixels are square, and it writes one angle.
        if values.get("camera_angle_y") is not None:
            fy = 0.5 * height / math.tan(0.5 * _angle(values, "camera_angle_y", whose))
    else:
        raise SceneError(f"{whose} has neither fl_x nor camera_angle_x", fix=_FIX)
    pinhole = (fx, fy, value("cx", 0.5 * width), value("cy", 0.5 * height))
    bends = {key: value(key, 0.0) for key in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")}
    kind = values.get("camera_model") or "OPENCV"
    kind = "OPENCV_FISHEYE" if values.get("is_fisheye") is True else kind
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SceneError(
            f"{whose} has the camera_model {clean(repr(kind), at_most=60)}",
            fix="undistort it with `colmap image_undistorter`, or give the photographs alone",
        )
    model, bent = _model(kind in _FISHEYES, **bends)
    return Lens(model=model, width=width, height=height, params=(*pinhole, *bent))


def _unlike(values: dict[str, Any], lens: Lens | None, where: str) -> Iterator[str]:
    """Yield what a frame says twice, in two ways, or of a lens that has no such number."""
    if lens is None:
        return
    angle = values.get("camera_angle_x")
    if values.get("fl_x") is not None and isinstance(angle, int | float) and 0 < angle < math.pi:
        other = 0.5 * lens.width / math.tan(0.5 * angle)
        if abs(other / lens.params[0] - 1.0) > _SAME_FOCAL:
            yield (
                f"{where} has fl_x {lens.params[0]:.5g}, and by camera_angle_x {other:.5g}: "
                "fl_x is used"
            )
    if lens.model == "OPENCV_FISHEYE":
        lost = [key for key in ("k5", "k6", "p1", "p2") if values.get(key)]
        if lost:
            yield f"nothing is made of {', '.join(lost)} of {where}: its lens is a fisheye"


_SAME_FOCAL = 0.01
"""Relative difference of focal lengths that are one."""


def _model(
    fisheye: bool,
    *,
    k1: float,
    k2: float,
    k3: float,
    k4: float,
    k5: float,
    k6: float,
    p1: float,
    p2: float,
) -> tuple[str, tuple[float, ...]]:
    """Return COLMAP's model that bends so, and its parameters after those of a pinhole."""
    if fisheye:
        return "OPENCV_FISHEYE", (k1, k2, k3, k4)
    if k3 or k4 or k5 or k6:  # nerfstudio undistorts by OpenCV's rational model, k4 below the line.
        return "FULL_OPENCV", (k1, k2, p1, p2, k3, k4, k5, k6)
    if k1 or k2 or p1 or p2:
        return "OPENCV", (k1, k2, p1, p2)
    return "PINHOLE", ()


_KEYFRAMES = tuple(
    (f"{base}{corrected}images", f"{base}{corrected}cameras")
    for base in ("keyframes/", "")
    for corrected in ("corrected_", "")
)
"""Polycam corrects poses when it closes loops; those come first."""


def keyframes_in(folder: Path, working: Path, size_of: SizeOf) -> Footage | None:
    """Return the cameras and photographs of Polycam or 3D Scanner App; None if it is neither.

    Args:
        folder: that may be an export.
        working: gets masks of the black margins that Polycam's corrected pictures have.
        size_of: gives width and height of a picture file.

    Raises:
        SceneError: a camera's file is damaged.
    """
    for images, cameras in _KEYFRAMES:
        beside = _pictures(folder / images), folder / cameras
        if beside[0] and next(beside[1].glob("*.json"), None):
            footage = _beside("polycam", *beside, lambda values, _, whose: _polycam(values, whose))
            if not images.endswith("corrected_images"):
                return footage
            files = tuple(_without_margin(one, working, size_of) for one in footage.files)
            return replace(footage, files=files)
    frames = [path for path in _pictures(folder) if path.stem.startswith("frame_")]
    known = (path for one in frames if (path := one.with_suffix(".json")).is_file())
    first = next(known, None)
    if first is None or "cameraPoseARFrame" not in read_json(first):
        return None

    def scanner(values: dict[str, Any], one: Found, whose: str) -> tuple[Lens, NDArray[np.float64]]:
        K = _flat(values, "intrinsics", 9, whose)
        width, height = (one.path and size_of(one.path)) or (2 * K[2], 2 * K[5])
        if not (0.3 * width < K[2] < 0.7 * width and 0.3 * height < K[5] < 0.7 * height):
            raise SceneError(
                f"{whose} has its centre at ({K[2]:.0f}, {K[5]:.0f}), and the picture "
                f"{width} x {height} pixels",
                fix="export All Data again, with pictures in full size",
            )
        pose = _flat(values, "cameraPoseARFrame", 16, whose).reshape(4, 4)
        return _pinhole(width, height, K[[0, 4, 2, 5]]), pose

    return _beside("arkit", frames, folder, scanner)


def _pictures(folder: Path) -> list[Path]:
    return [folder / name for name in sorted(names_in(folder, SUFFIXES), key=natural)]


def _beside(
    kind: str,
    pictures: list[Path],
    cameras: Path,
    read: Callable[[dict[str, Any], Found, str], tuple[Lens, NDArray[np.float64]]],
) -> Footage:
    """Return photographs, each of which has a JSON of its camera in a folder."""
    files: list[Found] = []
    placed: list[Placed] = []
    keys: set[str] = set()
    for picture in pictures:
        path = found_in(cameras, f"{picture.stem}.json").path
        if path is None or not path.is_file():
            fault = f"{cameras.name} has no {picture.stem}.json"
            files.append(Found(name=picture.name, path=None, fault=fault))
            continue
        files.append(found_in(picture.parent, picture.name))
        values = read_json(path)
        keys |= values.keys()
        lens, pose = read(values, files[-1], str(path))
        lens.check(str(path))
        pose = rigid(pose @ OPENGL, str(path))
        placed.append(Placed(name=picture.name, lens=lens, T_world_camera=pose))
    if not placed:
        raise SceneError(
            f"no photograph in {pictures[0].parent} has its camera in {cameras}", fix=_AGAIN
        )
    notes = unused("scanner" if kind == "arkit" else kind, keys, f"{cameras.name}/*.json")
    return _footage(kind, files, placed, metric=True, up=(0.0, 1.0, 0.0), notes=notes)


def _polycam(values: dict[str, Any], whose: str) -> tuple[Lens, NDArray[np.float64]]:
    def value(key: str) -> float:
        return number(values.get(key), f"{key} of {whose}")

    T = np.eye(4)
    T[:3] = [[value(f"t_{row}{column}") for column in range(4)] for row in range(3)]
    params = [value(key) for key in ("fx", "fy", "cx", "cy")]
    return _pinhole(value("width"), value("height"), params), T


def _pinhole(width: float, height: float, params: Iterable[float]) -> Lens:
    size = {"width": round(width), "height": round(height)}
    return Lens(model="PINHOLE", params=tuple(map(float, params)), **size)


def _flat(values: dict[str, Any], key: str, count: int, whose: str) -> NDArray[np.float64]:
    """Return so many finite numbers, whether they were written in a list or in lists of one."""
    try:
        array = np.array(values.get(key), dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.shape != (count,) or not (np.abs(array) < _MOST).all():
        raise SceneError(f"{key} of {whose} is not {count} finite numbers", fix=_AGAIN)
    return array


_MARGIN = 0.02
"""Of the shorter side, that nerfstudio cuts off Polycam's corrected pictures as well."""


def _without_margin(one: Found, working: Path, size_of: SizeOf) -> Found:
    """Return a photograph with a mask that leaves out what undistorting left black."""
    size = None if one.path is None else size_of(one.path)
    if size is None:
        return one
    path = working / "margins" / f"{size[0]}x{size[1]}.png"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        edge = max(1, round(_MARGIN * min(size)))
        mask = np.zeros(size[::-1], np.uint8)
        mask[edge:-edge, edge:-edge] = 255
        Image.fromarray(mask).save(path)
    return replace(one, mask=path)


def record3d_in(folder: Path, frames: int, say: Say) -> Footage | None:
    """Return the cameras and photographs of an unpacked Record3D file; None for other folders.

    Args:
        folder: that may be one.
        frames: that are taken, at most, some way apart.
        say: is told how many are.

    Raises:
        SceneError: metadata is damaged, or its poses are all the same.
    """
    pictures = _pictures(folder / "rgbd") or _pictures(folder / "rgb")
    path = folder / ("metadata" if (folder / "metadata").is_file() else "metadata.json")
    if not path.is_file() or not pictures:
        return None
    whole = read_json(path)
    if not {"poses", "K"} <= whole.keys():
        return None
    poses = whole["poses"] if isinstance(whole["poses"], list) else []
    rows = _flat(whole, "K", 9, str(path)).reshape(3, 3)
    K = rows.T if rows[2, 0] else rows  # In columns, unless somebody else wrote it.
    lenses = whole.get("perFrameIntrinsicCoeffs")
    lenses = lenses if isinstance(lenses, list) and len(lenses) == len(poses) else None
    size = [number(whole.get(key), f"{key} of {path}") for key in ("w", "h")]
    files: list[Found] = []
    placed: list[Placed] = []
    for picture in pictures:
        place = int(picture.stem) if picture.stem.isdecimal() and len(picture.stem) < 9 else -1
        if not 0 <= place < len(poses):
            fault = f"{path.name} has no pose for it"
            files.append(Found(name=picture.name, path=None, fault=fault))
            continue
        whose = f"{picture.name} in {path}"
        params = K[[0, 1, 0, 1], [0, 1, 2, 2]]
        if lenses is not None:
            params = _flat({"intrinsics": lenses[place]}, "intrinsics", 4, whose)
        seven = _flat({"pose": poses[place]}, "pose", 7, whose)
        T = pose_of(seven[[3, 0, 1, 2]], seven[4:], whose)
        files.append(found_in(picture.parent, picture.name))
        lens = _pinhole(size[0], size[1], params)
        lens.check(whose)
        placed.append(Placed(name=picture.name, lens=lens, T_world_camera=T @ OPENGL))
    if len(placed) > 1 and not np.ptp([one.T_world_camera for one in placed], axis=0).any():
        raise SceneError(
            f"all poses in {path} are the same: selfie cameras and old recordings have none",
            fix=f"give {pictures[0].parent} alone; its cameras are then computed",
        )
    notes = unused("record3d", whole, path.name)
    return _some("record3d", files, placed, frames, say, metric=True, notes=notes)


def _some(
    kind: str, files: list[Found], placed: list[Placed], frames: int, say: Say, **facts: Any
) -> Footage:
    """Return frames of a film whose cameras are known, as far apart as the picture moved."""
    before = placed[:1] + placed[:-1]
    moved = [_share(one, other) for one, other in zip(before, placed, strict=True)]
    some = choose(np.array(moved), np.ones(len(placed)), frames) if placed else []
    names = {placed[place].name for place in some}
    if len(some) < len(placed):
        say(f"{len(some)} of {plural(len(placed), 'frame')} are taken, some way apart")
    kept = [one for one in files if one.name in names or one.path is None]
    return _footage(kind, kept, [placed[place] for place in some], is_film=True, **facts)


def _share(one: Placed, other: Placed) -> float:
    """Return about which share of its width a picture of what is 2 m away moves, at most 1."""
    there = inverse(one.T_world_camera) @ other.T_world_camera
    turn = math.acos(np.clip((np.trace(there[:3, :3]) - 1) / 2, -1, 1))
    move = float(np.linalg.norm(there[:3, 3])) / 2
    return min(1.0, (turn + move) * one.lens.params[0] / max(1, one.lens.width))


_SAME_TIME = 0.005
"""Seconds between a picture and its pose, as ARKitScenes' own loader has it."""


def arkit_scenes_in(folder: Path, frames: int, say: Say) -> Footage | None:
    """Return the cameras and photographs of a scene of ARKitScenes; None for other folders.

    Args:
        folder: that may be one.
        frames: that are taken, at most, some way apart.
        say: is told how many are, and how many have no pose.

    Raises:
        SceneError: a file is damaged, or no picture has a pose and a lens.
    """
    path = folder / "lowres_wide.traj"
    kinds = ("wide", "vga_wide", "lowres_wide")
    pictures = next((p for kind in kinds if (p := _pictures(folder / kind))), [])
    if not path.is_file() or not pictures:
        return None
    poses = {row[0]: row[1:] for row in _rows(path, 7)}
    intrinsics = folder / f"{pictures[0].parent.name}_intrinsics"
    lenses = {_time(one): one for one in intrinsics.glob("*.pincam")}
    files: list[Found] = []
    placed: list[Placed] = []
    for picture in pictures:
        pose, lens = (_at(_time(picture), times) for times in (poses, lenses))
        if pose is None or lens is None:
            continue
        row, *others = _rows(lens, 6)
        if others:
            raise SceneError(f"{lens} has {len(others) + 1} rows, and is of one lens", fix=_AGAIN)
        turn = float(np.linalg.norm(pose[:3]))
        wxyz = np.r_[math.cos(turn / 2), np.sinc(turn / (2 * math.pi)) / 2 * pose[:3]]
        whose = f"{picture.name} in {path}"
        if turn > _MOST_TURN:
            raise SceneError(f"the pose of {whose} is turned by {turn:g} rad", fix=_AGAIN)
        T = inverse(pose_of(wxyz, pose[3:], whose))
        files.append(found_in(picture.parent, picture.name))
        seen_by = _pinhole(row[0], row[1], row[2:])
        seen_by.check(str(lens))
        placed.append(Placed(name=picture.name, lens=seen_by, T_world_camera=T))
    if not placed:
        raise SceneError(
            f"no picture in {pictures[0].parent} has a pose in {path.name} and a lens in "
            f"{intrinsics.name} of its time",
            fix="fetch all three of the scene, or give the photographs alone",
        )
    if len(placed) < len(pictures):
        say(f"{len(pictures) - len(placed)} of {len(pictures)} pictures have no pose of their time")
    return _some("arkit", files, placed, frames, say, metric=True, up=(0.0, 0.0, 1.0))


def _rows(path: Path, columns: int) -> NDArray[np.float64]:
    """Return rows of numbers (N, columns) of a text file.

    Raises:
        SceneError: it is none.
    """
    try:
        text = bounded_bytes(path, _MOST_BYTES).decode("ascii")
        rows = np.array([line.split() for line in text.splitlines() if line.strip()], np.float64)
        good = rows.shape[1:] == (columns,) and (np.abs(rows) < _MOST).all()
        fault = None if good else "it has others"
    except (OSError, ValueError) as error:
        rows, fault = np.zeros((0, columns)), str(error)
    if fault is not None:
        raise SceneError(f"{path} is not rows of {columns} finite numbers: {fault}", fix=_AGAIN)
    return rows


def _time(path: Path) -> float:
    """Return the seconds that the end of a name like 41069021_12.345.png says; NaN without."""
    try:
        return float(path.stem.rsplit("_", 1)[-1])
    except ValueError:
        return math.nan


def _at(time: float, values: dict[float, Any]) -> Any:
    """Return the value of the nearest time, None if none is near."""
    nearest = min(values, key=lambda one: abs(one - time), default=math.nan)
    return values[nearest] if abs(nearest - time) <= _SAME_TIME else None
