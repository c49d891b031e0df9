"""Scene folders: `scene.yaml` beside a collision file and a splat."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, inside, what_is
from nw_base.files.yaml_file import (
    Location,
    YamlFile,
    YamlProblems,
    json_schema_of,
    read_yaml,
    validation_problems,
)
from nw_base.words import Collision, RasterizeMode, Task
from nw_scenes import limits
from nw_scenes.capture_file import Far, Quat, read_captures
from nw_scenes.finding import SceneFinding
from nw_scenes.grid import TerrainOptions
from nw_scenes.limits import checked_name
from nw_scenes.mesh import TriangleMesh, box_mesh, merge, quad_mesh, rotation_matrix
from nw_scenes.mesh_file import MESH_SUFFIXES, inspect_mesh, read_mesh
from nw_scenes.prop import Prop, PropBox, PropJoint, box_round
from nw_scenes.scene import Box, Plane, Progress, Scene, Solid, Spawn

SCENE_FILE = "scene.yaml"
_GROUND_REACH = 60.0
_NOT_TO_SCALE = "not_to_scale"
_LEAST_WIDE, _MOST_WIDE = 0.3, 2.0 * limits.REACH
# A scene this much wider than its course is told, metres and times.
_ODDLY_WIDE, _TIMES_COURSE = 200.0, 40.0
_OTHER_MESHES = (
    ".3ds", ".3mf", ".abc", ".blend", ".dae", ".fbx", ".gltf", ".off", ".step", ".stp", ".usd",
    ".usda", ".usdc", ".usdz", ".wrl", ".x3d",
)  # fmt: skip

_Read = TypeVar("_Read", bound=BaseModel)


def _line(text: str) -> str:
    return clean(text, at_most=200)


def _thick(half_size: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(half_size) < limits.LEAST_SIZE:
        raise ValueError(
            f"half_size must be positive, {limits.LEAST_SIZE:g} m at least; half of the length "
            "along each own axis"
        )
    return half_size


Length = Annotated[float, Field(ge=-limits.REACH, le=limits.REACH)]
Point = tuple[Length, Length, Length]
HalfEdge = Annotated[float, Field(le=limits.REACH)]
HalfSize = Annotated[tuple[HalfEdge, HalfEdge, HalfEdge], AfterValidator(_thick)]
Sliding = Annotated[float, Field(gt=0, le=limits.FRICTION)]
Turning = Annotated[float, Field(ge=0, le=limits.FRICTION)]
Noise = Annotated[float, Field(ge=0, le=limits.NOISE)]
Angle = Annotated[float, Field(ge=-2 * np.pi, le=2 * np.pi)]
Spread = Annotated[float, Field(ge=0, le=2 * np.pi)]
Line = Annotated[str, AfterValidator(_line)]
Share = Annotated[float, Field(ge=0, le=1)]


class _FolderModel(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True
    )


class _Box(_FolderModel):
    """One solid box; see `nw_scenes.Box`."""

    center: Point
    """x, y, z of its middle, world, m."""
    half_size: HalfSize
    """Half of its length along each of its own axes, m."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """How it is turned: w x y z, any length but 0."""
    friction: tuple[Sliding, Turning, Turning] = (1.25, 0.3, 0.3)
    """MuJoCo's sliding, torsional and rolling coefficients."""
    material: Line = ""
    """What it is made of, for people."""
    kind: Literal["obstacle", "structure", "clutter"] = "obstacle"
    """Its class in `semantics` images: an obstacle of the course, the scene itself, or clutter."""


class _Collision(_FolderModel):
    """`collision.yaml`: a scene as boxes on a ground plane."""

    boxes: tuple[_Box, ...] = Field(max_length=limits.SOLIDS)
    """The solids; the plane of the scene's `ground` is there without saying so."""


class _Spawn(_FolderModel):
    """Where the robot starts. The jitters are half widths of uniform draws, one for each trial."""

    position: Point = (0.0, 0.0, 0.0)
    """x, y, z in the world, m; z is the height of the ground there."""
    yaw: Angle = 0.0
    """Where it looks, rad; 0 = along x, positive = to the left."""
    x_jitter: Noise = 0.1
    """m."""
    y_jitter: Noise = 0.1
    """m."""
    yaw_jitter: Spread = 0.1
    """rad."""


class _Similarity(_FolderModel):
    """What maps splat points to world metres: scale, then rotation, then translation."""

    scale: float = Field(default=1.0, ge=limits.SCALES[0], le=limits.SCALES[1])
    """Metres in one unit of the splat."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """w x y z, any length but 0."""
    translation: tuple[Far, Far, Far] = (0.0, 0.0, 0.0)
    """m."""

    def matrix(self) -> NDArray[np.float64]:
        transform = np.eye(4)
        transform[:3, :3] = self.scale * rotation_matrix(self.quat)
        transform[:3, 3] = self.translation
        return transform


def _axis(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    if not np.any(np.abs(axis) > 1.0 / limits.QUAT):
        raise ValueError(f"axis is {list(axis)}, which has no direction")
    return axis


class _PropBox(_FolderModel):
    """One solid box of a prop, in the prop's own frame."""

    center: Point = (0.0, 0.0, 0.0)
    """x, y, z of its middle, m."""
    half_size: HalfSize
    """Half of its length along each of its own axes, m."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """How it is turned: w x y z, any length but 0."""


class _PropJoint(_FolderModel):
    """How a prop moves, in its own frame."""

    type: Literal["fixed", "free", "hinge", "slide"] = "free"
    """Fixed to the world, free, turning about an axis, or moving along it."""
    axis: Annotated[Point, AfterValidator(_axis)] = (0.0, 0.0, 1.0)
    """Of a hinge or a slide; any length but 0."""
    anchor: Point = (0.0, 0.0, 0.0)
    """A point on the axis of a hinge, m."""
    range: tuple[Length, Length] | None = None
    """Smallest and largest angle of a hinge, rad, or offset of a slide, m (default: no limit)."""
    damping: float = Field(default=0.0, ge=0, le=1e4)
    """N m s/rad of a hinge, N s/m of a slide."""
    friction: float = Field(default=0.0, ge=0, le=1e4)
    """What holds it at rest: N m of a hinge, N of a slide."""

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range is {list(self.range)}; give the least first")
        if self.type in {"fixed", "free"} and (keys := self.model_fields_set - {"type"}):
            key = min(keys)
            raise ValueError(
                f"a {self.type} prop has no {key!r}; remove it, or make it a hinge or a slide"
            )
        return self


class _Prop(_FolderModel):
    """One thing that moves."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,39}$")]
    """A word, which no other prop has."""
    mesh: str | None = None
    """A mesh (.obj, .ply, .stl, .glb) in metres inside the folder, in the prop's own frame."""
    color: tuple[Share, Share, Share] = (0.5, 0.5, 0.5)
    """Of the mesh: red, green, blue, 0 to 1. Its faces have the scene's light."""
    splat: str | None = None
    """A file of Gaussians inside the folder; a prop has a mesh or a splat."""
    T_prop_splat: _Similarity = _Similarity()
    """Where the splat lies in the prop's own frame."""
    boxes: tuple[_PropBox, ...] = Field(default=(), max_length=limits.PROP_BOXES)
    """Collision shapes (default: the box around the mesh). A splat needs them."""
    position: Point
    """Where its frame is at the start: x, y, z, world, m."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """How it is turned there: w x y z, any length but 0."""
    mass: float = Field(default=1.0, ge=1e-3, le=1e4)
    """kg, distributed over the boxes by volume."""
    friction: tuple[Sliding, Turning, Turning] = (1.0, 0.005, 0.0001)
    """MuJoCo's sliding, torsional and rolling coefficients; `perturb` replaces the first."""
    joint: _PropJoint = _PropJoint()
    """How it moves (default: freely)."""
    kind: Literal["obstacle", "structure", "clutter"] = "obstacle"
    """Its class in `semantics` images."""

    @model_validator(mode="after")
    def _check_looks(self) -> Self:
        if (self.mesh is None) == (self.splat is None):
            raise ValueError("give either `mesh` or `splat`")
        if self.mesh is None and not self.boxes:
            raise ValueError("a prop with a splat needs `boxes`, which collide")
        return self


class _SceneFile(_FolderModel):
    """`scene.yaml`: a scene, what can be touched there, its looks, and the course through it."""

    version: Literal[1] = Field(alias="nw-scene")
    """Version of this format."""
    name: Annotated[str, AfterValidator(checked_name)]
    """Up to four words with slashes between, each of letters, digits, '_', '-' and '.'."""
    task: Task
    """What the course asks of the robot; reports group by it."""
    title: Line = ""
    """One line for people (default: the name)."""
    licence: Line
    """SPDX identifier of the scene's data, or words."""
    units: Literal["m", "unknown"] = "m"
    """Of all lengths here and in the mesh; `run` and `scenes check` refuse an unknown unit."""
    trail: tuple[Point, ...] = Field(min_length=1, max_length=limits.WAYPOINTS)
    """Waypoints x, y, z on top of what the robot steps on, in order; world, m."""
    spawn: _Spawn = _Spawn()
    """Where the robot starts."""
    waypoint_noise: tuple[Noise, Noise] = (0.0, 0.1)
    """Half widths by which a trial moves each waypoint along x and y, m."""
    ground: Length = 0.0
    """Height of the ground plane under boxes, m; a mesh is its own ground."""
    collision: str = "collision.yaml"
    """A file of boxes, or a mesh (.obj, .ply, .stl, .glb) in metres, inside the folder."""
    splat: str | None = None
    """A file of Gaussians inside the folder, which `splat_rgb` looks at."""
    rasterize_mode: RasterizeMode | None = None
    """The rendering the splat was trained for (default: what its file says, else `antialiased`)."""
    T_world_splat: _Similarity = _Similarity()
    """Where the splat lies in the world."""
    captures: str | None = None
    """A file of the cameras that the scene was photographed with, inside the folder."""
    props: tuple[_Prop, ...] = Field(default=(), max_length=limits.PROPS)
    """What moves beside the robot: doors, crates. They are in neither the mesh nor the splat."""


@dataclass(frozen=True, kw_only=True)
class FileSplat:
    """Gaussians read from a splat file."""

    path: Path
    rasterize_mode: RasterizeMode | None = None
    """How scene.yaml says that it is drawn; None: by the file's own mark."""

    @property
    def key(self) -> str:
        """Hex SHA-256 of the file, or of its ranks', and how scene.yaml says that it is drawn.

        Raises:
            SceneError: the file cannot be read.
        """
        return self._key

    @cached_property
    def _key(self) -> str:
        from nw_splat.files import digest_of_files

        digest = digest_of_files(self.path)
        return digest if self.rasterize_mode is None else f"{digest}:{self.rasterize_mode}"

    def store(self, progress: Progress | None = None) -> Path:
        """Return the compiled store in the cache."""
        from nw_splat.files import compiled_store

        if progress is not None:
            progress("read", 0.0)
        path = compiled_store(self.path, self.key, rasterize_mode=self.rasterize_mode)
        if progress is not None:
            progress("stored", 1.0)
        return path


def load_folder(
    folder: Path, *, collision: Collision = "terrain", needs_scale: bool = True
) -> Scene:
    """Return the scene of a folder.

    A collision mesh becomes terrain: height fields and boxes, or with `triangles` its own ones.

    Args:
        folder: that holds scene.yaml.
        collision: how its mesh collides.
        needs_scale: refuse a scene whose unit is unknown.

    Raises:
        SceneError: a file is missing or wrong; every problem found, with file and line. Or the
            scene is not to scale.
    """
    scene, findings = inspect_folder(folder, collision=collision)
    if needs_scale and findings and findings[0].code == _NOT_TO_SCALE:
        raise SceneError(f"{folder} is not to scale: {findings[0].message}", fix=findings[0].fix)
    return scene


def inspect_folder(
    folder: Path, *, collision: Collision = "terrain"
) -> tuple[Scene, tuple[SceneFinding, ...]]:
    """Return the scene of a folder, and what its mesh lacks or has more than terrain can be.

    Raises:
        SceneError: as `load_folder`.
    """
    file, text = _read(folder / SCENE_FILE, _SceneFile)
    trail = np.array(text.trail, dtype=np.float64)
    path = _beside(folder, file, "collision", text.collision)
    solids: tuple[Solid, ...]
    findings: tuple[SceneFinding, ...] = ()
    if path.suffix.lower() in MESH_SUFFIXES:
        # Embree loads with it; listing scenes needs neither.
        from nw_scenes.terrain import compiled_terrain

        static_mesh, read = inspect_mesh(path)
        wide = _place_of(static_mesh, trail, path)
        terrain = compiled_terrain(
            static_mesh,
            trail=trail,
            spawn=np.array(text.spawn.position, dtype=np.float64),
            options=TerrainOptions(collision=collision),
        )
        solids, ground, findings = terrain.solids, Plane(z=terrain.floor), terrain.findings
        findings = (*_unscaled(folder, text), *read, *wide, *findings)
    elif path.suffix.lower() in _OTHER_MESHES:
        problem = file.problem(
            ("collision",),
            f"{text.collision!r} is a mesh of a format that is not read",
            f"export it as {', '.join(MESH_SUFFIXES)}",
        )
        raise SceneError([problem])
    else:
        boxes = _boxes(path)
        findings = _unscaled(folder, text)
        static_mesh = solids_mesh(boxes, text.ground)
        solids, ground = boxes, Plane(z=text.ground)
    splat = None
    if text.splat is not None:
        splat = FileSplat(
            path=_beside(folder, file, "splat", text.splat), rasterize_mode=text.rasterize_mode
        )
        if what_is(splat.path) != "file":
            problem = file.problem(
                ("splat",),
                f"there is no splat {text.splat!r} beside it",
                "check the key `splat`",
            )
            raise SceneError([problem])
    scene = Scene(
        name=text.name,
        task=text.task,
        title=text.title or text.name,
        solids=solids,
        ground=ground,
        trail=trail,
        static_mesh=static_mesh,
        splat=splat,
        spawn=Spawn(**text.spawn.model_dump()),
        waypoint_noise=text.waypoint_noise,
        T_world_splat=text.T_world_splat.matrix(),
        captures=None
        if text.captures is None
        else read_captures(_beside(folder, file, "captures", text.captures)),
        licence=text.licence,
        props=_props(folder, file, text),
    )
    return scene, findings


def _props(folder: Path, file: YamlFile, text: _SceneFile) -> tuple[Prop, ...]:
    """Return what moves in a scene.

    Raises:
        SceneError: two have one name, or a file is missing or wrong.
    """
    props: list[Prop] = []
    for number, prop in enumerate(text.props):
        where = ("props", number)
        if prop.name in {other.name for other in props}:
            raise SceneError(
                [
                    file.problem(
                        (*where, "name"), f"two props are called {prop.name!r}", "rename one"
                    )
                ]
            )
        mesh, splat, boxes = None, None, tuple(PropBox(**b.model_dump()) for b in prop.boxes)
        if prop.mesh is not None:
            path = _beside(folder, file, (*where, "mesh"), prop.mesh)
            if what_is(path) == "nothing":
                message = f"there is no mesh {prop.mesh!r} beside it"
                problem = file.problem((*where, "mesh"), message, "check the key `mesh`")
                raise SceneError([problem])
            mesh = read_mesh(path, kind=prop.kind)
            boxes = boxes or (box_round(mesh),)
        elif prop.splat is not None:
            splat = FileSplat(path=_beside(folder, file, (*where, "splat"), prop.splat))
            if what_is(splat.path) != "file":
                message = f"there is no splat {prop.splat!r} beside it"
                problem = file.problem((*where, "splat"), message, "check the key `splat`")
                raise SceneError([problem])
        props.append(
            Prop(
                name=prop.name,
                position=prop.position,
                quat=prop.quat,
                boxes=boxes,
                mass=prop.mass,
                friction=prop.friction,
                joint=PropJoint(**prop.joint.model_dump()),
                kind=prop.kind,
                mesh=mesh,
                color=prop.color,
                splat=splat,
                T_prop_splat=prop.T_prop_splat.matrix(),
            )
        )
    return tuple(props)


def _unscaled(folder: Path, text: _SceneFile) -> tuple[SceneFinding, ...]:
    if text.units == "m":
        return ()
    return (
        SceneFinding(
            code=_NOT_TO_SCALE,
            severity="error",
            message=f"{SCENE_FILE} says units: {text.units}: its size is unknown, so no robot "
            "runs in it",
            fix=f"put two markers at a known distance in `nw-eval twin label {folder}`, and save; "
            f"or, if it was built there, `nw-eval twin place {folder} --length A B METRES`",
        ),
    )


def folder_files(folder: Path) -> dict[str, Path]:
    """Return the files that the scene of a folder is made of, by their names in it.

    Raises:
        SceneError: `scene.yaml` is missing or wrong, or a file would lie outside the folder.
    """
    file, text = _read(folder / SCENE_FILE, _SceneFile)
    files = {SCENE_FILE: folder / SCENE_FILE}
    files[text.collision] = _beside(folder, file, "collision", text.collision)
    if text.splat is not None:
        from nw_splat.files import files_of_splat

        path = _beside(folder, file, "splat", text.splat)
        files[text.splat] = path
        # The other ranks of a checkpoint, which are read with it.
        for one in files_of_splat(path):
            files.setdefault(str(Path(text.splat).with_name(one.name)), one)
    if text.captures is not None:
        files[text.captures] = _beside(folder, file, "captures", text.captures)
    for name in (name for prop in text.props for name in (prop.mesh, prop.splat) if name):
        files[name] = _beside(folder, file, "props", name)
    return files


def json_schema(file: Literal["scene", "collision"]) -> dict[str, Any]:
    """Return the JSON Schema of `scene.yaml`, or of a collision file of boxes."""
    model = _SceneFile if file == "scene" else _Collision
    return json_schema_of(model) | {"title": f"nw-eval {file}"}


def solids_mesh(boxes: tuple[Box, ...], ground: float) -> TriangleMesh:
    """Return the ground's quad and the faces of boxes."""
    reach = _GROUND_REACH
    quad = quad_mesh((-reach, -reach, ground), (2 * reach, 0, 0), (0, 2 * reach, 0), "ground")
    return merge([quad, *(box_mesh(b.center, b.half_size, b.quat, b.kind) for b in boxes)])


def _beside(folder: Path, file: YamlFile, key: str | Location, name: str) -> Path:
    """Return the path of a file that a key of scene.yaml names, in the folder."""
    place = (key,) if isinstance(key, str) else key
    try:
        return inside(folder, name)
    except OutsideError as error:
        text = f"{'.'.join(map(str, place))}: {name!r} leaves the scene's folder: {error}"
        raise SceneError([file.problem(place, text, "put the file into the folder")]) from None


def _place_of(
    mesh: TriangleMesh, trail: NDArray[np.float64], path: Path
) -> tuple[SceneFinding, ...]:
    """Return what is odd about the size and the origin of a scene's mesh.

    Judged by the bulk of its vertices: a scan has stray points far behind the scene.

    Raises:
        SceneError: no robot walks in a scene of this size, or so far from the origin.
    """
    low, high = np.percentile(mesh.vertices, [5, 95], axis=0)
    middle = np.median(mesh.vertices, axis=0)
    wide = float((high - low)[:2].max())
    whole = float(np.ptp(mesh.vertices[:, :2], axis=0).max())
    far = float(np.abs(middle).max())
    label = (
        "as `nw-eval scenes level SCENE --unit` does, or measure a length with `nw-eval twin label`"
    )
    if whole < _LEAST_WIDE:
        raise SceneError(
            f"{path}: the mesh is {whole:.3g} m wide, less than a robot is long: its unit is not "
            "the metre",
            fix=f"multiply it by 1000 if it is in kilometres, {label}",
        )
    if far > limits.REACH and far > wide:
        shift = ", ".join(f"{value:.0f}" for value in middle)
        raise SceneError(
            f"{path}: the middle of the mesh is at ({shift}) m, {far / 1000:.1f} km from the "
            f"origin; a scene lies within {limits.REACH:g} m of it, and single precision holds "
            f"{far * 2.0**-24:.1g} m there",
            fix=f"subtract ({shift}) from its vertices before it is exported, with the start near "
            "(0, 0, 0)",
        )
    if wide > _MOST_WIDE:
        raise SceneError(
            f"{path}: the mesh is {wide:.0f} m wide: its unit is not the metre",
            fix=f"multiply it by 0.001 if it is in millimetres, by 0.01 in centimetres, {label}",
        )
    course = float(np.ptp(np.vstack([trail, np.zeros((1, 3))])[:, :2], axis=0).max())
    if wide > _ODDLY_WIDE and wide > _TIMES_COURSE * course:
        return (
            SceneFinding(
                code="mesh_wide",
                severity="warning",
                message=f"{path.name}: the mesh is {wide:.0f} m wide, its course {course:.1f} m",
                fix="multiply the mesh by 0.01 if it is in centimetres, as `nw-eval scenes level "
                "SCENE --unit cm` does, or cut off what is far from the course",
                value=wide,
            ),
        )
    return ()


def _boxes(path: Path) -> tuple[Box, ...]:
    _, read = _read(path, _Collision)
    return tuple(Box(**box.model_dump()) for box in read.boxes)


def _read(path: Path, model: type[_Read]) -> tuple[YamlFile, _Read]:
    try:
        file = read_yaml(path)  # JSON is YAML too.
    except YamlProblems as error:
        raise SceneError(error.problems) from None
    try:
        return file, model.model_validate(file.data)
    except ValidationError as error:
        raise SceneError(validation_problems(error, file, model)) from None
