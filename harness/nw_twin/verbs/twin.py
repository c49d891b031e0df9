"""`nw-eval twin`: photographs to a scene, all at once or stage by stage."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from nw_eval.cli.terminal.interruption import stopped_by_signals

if TYPE_CHECKING:
    from nw_twin.building.build import BuildSettings
    from nw_twin.label.labelling import Labelling


@dataclass(frozen=True, kw_only=True)
class CalibrateFlags:
    """Of the cameras."""

    matching: Literal["auto", "sequential", "retrieval", "exhaustive"] = "auto"
    """Which photographs are compared if there are more than 30: those that look similar
    (retrieval); those and neighbours by name (sequential); or all (exhaustive). auto is sequential
    for a video or numbered names, else retrieval."""
    frames: int = 150
    """Sharp frames taken from a video, or from a film with known cameras. At most N."""
    per_second: float | None = None
    """Frames taken per second of a video (default: depends on the motion)."""
    lens: Literal[
        "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE"
    ] = "SIMPLE_RADIAL"
    """COLMAP camera model, if the cameras are not known."""
    share: float = 0.7
    """Share of the photographs that must be located, 0 to 1."""
    features: int = 8192
    """Features per photograph. At most N."""
    side: int = 1600
    """Longer side of the images for feature search and of the images written, pixels."""
    megapixels: int = 100
    """Megapixels of a photograph. At most N; larger photographs are skipped."""


@dataclass(frozen=True, kw_only=True)
class ReconstructFlags:
    """Of the mesh."""

    mesher: Literal["patchmatch", "openmvs"] = "patchmatch"
    """The built-in PatchMatch stereo, or OpenMVS, whose programs must be on PATH."""
    depth_side: int = 328
    """Longer side of the depth images, pixels. Larger images show finer edges, and less ground at
    grazing angles."""
    faces: int = 200_000
    """Faces of the mesh. At most N."""


@dataclass(frozen=True, kw_only=True)
class AlignFlags:
    """Of gravity and scale. With a printed tag in view nothing else is wanted.

    Without any scale the scene is in a unit of its own, until `label` or one of these gives one.
    """

    tag_edge: float | None = None
    """Outer edge of the black border of the AprilTags (36h11) in the scene, m."""
    camera_height: float | None = None
    """Median height of the camera above the floor, m."""
    length: Annotated[
        tyro.conf.UseAppendAction[tuple[tuple[str, str, float], ...]],
        tyro.conf.arg(metavar="POINT POINT METRES"),
    ] = ()
    """A measured distance between two points of photographs, m: IMG_1.jpg:412,310 IMG_1.jpg:590,322
    0.90. One pixel marks the point where its ray meets the mesh; two pixels,
    IMG_1.jpg:412,310+IMG_2.jpg:97,305, the point where their rays meet."""
    metric: bool = False
    """The given cameras (ARKit, Polycam, Record3D) are already in metres."""


@dataclass(frozen=True, kw_only=True)
class SplatFlags:
    """Of the Gaussians."""

    iterations: int | None = None
    """Training steps (default: 100 per photograph, from 1,500 to 6,000)."""
    gaussians: int = 200_000
    """Gaussians. At most N."""
    longest: int = 480
    """Longer side of the training images, pixels."""
    held_out: Annotated[str, tyro.conf.arg(metavar="GLOB")] = ""
    """Photographs kept out of training for evaluation, such as 'low_*' (default: every eighth).
    With fewer than 16 photographs, one or two are kept until the figures are computed."""


@dataclass(frozen=True, kw_only=True)
class PlaceFlags:
    """Of the scene."""

    name: str | None = None
    """The scene's name (default: its present name, else its folder's)."""
    licence: str | None = None
    """Licence of the photographs: an SPDX identifier, or words (default: that of the existing
    scene, else `unknown`)."""
    robot: str | None = None
    """The robot of the scene's suite; the check uses its feet, camera and legs (default: that of
    the existing suite, else go1)."""


@dataclass(frozen=True, kw_only=True)
class AllFlags(CalibrateFlags, ReconstructFlags, AlignFlags, SplatFlags, PlaceFlags):
    """Of a whole build."""


@dataclass(frozen=True, kw_only=True)
class BuildTwin(AllFlags):
    """Build a scene from photographs: runs all stages and resumes after the last finished one.

    Takes a folder of photographs, a video, or cameras of COLMAP, nerfstudio or an app. Ends with
    the findings of `scenes check`: exit code 2 on an error; the scene is kept.
    """

    photographs: tyro.conf.Positional[Path]
    """The folder or the video."""
    out: Path
    """The scene's folder; unfinished work is in its `build/`."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads (default: one per core). They do not change the result."""

    def __call__(self) -> int:
        from nw_base.errors import SceneError
        from nw_twin.building.build import Build

        build = Build(self.out, settings_of(self, self.workers), _say)
        return 0 if build.whole(self.photographs) else SceneError.exit_code


@dataclass(frozen=True, kw_only=True)
class Calibrate(CalibrateFlags):
    """Locate the camera of each photograph and remove lens distortion."""

    photographs: tyro.conf.Positional[Path]
    """A folder of photographs, a video, or cameras of COLMAP, nerfstudio, Polycam, Record3D or
    another app listed in docs/how-to/twins.md."""
    out: Path
    """The scene's folder."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads (default: one per core). They do not change the result."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.out, settings_of(self, self.workers), _say).calibrate(self.photographs)
        return 0


@dataclass(frozen=True, kw_only=True)
class Reconstruct(ReconstructFlags):
    """Compute the depth of every photograph and build the mesh."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads (default: one per core). They do not change the result."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.scene, settings_of(self, self.workers), _say).reconstruct()
        return 0


@dataclass(frozen=True, kw_only=True)
class Align(AlignFlags):
    """Find the up axis, the scale and the floor."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.scene, settings_of(self, None), _say).align()
        return 0


@dataclass(frozen=True, kw_only=True)
class TrainSplat(SplatFlags):
    """Train the Gaussians; resumes an interrupted training."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads (default: one per core). They do not change the result."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.scene, settings_of(self, self.workers), _say).splat()
        return 0


@dataclass(frozen=True, kw_only=True)
class PlaceScene(PlaceFlags, AlignFlags):
    """Write the scene: mesh and splat in metres, and a proposed course.

    With an option of `align` it aligns the scene again first; nothing else is rebuilt.
    """

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        build = Build(self.scene, settings_of(self, None), _say)
        if any(vars(self)[name] != value for name, value in vars(AlignFlags()).items()):
            build.align()
        build.place()
        return 0


@dataclass(frozen=True, kw_only=True)
class AblateSplat(SplatFlags):
    """Train the splat four times to compare: from points or the mesh, without or with depths.

    The scene's own splat does not change. An interrupted training is resumed.
    """

    scene: tyro.conf.Positional[Path]
    """The scene's folder, with a mesh in its `build/`."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads (default: one per core). They do not change the result."""

    def __call__(self) -> int:
        from nw_twin.building.ablation import ablate, table_text, write_table
        from nw_twin.building.folder import BuildFolder

        settings = settings_of(self, self.workers)
        folder = BuildFolder(self.scene)
        folder.needs("reconstruct")
        with folder.held():
            outcomes = ablate(folder, settings.splat, _say, threads=settings.threads)
        print(table_text(outcomes))
        print(f"table: {write_table(folder.path / 'ablation', outcomes)}")
        return 0


@dataclass(frozen=True, kw_only=True)
class LabelScene:
    """Edit a scene's course in the browser (Ctrl-C to stop): start, waypoints, task.

    The page also scales, levels, flips and crops the scene, shows heights along the course and what
    go1-parkour can pass, and proposes a course. Saving writes scene.yaml.
    """

    scene: tyro.conf.Positional[str]
    """A scene folder; with --out any scene that a suite can name."""
    out: Path | None = None
    """Edit a copy in this new folder; required for built-in and fetched scenes."""
    robot: str = "go1"
    """With --out: the robot of the copy's suite."""
    port: int = 0
    """Port on this machine's loopback address; 0 chooses a free one."""
    open: bool = False
    """Open the page in this machine's browser."""

    def __call__(self) -> int:
        from nw_eval.viewing.browser import check_server
        from nw_splat.files import read_splat
        from nw_twin.label.files import own_folder
        from nw_twin.label.label_page import LabelPage
        from nw_twin.label.labelling import NEEDS_SCALE, open_labelling

        check_server(self.port)
        folder = own_folder(self.scene, self.out, robot=self.robot)
        labelling = open_labelling(folder)
        splat = labelling.place.splat
        saved: list[str] = []

        def on_save(line: str) -> None:
            saved.append(line)
            _say_label(f"saved {line}")

        with LabelPage(
            labelling, None if splat is None else read_splat(splat), port=self.port, on_save=on_save
        ) as page:
            stop = stopped_by_signals()
            if not labelling.state.to_scale:
                _say_label(f"{folder} is not to scale: {NEEDS_SCALE}")
            _say_label(f"{folder} is at {page.url}: open that in a browser; Ctrl-C ends it")
            if self.open:
                from nw_eval.cli.terminal.final_output import show_address

                show_address(page.url)
            stop.wait()
        _say_label(_ending(labelling, is_saved=bool(saved)))
        return 0


def settings_of(flags: object, threads: int | None) -> BuildSettings:
    """Return the options of a build; an option without a flag of the verb has its default.

    Raises:
        UsageError: a number makes no sense.
    """
    from nw_gate.results.provenance import usable_cores
    from nw_twin.align.alignment import AlignOptions, KnownLength
    from nw_twin.building.appearance import AppearanceOptions
    from nw_twin.building.build import BuildSettings
    from nw_twin.options import CalibrateOptions, DepthOptions, ReconstructOptions

    has = vars(AllFlags()) | {k: v for k, v in vars(flags).items() if k in vars(AllFlags())}
    cores = threads or usable_cores()
    return BuildSettings(
        calibrate=CalibrateOptions(
            **{one.name: has[one.name] for one in fields(CalibrateFlags)}, threads=cores
        ),
        reconstruct=ReconstructOptions(
            engine=has["mesher"],
            depth=DepthOptions(side=has["depth_side"]),
            faces=has["faces"],
        ),
        align=AlignOptions(
            tag_edge=has["tag_edge"],
            camera_height=has["camera_height"],
            metric=has["metric"],
            lengths=tuple(KnownLength.of_words(*one) for one in has["length"]),
        ),
        splat=AppearanceOptions(
            iterations=has["iterations"],
            most=has["gaussians"],
            longest=has["longest"],
            held_out=has["held_out"],
        ),
        name=has["name"],
        licence=has["licence"],
        robot=has["robot"],
        threads=cores,
    )


def _say(line: str) -> None:
    print(line, flush=True)


def _ending(labelling: Labelling, *, is_saved: bool) -> str:
    """Return the last words: what became of the changes, and what to do next."""
    folder = labelling.place.folder
    if not is_saved:
        return "nothing was saved"
    suite = folder / "suite.yaml"
    follows = f"nw-eval run {suite}" if suite.is_file() else f"nw-eval scenes check {folder}"
    changed = "" if labelling.is_saved else "what was changed after the last save is not saved; "
    if not labelling.state.to_scale:
        return f"{changed}{folder} is not to scale yet, and does not run"
    return f"{changed}next: {follows}"


def _say_label(line: str) -> None:
    _say(f"label: {line}")
