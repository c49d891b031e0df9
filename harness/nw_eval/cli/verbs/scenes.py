"""`nw-eval scenes`: what places there are, what they look like, and those of a hub."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from nw_eval.clean import clean
from nw_eval.plural import in_words, plural

if TYPE_CHECKING:
    from nw_eval.api import CheckedScene, ListedScene, PushedScene
    from nw_eval.scenes.overview import SceneFigures
    from nw_eval.twin.scans.scan import WrittenScan


@dataclass(frozen=True, kw_only=True)
class List:
    """List scenes with their waypoints, split (`split:eval` names its scenes) and obstacles."""

    patterns: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names or globs; every built-in scene when absent."""
    robot: str | None = None
    """Say what the steps and gaps of each scene ask of this robot's legs."""

    def __call__(self) -> int:
        from nw_eval import api

        print(scene_table(api.list_scenes(self.patterns, robot=self.robot)))
        return 0


@dataclass(frozen=True, kw_only=True)
class Show:
    """Say everything about one scene, and draw it from above with its trail and heights."""

    scene: tyro.conf.Positional[str]
    """A built-in name, a scene folder, neverwhere:<folder or published name>, or hub:org/name."""
    out: Path | None = None
    """A PNG of the view from above."""

    def __call__(self) -> int:
        from nw_eval import api

        print(scene_page(api.show_scene(self.scene, out=self.out)))
        if self.out is not None:
            print(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class Check:
    """Find what is wrong with scenes: files, start, trail, splat. Exit code 2 if any is.

    Along the course: ground that does not carry the robot's feet, steps and gaps that its legs are
    too short for, and a splat that does not show its camera what the mesh has there.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """Built-in names, scene folders, neverwhere:<folder or published name>, or hub:org/name."""
    robot: str = "go1"
    """Whose feet, camera and length count."""
    out: Path | None = None
    """Write a suite of them to this file, ready to run, unless something is wrong."""
    policy: str | None = None
    """With --out: the policy of the suite. One that nw-eval has a card of when absent."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.errors import SceneError

        checked = api.check_scenes(self.scenes, robot=self.robot, out=self.out, policy=self.policy)
        print(findings_text(checked))
        if any(scene.has_errors for scene in checked):
            return SceneError.exit_code
        if self.out is not None:
            print(f"ready: nw-eval run {shlex.quote(str(self.out))}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Render:
    """Draw scenes from the robot's eye and from outside on one sheet; by mesh without a splat."""

    patterns: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names or globs; every built-in scene when absent."""
    out: Path = Path("scenes.png")
    """The PNG to write."""
    width: int = 480
    """Pixels across each view."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.progress import RunProgress

        with RunProgress() as listener:
            picture = api.render_scenes(
                self.patterns, out=self.out, width=self.width, listener=listener
            )
        print(picture)
        return 0


@dataclass(frozen=True, kw_only=True)
class FetchScenes:
    """Fetch places as their hub has them now; runs use them from then on, without a network.

    A download that breaks goes on where it broke when the command is given again. HF_TOKEN or
    `hf auth login` says who you are, HF_ENDPOINT which hub. Needs the extra `hub`.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    """hub:org/name, hub:org/name@revision, neverwhere:NAME of the published release, or real:NAME,
    which are real places."""
    file: Path | None = None
    """Of real:NAME: its file, fetched on another machine, which is compared with what is known."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.terminal.lines import fetched_lines
        from nw_eval.errors import UsageError

        if not self.scenes:
            raise UsageError("no scene to fetch", fix="name one, such as hub:org/name")
        if self.file is not None and len(self.scenes) > 1:
            raise UsageError("--file is of one scene", fix="fetch the others without it")
        for scene in self.scenes:
            print(fetched_lines(api.fetch_scene(scene, file=self.file)))
        return 0


@dataclass(frozen=True, kw_only=True)
class PushScene:
    """Put a scene folder into a data set of a hub, as one commit. Needs the extra `hub`.

    The files that the scene is made of are pushed, README and licence if they lie beside them, and
    nothing else. A scene that `scenes check` finds errors in is not.
    """

    scene: tyro.conf.Positional[Path]
    """The folder, with its scene.yaml."""
    to: tyro.conf.Positional[str]
    """hub:org/name; the repository is made if it is not there."""
    private: bool = False
    """Make a repository that only its owner sees."""

    def __call__(self) -> int:
        from nw_eval import api

        print(pushed_line(api.push_scene(self.scene, self.to, private=self.private)))
        return 0


@dataclass(frozen=True, kw_only=True)
class ImportScan:
    """Make a scene folder of a scan: a mesh with its colours, or an elevation map.

    Meshes are GLB, OBJ, PLY or STL; elevation maps are PNG or GeoTIFF. The scene is in metres with
    z up, the ground under the start is at z = 0, and a suite that runs it lies beside. Colours of
    textures and vertices become Gaussians, which camera images show. The scene is checked as by
    `scenes check`; exit code 2 if it is not ready.
    """

    scan: tyro.conf.Positional[Path]
    """The mesh, or the elevation map."""
    out: Path
    """The scene's folder, which must not be there."""
    unit: Literal["auto", "m", "cm", "mm", "ft", "in"] = "auto"
    """Of the mesh's numbers; what a comment of the file names, or else m, when `auto`."""
    up: Literal["auto", "+x", "-x", "+y", "-y", "+z", "-z"] = "auto"
    """Axis of the file that is up; +y of a GLB, else the one that most of the ground looks along,
    when `auto`."""
    splat: Path | None = None
    """Gaussians of the same place, as the same app exports them (PLY, SPZ, SOG); those of the
    mesh's colours when absent."""
    splat_transform: Path | None = None
    """A text file of the 4 x 4 matrix from the splat's numbers to the mesh's; found among the turns
    by right angles when absent."""
    gaussians: int = 200_000
    """Gaussians that are made of the mesh's colours, at most."""
    cell: float | None = None
    """Of an elevation map: width of a pixel, m. A GeoTIFF says it."""
    white: float | None = None
    """Of a PNG: height of white, m."""
    black: float = 0.0
    """Of a PNG: height of black, m."""
    no_data: float | None = None
    """Of an elevation map: value of pixels without ground. A GeoTIFF may say it."""
    trail: tuple[str, ...] = ()
    """The start, then waypoints, X,Y or X,Y,Z in m of the scene; proposed when absent."""
    task: Literal["hurdles", "gaps", "ramps", "stairs", "open"] | None = None
    """What the course asks of the robot; `open` when absent."""
    name: str | None = None
    """The scene's name; that of its folder when absent."""
    licence: str = "not stated"
    """Of the scan: an SPDX identifier, or words."""
    robot: str = "go1"
    """The robot of the scene's suite."""

    def __call__(self) -> int:
        from nw_eval.errors import SceneError
        from nw_eval.twin.scans.scan import ScanOptions, import_scan

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
    """Lay the floor of a scene's mesh level, turn it over, or scale it.

    Mesh, splat, trail, start and capture cameras go by one transform, so the scene is another one,
    with starts of its own. scene.yaml is rewritten; the files that it named before stay.
    """

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    floor: tuple[str, ...] = ()
    """Three points X,Y,Z of the floor, as the mesh lies now; they come to z = 0."""
    flip: bool = False
    """Put the other side of the floor up."""
    unit: Literal["m", "cm", "mm", "ft", "in"] = "m"
    """Of the mesh's numbers now, and of --floor."""
    trail: tuple[str, ...] = ()
    """The start, then waypoints, X,Y or X,Y,Z in m, as the mesh lies afterwards; those that the
    scene has go with the mesh when absent."""
    propose: bool = False
    """Lay the course straight over even ground, as `scenes import` does."""
    out: Path | None = None
    """Write a copy to this folder, which must not be there, and leave the scene as it is."""

    def __call__(self) -> int:
        from nw_eval.errors import SceneError
        from nw_eval.twin.scans.levelling import level_scene

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


def scene_table(scenes: Sequence[ListedScene]) -> str:
    """Return a line for each scene: name, waypoints, split, title."""
    width = max(len(scene.name) for scene in scenes)
    return "\n".join(
        f"{scene.name:{width}}  {plural(scene.waypoints, 'waypoint'):11}  {scene.split or '-':5}  "
        f"{_asked(scene)}{scene.title}"
        for scene in scenes
    )


def _asked(scene: ListedScene) -> str:
    """Return what a scene asks of legs, in columns; empty where no robot was asked for."""
    if scene.fit is None:
        return ""
    asked = scene.fit.demands
    gap = f"gap {asked.gap:.2f} m" if asked.gap else ""
    return f"step {max(asked.up, asked.down):.2f} m  {gap:10}  {scene.fit.asks_for:21}  "


def scene_page(scene: SceneFigures) -> str:
    """Return all figures of one scene."""
    x, y, z = scene.spawn
    solids = ", ".join(f"{count} {kind}" for kind, count in scene.solids.items())
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in scene.triangles.items())
    lines = [
        f"name       {scene.name}",
        f"title      {scene.title}",
        f"task       {scene.task}",
        f"digest     {scene.digest}",
        f"licence    {scene.licence}",
        f"spawn      x {x:.2f}  y {y:.2f}  z {z:.2f} m, heading {scene.heading:.2f} rad",
        f"ground     z {scene.ground:.3f} m",
        f"solids     {solids}",
        f"mesh       {sum(scene.triangles.values()):,} triangles: {kinds}",
        f"splat      {'none' if scene.splat is None else scene.splat[:16]}",
    ]
    for index, (px, py, pz) in enumerate(scene.trail):
        label = "trail" if index == 0 else ""
        lines.append(f"{label:<10} {index + 1}: x {px:.2f}  y {py:.2f}  z {pz:.2f} m")
    return "\n".join(lines)


def findings_text(scenes: Sequence[CheckedScene]) -> str:
    """Return a line for each figure and finding of each scene, and one where nothing is wrong."""
    from nw_eval.survey import survey_lines

    lines: list[str] = []
    for scene in scenes:
        name = clean(scene.reference)
        if scene.survey is not None:
            lines += [f"{name}: {line}" for line in survey_lines(scene.survey)]
        lines += [f"{name}: {finding}" for finding in scene.findings]
        if not scene.findings:
            lines.append(f"{name}: no findings")
    return "\n".join(lines)


def pushed_line(pushed: PushedScene) -> str:
    """Return what names the revision that was made."""
    return f"{pushed.reference}: {plural(len(pushed.files), 'file')}, {in_words(pushed.bytes)}"


_FARTHEST = 1e7  # of a number: 10 km in mm, and far below what float32 holds


def points_of(
    option: str, words: Sequence[str], sizes: tuple[int, ...]
) -> tuple[tuple[float, ...], ...]:
    """Return points that are written X,Y or X,Y,Z.

    Raises:
        UsageError: a word is no point of one of these sizes.
    """
    from math import isfinite

    from nw_eval.errors import UsageError

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
    """Return what was done to a scan, the scene's digest, and the command to go on with."""
    digest = f"digest {written.digest[:16]}"
    if written.before is not None:
        same = written.before == written.digest
        digest = "digest as before" if same else f"digest {written.before[:16]} -> {digest[7:]}"
    folder = shlex.quote(str(written.folder))
    here = folder if folder.startswith(("/", ".", "'")) else f"./{folder}"
    end = f"ready: nw-eval scenes check {here}"
    if written.fault is not None:
        end = f"not ready: {written.fault.replace('SCENE', here)}"
    return "\n".join([*written.lines, digest, end])
