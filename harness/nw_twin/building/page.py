"""The page of a build: six pictures and a table of what is known, and how well.

It says nothing that the files of a build do not: it is for people, who see in a second that a floor
is missing, or that up is not up.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from nw_base.files.cache import atomic_path
from nw_base.plural import plural
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.tables.table import Table
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.rays import RayScene
from nw_scenes.robots import get_robot
from nw_sim.survey.course import CAMERA, camera_poses, course_samples, stance_of
from nw_splat.camera import Camera
from nw_splat.files import read_splat
from nw_twin.align.alignment import Alignment, read_alignment
from nw_twin.building.unlike import seen_depths, shown_ground
from nw_twin.capture import Capture, PlacedShot, read_capture, read_picture
from nw_twin.gaussians.images import rays_of
from nw_twin.gaussians.rasteriser import Rasteriser
from nw_twin.place import moved_camera, moved_points
from nw_twin.reconstruct.depth import read_depth
from nw_twin.reconstruct.surface import ColourMesh, read_colour_mesh

if TYPE_CHECKING:
    from nw_scenes import Scene
    from nw_scenes.finding import SceneFinding
    from nw_sim.survey import Survey
    from nw_twin.building.folder import BuildFolder

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_LONGEST = 480
"""Pixels of a picture's longer side."""
_QUALITY = 85
"""Of JPEG."""
_RED = np.array([214.0, 39.0, 40.0])
"""What is not known."""
_COURSE, _CAMERAS = (27, 108, 168), (90, 90, 90)
_EVERY = 0.25
"""m between two points of the course that a photograph may show."""
_FAR = 8.0
"""m beyond which a photograph shows nothing of a course to a reader."""
_MARGIN = 2.0
"""m around the course that the view from above has at least."""
_OVER = 0.2
"""m above the highest camera from which one looks down: below most ceilings."""
_MOST = 1e6
"""Of a number of a report; what is larger, or no number, is damaged."""
_LIGHT = np.array([0.3, 0.2, 0.93])
"""Where light comes from, of about unit length."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A picture of the page.

    Attributes:
        title: what it is.
        caption: what to look at.
        jpeg: its file.
        width: pixels.
        height: pixels.
    """

    title: str
    caption: str
    jpeg: bytes
    width: int
    height: int

    @classmethod
    def of(cls, title: str, caption: str, picture: Image.Image) -> Figure:
        """Return one of a picture of any size."""
        picture = picture.convert("RGB")
        picture.thumbnail((_LONGEST, _LONGEST))
        stream = io.BytesIO()
        picture.save(stream, format="JPEG", quality=_QUALITY)
        width, height = picture.size
        return cls(title=title, caption=caption, jpeg=stream.getvalue(), width=width, height=height)


def write_page(
    folder: BuildFolder,
    scene: Scene,
    robot: str,
    findings: Sequence[SceneFinding],
    survey: Survey | None,
) -> None:
    """Write the page of a build; the same results give the same bytes.

    Args:
        folder: of the build, with capture, mesh, splat and alignment.
        scene: that was made.
        robot: whose eye looks.
        findings: of its check.
        survey: along its course; None where it could not be made.

    Raises:
        SceneError: what a stage has left is damaged or was removed.
        StoreError: the page cannot be written.
    """
    capture, alignment = read_capture(folder.capture), read_alignment(folder.align)
    text = render(
        "figures.html.j2",
        title=f"{scene.name}: a twin of {plural(len(capture.shots), 'photograph')}",
        lead=_lead(alignment, findings),
        figures=_figures(folder, scene, capture, robot),
        tables=(
            _known(folder, scene, capture, alignment, survey),
            Table(
                title="Findings of the check",
                columns=("finding", "what", "fix"),
                rows=tuple((f"{f.severity}: {f.code}", f.message, f.fix or "") for f in findings),
            ),
        ),
    )
    with atomic_path(folder.page) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _lead(alignment: Alignment, findings: Sequence[SceneFinding]) -> list[str]:
    errors = sum(finding.severity == "error" for finding in findings)
    said = [
        f"The check found {plural(errors, 'error')}: the scene does not run until that is fixed."
        if errors
        else "The check found no error."
    ]
    if not alignment.is_to_scale:
        said.append("The scale is not known: the scene is in a unit of its own.")
    return [*said, *(f"Warning: {warning}." for warning in alignment.warnings)]


def _figures(folder: BuildFolder, scene: Scene, capture: Capture, robot: str) -> list[Figure]:
    T = scene.T_world_splat
    of_ground = folder.path / "ground.ply"
    mesh = read_colour_mesh(of_ground if of_ground.is_file() else folder.mesh / "mesh.ply")
    drawn = _DrawnMesh(mesh, T)
    splat = read_splat(folder.splat / "splat.ply")
    line = np.array([scene.spawn.position, *scene.trail])
    samples, spec = course_samples(scene, _EVERY), get_robot(robot)
    shot = _shot_of(capture, T, samples.points)
    photograph = Image.fromarray(read_picture(shot, folder.capture))
    small = _smaller(shot.camera)
    seen = drawn.seen_by(moved_camera(T, small))
    lens = spec.cameras[CAMERA].lens(_LONGEST, _LONGEST * 9 // 16)
    own = Camera.of(lens, camera_poses(samples, drawn.rays, stance_of(spec))[0])
    eye = moved_camera(np.asarray(np.linalg.inv(T), dtype=np.float64), own)
    rasteriser = Rasteriser(
        antialiased=splat.rasterize_mode != "classic", projection=splat.projection or "ray"
    )

    def splat_of(camera: Camera) -> Image.Image:
        return _image(255.0 * np.moveaxis(rasteriser.render(splat, camera).rgb, 0, -1))

    depth, _ = read_depth(folder.mesh / "depth", shot.name)
    return [
        Figure.of("A photograph", f"{shot.name}, which shows most of the course.", photograph),
        Figure.of("The splat from there", "What a camera of a trial sees.", splat_of(small)),
        Figure.of(
            "The mesh from there",
            "What feet and rays meet. White is open: sky, or nothing was measured.",
            _image(seen),
        ),
        Figure.of(
            "What is not known",
            f"Red pixels of the photograph have no depth: {np.mean(depth == 0.0):.0%} of it.",
            _unknown(photograph, depth),
        ),
        Figure.of(
            "The splat from the robot's eye",
            f"At the start, as the camera of {robot.rpartition('/')[2]} sees it.",
            splat_of(eye),
        ),
        Figure.of(
            "From above",
            "The course in blue, from its start, and where the cameras were in grey. Red ground is "
            "in the mesh, but no photograph shows it.",
            _from_above(drawn, folder, capture, T, line),
        ),
    ]


class _DrawnMesh:
    """A mesh in the world that is looked at: its colours, shaded by a light from above."""

    def __init__(self, mesh: ColourMesh, T: F64) -> None:
        vertices = moved_points(T, mesh.vertices)
        kinds = np.full(len(mesh.faces), FACE_KINDS.index("ground"), np.uint8)
        self.mesh = TriangleMesh(vertices=vertices, faces=mesh.faces, kinds=kinds)
        self.rays = RayScene(self.mesh)
        corners = self.mesh.triangles
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
        light = 0.65 + 0.35 * np.abs(normals @ _LIGHT) / lengths
        colours = mesh.colours[mesh.faces].astype(np.float64).mean(axis=1) * light[:, None]
        self._colours = np.vstack([colours, [255.0, 255.0, 255.0]])  # The last is of a miss.

    def looked_at(self, origins: F64, ways: F64) -> tuple[F64, F64]:
        """Return colours (N, 3), 0 to 255, and distances (N,) along rays."""
        distance, face = self.rays.cast(origins, ways)
        return self._colours[face], distance

    def seen_by(self, camera: Camera) -> F64:
        """Return the picture (H, W, 3) of a camera in the world, 0 to 255."""
        ways = rays_of(camera).reshape(-1, 3)
        colours, _ = self.looked_at(camera.T_world_camera[:3, 3], ways)
        return colours.reshape(camera.height, camera.width, 3)


def _shot_of(capture: Capture, T: F64, places: F64) -> PlacedShot:
    """Return the shot in which most of a course lies, the nearest of those that show as much.

    Args:
        capture: with the shots.
        T: (4, 4) from its frame to the world.
        places: (N, 3) along the course, world, m.
    """

    def shown(shot: PlacedShot) -> tuple[int, float]:
        camera = moved_camera(T, shot.camera)
        x, y, z = moved_points(camera.T_camera_world, places).T
        scale = np.linalg.norm(camera.T_world_camera[:3, 0])
        ahead = (z > 0.0) & (z * scale < _FAR)
        z = np.where(ahead, z, 1.0)
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = ahead & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
        away = np.linalg.norm(places - camera.T_world_camera[:3, 3], axis=1).min()
        return int(inside.sum()), -float(away)

    return max(capture.shots, key=shown)


def _smaller(camera: Camera) -> Camera:
    scale = min(1.0, _LONGEST / max(camera.width, camera.height))
    size = round(camera.width * scale), round(camera.height * scale)
    return Camera.of(camera.lens.resized(*size), camera.T_world_camera)


def _unknown(photograph: Image.Image, depth: NDArray[np.floating]) -> Image.Image:
    """Return a photograph with the pixels in red that have no depth."""
    pixels = np.asarray(photograph, dtype=np.float64)
    none = Image.fromarray(np.where(depth == 0.0, 255, 0).astype(np.uint8))
    share = np.asarray(none.resize(photograph.size, Image.Resampling.NEAREST)) / 255.0 * 0.6
    return _image(pixels + share[..., None] * (_RED - pixels))


def _from_above(
    drawn: _DrawnMesh, folder: BuildFolder, capture: Capture, T: F64, line: F64
) -> Image.Image:
    """Return the mesh from above with course and cameras, ground that nothing shows in red."""
    centres = moved_points(T, capture.centres)
    low, high = line[:, :2].min(axis=0), line[:, :2].max(axis=0)
    # At least half as wide as it is long: a straight course would else be a thin strip.
    half = np.maximum((high - low) / 2.0 + _MARGIN, ((high - low).max() / 2.0 + _MARGIN) / 2.0)
    low, high = (low + high) / 2.0 - half, (low + high) / 2.0 + half
    cell = float((high - low).max()) / _LONGEST
    columns, rows = np.maximum(1, np.ceil((high - low) / cell).astype(int))
    y, x = np.mgrid[:rows, :columns]
    places = np.column_stack(
        [low[0] + (x.ravel() + 0.5) * cell, high[1] - (y.ravel() + 0.5) * cell]
    )
    top = max(float(centres[:, 2].max()), float(line[:, 2].max())) + _OVER
    origins = np.column_stack([places, np.full(len(places), top)])
    down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    colours, distance = drawn.looked_at(origins, down)
    shown = shown_ground(drawn.mesh, seen_depths(capture, T, folder.mesh / "depth"))
    unseen = np.isfinite(distance) & ~shown(places)
    colours = np.where(unseen[:, None], 0.5 * colours + 0.5 * _RED, colours)
    picture = _image(colours.reshape(rows, columns, 3))
    pen = ImageDraw.Draw(picture)

    def at(place: F64) -> tuple[float, float]:
        return float((place[0] - low[0]) / cell), float((high[1] - place[1]) / cell)

    for centre in centres:
        u, v = at(centre)
        pen.ellipse((u - 2, v - 2, u + 2, v + 2), fill=_CAMERAS)
    pen.line([at(place) for place in line], fill=_COURSE, width=3)
    for number, place in enumerate(line):
        u, v = at(place)
        pen.ellipse((u - 5, v - 5, u + 5, v + 5), fill=None if number else _COURSE, outline=_COURSE)
    return picture


def _image(values: NDArray[np.floating]) -> Image.Image:
    return Image.fromarray(np.clip(values, 0.0, 255.0).round().astype(np.uint8))


def _known(
    folder: BuildFolder,
    scene: Scene,
    capture: Capture,
    alignment: Alignment,
    survey: Survey | None,
) -> Table:
    """Return what is known and how well, a line a thing."""
    calibrated, mesh, splat = (
        _facts(path / "report.json") for path in (folder.capture, folder.mesh, folder.splat)
    )
    rows = [
        (
            "photographs",
            f"{len(capture.shots)} placed of {calibrated.get('photographs', len(capture.shots))}",
            _number(
                calibrated, "reprojection_error", "points {:.2f} pixels from where they belong"
            ),
        ),
        (
            "up",
            ""
            if alignment.up_uncertain is None
            else f"within {alignment.up_uncertain:.1f} degrees",
            "; ".join(f"{cue.name} {cue.degrees:.1f} degrees off" for cue in alignment.gravity),
        ),
        (
            "scale",
            "not known" if not alignment.is_to_scale else _within(alignment.scale_uncertain),
            "; ".join(f"{cue.name} {cue.difference:+.1%}" for cue in alignment.scales),
        ),
        (
            "depth",
            _number(mesh, "coverage", "{:.0%} of the pixels"),
            "the others show sky, plain surfaces, or what too few photographs share",
        ),
        (
            "splat",
            _number(splat, "psnr", "{:.1f} dB"),
            _compared(splat.get("views")),
        ),
        ("course", *_course(scene, survey, "m" if alignment.is_to_scale else "units")),
    ]
    return Table(
        title="What is known, and how well",
        columns=("what", "result", "evidence and doubts"),
        rows=tuple(rows),
        foot="An angle or a share within which something lies holds with 95 %.",
    )


def _compared(views: object) -> str:
    if not isinstance(views, list) or not views:
        return "no photograph was kept to compare with"
    return f"on {plural(len(views), 'photograph')} that it did not learn from"


def _within(share: float | None) -> str:
    return "" if share is None else f"within {share:.1%}"


def _course(scene: Scene, survey: Survey | None, unit: str) -> tuple[str, str]:
    line = np.array([scene.spawn.position, *scene.trail])
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    result = f"{length:.1f} {unit}, {plural(len(scene.trail), 'waypoint')}"
    if survey is None:
        return result, "not surveyed"
    footing = survey.ground.footing
    return result, (
        f"mesh and physics agree on {survey.ground.sound:.0%} of it; steps of at most "
        f"{np.nanmax(footing.step, initial=0.0):.2f} m"
    )


def _facts(path: Path) -> dict[str, Any]:
    """Return what a stage's report says; nothing where it is gone."""
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _number(facts: dict[str, Any], key: str, form: str) -> str:
    value = facts.get(key)
    return form.format(value) if isinstance(value, int | float) and abs(value) < _MOST else ""
