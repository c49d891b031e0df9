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
    """Which of more than 30 photographs are compared: those that look similar (retrieval), those
    and neighbours in the order of their names (sequential: auto, where names are numbers or a
    video's frames), or all (exhaustive)."""
    frames: int = 150
    """Frames that are taken of a video, or of a film whose cameras an app knows, at most: sharp
    ones, some way apart."""
    per_second: float | None = None
    """Frames that are taken of each second of a video; as many as the picture moves when absent."""
    lens: Literal[
        "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE"
    ] = "SIMPLE_RADIAL"
    """COLMAP's name of the camera model, where the cameras are not known."""
    share: float = 0.7
    """Of the photographs that must be placed, 0 to 1."""
    features: int = 8192
    """Of each photograph, at most."""
    side: int = 1600
    """Longer side of the pictures that features are looked for in and that are written, pixels."""
    megapixels: int = 100
    """Of a photograph, at most; larger ones are left out."""


@dataclass(frozen=True, kw_only=True)
class ReconstructFlags:
    """Of the mesh."""

    mesher: Literal["patchmatch", "openmvs"] = "patchmatch"
    """Our own PatchMatch stereo, or the programs of OpenMVS, which must be on PATH."""
    depth_side: int = 328
    """Longer side of the pictures that depth is measured in, pixels: larger ones show finer edges,
    and less of ground that is seen at a slant."""
    faces: int = 200_000
    """Faces of the mesh, at most."""


@dataclass(frozen=True, kw_only=True)
class AlignFlags:
    """Of gravity and scale. With a printed tag in view nothing else is wanted.

    Without any scale the scene is in a unit of its own, until `label` or one of these gives one.
    """

    tag_edge: float | None = None
    """Outer edge of the black border of the AprilTags (36h11) that lie about, m."""
    camera_height: float | None = None
    """Height at which the camera was held above the floor, the median, m."""
    length: Annotated[
        tyro.conf.UseAppendAction[tuple[tuple[str, str, float], ...]],
        tyro.conf.arg(metavar="POINT POINT METRES"),
    ] = ()
    """A distance that you measured, between two points of photographs, m: IMG_1.jpg:412,310
    IMG_1.jpg:590,322 0.90. The pixel of one photograph is where it meets the mesh; that of two,
    IMG_1.jpg:412,310+IMG_2.jpg:97,305, is where their rays meet."""
    metric: bool = False
    """The cameras that were taken as they are (ARKit, Polycam, Record3D) are in metres already."""


@dataclass(frozen=True, kw_only=True)
class SplatFlags:
    """Of the Gaussians."""

    iterations: int = 6000
    """Steps of training."""
    gaussians: int = 200_000
    """Gaussians, at most."""
    longest: int = 480
    """Longest side of the pictures that are learnt from, pixels."""
    held_out: Annotated[str, tyro.conf.arg(metavar="GLOB")] = ""
    """Photographs that are kept from training to compare with, such as 'low_*'; every eighth when
    absent. Of fewer than 16 photographs, one or two are until the figures are taken."""


@dataclass(frozen=True, kw_only=True)
class PlaceFlags:
    """Of the scene."""

    name: str | None = None
    """The scene's name; when absent, that which the scene has already, else that of its folder."""
    licence: str | None = None
    """Of the photographs: an SPDX identifier, or words; when absent, that of the scene that is
    there, else `unknown`."""
    robot: str | None = None
    """The robot of the scene's suite: whose feet, camera and length the check goes by. When absent,
    that of the suite that is there, else a Go1."""


@dataclass(frozen=True, kw_only=True)
class AllFlags(CalibrateFlags, ReconstructFlags, AlignFlags, SplatFlags, PlaceFlags):
    """Of a whole build."""


@dataclass(frozen=True, kw_only=True)
class BuildTwin(AllFlags):
    """Photographs to a scene, all stages one after another; what is done stays, and goes on.

    A folder of photographs, a video, or cameras that COLMAP, nerfstudio or an app knows. Ends with
    what `scenes check` says of the scene, and with 2 where that is an error; the scene stays.
    """

    photographs: tyro.conf.Positional[Path]
    """The folder, or the video."""
    out: Path
    """The scene's folder; work in progress lies in its `build/`."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads that share the work; the number of cores when absent. They change no result."""

    def __call__(self) -> int:
        from nw_base.errors import SceneError
        from nw_twin.building.build import Build

        build = Build(self.out, settings_of(self, self.workers), _say)
        return 0 if build.whole(self.photographs) else SceneError.exit_code


@dataclass(frozen=True, kw_only=True)
class Calibrate(CalibrateFlags):
    """Find where each photograph was taken from, and take the lens's distortion out."""

    photographs: tyro.conf.Positional[Path]
    """A folder of photographs, a video, or cameras of COLMAP, nerfstudio, Polycam, Record3D or
    another app of docs/how-to/twins.md."""
    out: Path
    """The scene's folder."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads that share the work; the number of cores when absent. They change no result."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.out, settings_of(self, self.workers), _say).calibrate(self.photographs)
        return 0


@dataclass(frozen=True, kw_only=True)
class Reconstruct(ReconstructFlags):
    """Measure the depth of every photograph, and make the mesh."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads that share the work; the number of cores when absent. They change no result."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.scene, settings_of(self, self.workers), _say).reconstruct()
        return 0


@dataclass(frozen=True, kw_only=True)
class Align(AlignFlags):
    """Find which way is up, how large it is, and where the floor is."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.scene, settings_of(self, None), _say).align()
        return 0


@dataclass(frozen=True, kw_only=True)
class TrainSplat(SplatFlags):
    """Train the Gaussians; a training that was cut off goes on."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads that share the work; the number of cores when absent. They change no result."""

    def __call__(self) -> int:
        from nw_twin.building.build import Build

        Build(self.scene, settings_of(self, self.workers), _say).splat()
        return 0


@dataclass(frozen=True, kw_only=True)
class PlaceScene(PlaceFlags, AlignFlags):
    """Write the scene: mesh and splat in metres, and the course that the scene suggests.

    An option of `align` aligns it again first; nothing else is built again.
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
    """Train the splat four times, to compare: from points or the mesh, without or with depths.

    The scene's own splat stays as it is. A training that was cut off goes on.
    """

    scene: tyro.conf.Positional[Path]
    """The scene's folder, with a mesh in its `build/`."""
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Threads that share the work; the number of cores when absent. They change no result."""

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
    """Lay the course through a scene in the browser, till Ctrl-C: start, waypoints, task.

    The page scales, levels, flips and crops the scene too, shows heights along the course and what
    go1-parkour, a policy of a go1, can reach, and proposes a course. Saving writes scene.yaml.
    """

    scene: tyro.conf.Positional[str]
    """A scene folder; with --out any place that a suite can name."""
    out: Path | None = None
    """Label a copy, in this new folder: built-in and fetched places are not edited in place."""
    robot: str = "go1"
    """With --out: the robot of the suite that is written beside the copy."""
    port: int = 0
    """Port to listen at, on this machine's own address only; 0 chooses a free one."""
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
                from nw_eval.cli.terminal.last_words import show_address

                show_address(page.url)
            stop.wait()
        _say_label(_ending(labelling, is_saved=bool(saved)))
        return 0


def settings_of(flags: object, threads: int | None) -> BuildSettings:
    """Return what a build is asked to do; what a verb has no flag for is as it is by default.

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
