"""`nw-eval scenes import` and `level`: a scene folder of a scan, and its floor laid level."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from nw_base.clean import clean

if TYPE_CHECKING:
    from nw_twin.scans.scan import WrittenScan


@dataclass(frozen=True, kw_only=True)
class ImportScan:
    """Build a scene folder from a scan: a mesh, a point cloud, a splat, or an elevation map.

    Meshes are GLB, USDZ, OBJ, PLY or STL, point clouds PLY, LAS, LAZ or E57, splats PLY, SPZ or
    SOG, elevation maps PNG or GeoTIFF.
    The scene is in metres with z up, and the ground under the start is at z = 0. Colours become
    Gaussians for camera images. A suite is written beside the scene. The scene is checked as by
    `scenes check`; exit code 2 if it is not ready.
    """

    scan: tyro.conf.Positional[Path]
    """The mesh, the point cloud or the elevation map."""
    out: Path
    """The scene's folder, which must not exist."""
    unit: Literal["auto", "m", "cm", "mm", "ft", "in"] = "auto"
    """Unit of the mesh. auto uses the unit in the file's comments or of its stage, else m."""
    up: Literal["auto", "+x", "-x", "+y", "-y", "+z", "-z"] = "auto"
    """Up axis of the file. auto weighs the axes of the format, planes and what stands in rooms."""
    splat: Path | None = None
    """Gaussians of the same scene, exported by the same app: PLY, SPZ, SOG (default: made from the
    mesh's colours)."""
    splat_transform: Path | None = None
    """A text file with the 4 x 4 matrix from splat to mesh coordinates (default: found among
    right-angle rotations)."""
    gaussians: int = 200_000
    """Gaussians made from the mesh's colours. At most N."""
    cell: float | None = None
    """Pixel width of an elevation map, m. A GeoTIFF has it."""
    white: float | None = None
    """Height of white in a PNG, m."""
    black: float = 0.0
    """Height of black in a PNG, m."""
    no_data: float | None = None
    """Value of elevation-map pixels without ground. A GeoTIFF may have it."""
    trail: tuple[str, ...] = ()
    """The start and the waypoints, X,Y or X,Y,Z in scene metres (default: proposed)."""
    task: Literal["hurdles", "gaps", "ramps", "stairs", "open"] | None = None
    """The course's kind of obstacle (default: open)."""
    name: str | None = None
    """The scene's name (default: its folder's)."""
    licence: str = "not stated"
    """Licence of the scan: an SPDX identifier, or words."""
    robot: str = "go1"
    """The robot of the scene's suite."""

    def __call__(self) -> int:
        from nw_base.errors import SceneError
        from nw_twin.scans.scan import ScanOptions, import_scan

        options = ScanOptions(
            unit=self.unit,
            up=self.up,
            splat=self.splat,
            splat_transform=self.splat_transform,
            gaussians=self.gaussians,
            cell=self.cell,
            white=self.white,
            black=self.black,
            no_data=self.no_data,
            trail=points_of("--trail", self.trail, (2, 3)) or None,
            task=self.task,
            name=self.name,
            licence=self.licence,
            robot=self.robot,
        )
        written = import_scan(self.scan, self.out, options)
        print(scan_lines(written))
        return 0 if written.fault is None else SceneError.exit_code


@dataclass(frozen=True, kw_only=True)
class LevelScene:
    """Level the floor of a scene's mesh, turn it upside down, or scale it.

    Mesh, splat, course, start and cameras are transformed together, so the scene gets a new digest
    and new initial states. scene.yaml is rewritten; its old files stay.
    """

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    floor: tuple[str, ...] = ()
    """Three points X,Y,Z of the present floor; they become z = 0."""
    flip: bool = False
    """Turn the floor upside down."""
    unit: Literal["m", "cm", "mm", "ft", "in"] = "m"
    """Present unit of the mesh and of --floor."""
    trail: tuple[str, ...] = ()
    """The start and the waypoints, X,Y or X,Y,Z in m, after levelling (default: transform the
    present ones)."""
    propose: bool = False
    """Propose a straight course over even ground, as `scenes import` does."""
    out: Path | None = None
    """Write a copy to this new folder and keep the scene as it is."""

    def __call__(self) -> int:
        from nw_base.errors import SceneError
        from nw_twin.scans.levelling import level_scene

        written = level_scene(
            self.scene,
            floor=points_of("--floor", self.floor, (3,)),
            flip=self.flip,
            unit=self.unit,
            trail=points_of("--trail", self.trail, (2, 3)) or None,
            propose=self.propose,
            out=self.out,
        )
        print(scan_lines(written))
        return 0 if written.fault is None else SceneError.exit_code


_FARTHEST = 1e7  # of a number: 10 km in mm, and far below what float32 holds


def points_of(
    option: str, words: Sequence[str], sizes: tuple[int, ...]
) -> tuple[tuple[float, ...], ...]:
    """Return points that are written X,Y or X,Y,Z.

    Raises:
        UsageError: a word is not a point of one of these sizes.
    """
    from math import isfinite

    from nw_base.errors import UsageError

    points: list[tuple[float, ...]] = []
    for word in words:
        try:
            point = tuple(float(part) for part in word.split(","))
        except ValueError:
            point = ()
        if len(point) not in sizes or not all(isfinite(part) for part in point):
            form = " or ".join(",".join("XYZ"[:size]) for size in sizes)
            raise UsageError(
                f"{option} {clean(word, at_most=60)}: no point {form}",
                fix=f"give numbers with commas and no spaces between, such as {option} "
                + " ".join(",".join("1.5" for _ in range(sizes[0])) for _ in range(2)),
            )
        if any(abs(part) > _FARTHEST for part in point):
            raise UsageError(
                f"{option} {clean(word, at_most=60)}: a number over {_FARTHEST:g}",
                fix="give lengths from the mesh's own origin",
            )
        points.append(point)
    return tuple(points)


def scan_lines(written: WrittenScan) -> str:
    """Return the steps of an import, the scene's digest, and the next command."""
    digest = f"digest {written.digest[:16]}"
    if written.before is not None:
        same = written.before == written.digest
        digest = "digest as before" if same else f"digest {written.before[:16]} -> {digest[7:]}"
    folder = shlex.quote(str(written.folder))
    path = folder if folder.startswith(("/", ".", "'")) else f"./{folder}"
    end = f"ready: nw-eval scenes check {path}"
    if written.fault is not None:
        end = f"not ready: {written.fault.replace('SCENE', path)}"
    return "\n".join([*written.lines, digest, end])
