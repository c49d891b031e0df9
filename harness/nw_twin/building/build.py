"""The stages of a build as its verbs run them: what each reads, leaves, and depends on.

Each runs only where its result is not there already. How long the slow ones will take, and how much
memory, is said before they begin.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError, StoreError, SuiteError, UsageError
from nw_base.files.cache import atomic_path, check_place
from nw_eval.api import check_scenes
from nw_eval.suite.load import check_has_policy, load_suite
from nw_scenes.finding import SceneFinding, has_errors
from nw_scenes.folder import load_folder
from nw_scenes.limits import name_of
from nw_scenes.robots import get_robot
from nw_sim.survey import Survey, footing_lines, survey_lines
from nw_sim.survey.course import stance_of
from nw_twin.align.ahead import (
    check_points,
    facts_of_source,
    later,
    read_facts,
    scale_lines,
    write_facts,
)
from nw_twin.align.align import align
from nw_twin.align.alignment import AlignOptions, read_alignment, write_alignment
from nw_twin.building.appearance import COARSE, AppearanceOptions, check_held_out, train_splat
from nw_twin.building.folder import BuildFolder, digest_of_files
from nw_twin.building.page import write_page
from nw_twin.building.pits import with_pits
from nw_twin.building.unlike import (
    SURE,
    DepthDifferences,
    depth_differences,
    difference_findings,
    seen_depths,
    shown_ground,
    unlike_photographs,
)
from nw_twin.calibrate.calibrate import calibrate
from nw_twin.calibrate.photographs import Footage
from nw_twin.capture import Capture, read_capture
from nw_twin.course import FLOOR, CourseProposal, propose_course, propose_free_course
from nw_twin.options import CalibrateOptions, ReconstructOptions
from nw_twin.place import (
    SUITE,
    Route,
    check_scene_name,
    moved_capture,
    moved_mesh,
    write_place,
)
from nw_twin.reconstruct.reconstruct import reconstruct
from nw_twin.reconstruct.surface import ColourMesh, read_colour_mesh, write_mesh

Say = Callable[[str], None]

_MATCH_S = 10e-6
"""Seconds of one core for a pixel and a neighbour of matching, all rounds."""
_PLANES_S = 3.0 / (640 * 360 * 5)
"""Seconds of one core for a pixel and a neighbour, of giving each pixel its plane."""
_MATCH_BYTES = (60, 40)
"""Of a pixel of every picture in matching, and of one and a neighbour in each thread."""
_STEP_S = (0.02, 0.7e-6, 0.9e-6)
"""Seconds of one core for a step of training: at least, for a Gaussian, and for a pixel."""
_GAUSSIAN_BYTES = 1500
"""Of a Gaussian in training: values, gradients, moments, and room to grow."""
_LISTED_PITS = 5
"""Pits that are named, the largest first."""


@dataclass(frozen=True, kw_only=True)
class BuildSettings:
    """Options of each stage, and what the scene is called.

    Attributes:
        calibrate: of calibration.
        reconstruct: of the mesh.
        align: gravity and scale.
        splat: of the Gaussians.
        name: of the scene. If None, that of the scene that is there, else the folder's.
        licence: of the photographs, which the scene shows. If None, that of the scene that is
            there, else `unknown`.
        robot: of the scene's suite, by which the scene is checked. If None, that of the suite that
            is there, else a Go1.
        threads: that share the work; no result depends on them.
    """

    calibrate: CalibrateOptions = field(default_factory=CalibrateOptions)
    reconstruct: ReconstructOptions = field(default_factory=ReconstructOptions)
    align: AlignOptions = field(default_factory=AlignOptions)
    splat: AppearanceOptions = field(default_factory=AppearanceOptions)
    name: str | None = None
    licence: str | None = None
    robot: str | None = None
    threads: int = 2

    def __post_init__(self) -> None:
        """Check the name; SceneError says what cannot be."""
        if self.name is not None:
            check_scene_name(self.name)


def facts_of(options: Any) -> str:
    """Return options as text that is the same whenever they ask for the same."""
    return repr(sorted((k, v) for k, v in asdict(options).items() if k != "threads"))


class Build:
    """A build of a scene from photographs, in the folder of its scene.

    Each method is a stage. What is there already, of the same photographs and options, stays; what
    was cut off goes on.

    Args:
        scene: the folder of the scene.
        settings: the options given.
        say: takes a line for people.
    """

    def __init__(self, scene: Path, settings: BuildSettings, say: Say) -> None:
        self.folder = BuildFolder(scene)
        self._settings = settings
        self._say = say

    def whole(self, photographs: Path) -> bool:
        """Run all stages, one after another; return whether the check finds no error.

        Raises:
            NwEvalError: as the stages.
        """
        # A robot that is not there, or that no suite can be written for, is said before slow work.
        get_robot(self._robot())
        check_has_policy(self._robot())
        self._check_paths(photographs)
        with self.folder.held():
            self.calibrate(photographs)
            self.reconstruct()
            self.align()
            self.splat()
            self.place()
            return self.check()

    def _check_paths(self, photographs: Path) -> None:
        for place in (self.folder.scene, self.folder.capture / "pictures"):
            check_place(place)
        if not photographs.exists():
            raise UsageError(f"there is nothing at {photographs}", fix="check the path")

    def calibrate(self, photographs: Path) -> None:
        """Find where each photograph was taken from; see `nw_twin.calibrate`."""
        self._check_paths(photographs)
        with self.folder.held():
            self._calibrate(photographs)

    def _calibrate(self, photographs: Path) -> None:
        options = self._settings.calibrate
        if not self.folder.carry_out(
            "calibrate",
            [facts_of(options), digest_of_files(photographs)],
            lambda: calibrate(
                photographs, self.folder.capture, options, self._say, self._look_ahead
            ),
            self._say,
        ):
            lengths = self._settings.align.lengths
            sizes = {s.name: s.photographed for s in read_capture(self.folder.capture).shots}
            check_points(lengths, sizes, sizes.get)
            check_held_out(self._settings.splat.held_out, list(sizes))
            facts = read_facts(self.folder.capture)
            for line in scale_lines(facts, self._settings.align, self.folder.scene):
                self._say(line)

    def _look_ahead(self, footage: Footage) -> None:
        """Check options by the source before the slow work, and say what will give the scale."""
        readable = [one.name for one in footage.files if one.path is not None]
        check_held_out(self._settings.splat.held_out, readable)
        facts = facts_of_source(footage, self._settings.align)
        for line in scale_lines(facts, self._settings.align, self.folder.scene):
            self._say(line)
        write_facts(facts, self.folder.capture)

    def reconstruct(self) -> None:
        """Measure depths and make the mesh; see `nw_twin.reconstruct`."""
        self.folder.needs("calibrate")
        options, threads = self._settings.reconstruct, self._settings.threads
        self.folder.carry_out(
            "reconstruct",
            [facts_of(options), digest_of_files(self.folder.capture)],
            lambda: (
                say_ahead("reconstruct", self.folder, self._settings, self._say),
                reconstruct(
                    self.folder.capture, self.folder.mesh, options, self._say, threads=threads
                ),
            ),
            self._say,
        )

    def align(self) -> None:
        """Find gravity, scale and the floor; see `nw_twin.align`."""
        self.folder.needs("reconstruct")
        options = self._settings.align
        facts = read_facts(self.folder.capture)
        if facts is not None:
            shots = read_capture(self.folder.capture).shots
            options = facts.completed(options, [shot.name for shot in shots])
        mesh_file = self.folder.mesh / "mesh.ply"

        def work() -> None:
            mesh = read_colour_mesh(mesh_file)
            alignment = align(
                read_capture(self.folder.capture),
                self.folder.capture,
                (mesh.vertices.astype(np.float64), mesh.faces),
                options,
                self._say,
            )
            if not alignment.is_to_scale:
                self._say(f"align: not to scale: {later(self.folder.scene)}")
            write_alignment(alignment, self.folder.align)

        of = [facts_of(options), digest_of_files(self.folder.capture, mesh_file)]
        self.folder.carry_out("align", of, work, self._say)

    def splat(self) -> None:
        """Train the Gaussians; see `nw_twin.building.appearance`."""
        self.folder.needs("reconstruct")
        options, threads = self._settings.splat, self._settings.threads
        self.folder.carry_out(
            "splat",
            [facts_of(options), digest_of_files(self.folder.capture, self.folder.mesh)],
            lambda: (
                say_ahead("splat", self.folder, self._settings, self._say),
                train_splat(
                    self.folder.capture,
                    self.folder.mesh,
                    self.folder.splat,
                    options,
                    self._say,
                    threads=threads,
                ),
            ),
            self._say,
        )

    def place(self) -> None:
        """Write the scene folder, with the course that the scene itself suggests."""
        for stage in ("reconstruct", "align", "splat"):
            self.folder.needs(stage)
        folder, robot = self.folder, self._robot()
        name, licence = self._name_and_licence()
        mesh_file, splat_file = folder.mesh / "mesh.ply", folder.splat / "splat.ply"
        of = [name, licence, digest_of_files(folder.align, mesh_file, splat_file)]
        of += [] if robot == "go1" else [robot]
        folder.carry_out("place", of, lambda: self._write(name, licence, robot), self._say)

    def _name_and_licence(self) -> tuple[str, str]:
        """Return both as asked for, else as the scene has them that is there."""
        name, licence = self._settings.name, self._settings.licence
        try:
            there = load_folder(self.folder.scene, needs_scale=False)
            name, licence = name or there.name, licence or there.licence
        except SceneError:  # There is none yet, or a damaged one, which is written anew.
            name = name or name_of(self.folder.scene.resolve().name.lower())
        return name, licence or "unknown"

    def _robot(self) -> str:
        """Return the robot that is asked for, else that of the suite that is there."""
        if self._settings.robot is not None:
            return self._settings.robot
        try:
            robot = load_suite(self.folder.scene / SUITE).robot
        except (UsageError, SuiteError):  # As a scene that cannot be read.
            return "go1"
        return str(self.folder.scene / robot) if robot.startswith((".", "/")) else robot

    def _write(self, name: str, licence: str, robot: str) -> None:
        folder = self.folder
        aligned = read_alignment(folder.align)
        world = aligned.T_metric_capture
        mesh_file = folder.mesh / "mesh.ply"
        mesh = read_colour_mesh(mesh_file)
        capture = read_capture(folder.capture)
        depths = folder.mesh / "depth"
        pictures = all((folder.capture / shot.file).is_file() for shot in capture.shots)
        if depths.is_dir() and pictures:  # Else somebody has cleared them away.
            mesh, pits = with_pits(mesh, capture, folder.capture, depths, world)
            mesh_file = folder.path / "ground.ply"  # `splat` is of all that is in mesh/.
            write_mesh(mesh, mesh_file)
            for pit in pits[:_LISTED_PITS]:
                self._say(f"place: {pit}")
        try:
            proposal = self._proposal(world, mesh, capture, robot)
            height = proposal.spawn.position[2]
            if abs(height) > FLOOR:
                # A walk over platforms has its floor below them, and robots start above z = 0.
                world = np.vstack([world[:2], world[2] - height * world[3], world[3]])
                proposal = self._proposal(world, mesh, capture, robot, silent=True)
                self._say(f"place: moved by {-height:+.2f} m: the ground under the start is z = 0")
            route = self._route(proposal)
        except SceneError as error:
            route = self._no_route(error)
        write_place(
            folder.scene,
            name=name,
            licence=licence,
            mesh=mesh_file,
            splat=folder.splat / "splat.ply",
            T_world_capture=world,
            capture=capture,
            course=route,
            robot=robot,
            to_scale=aligned.is_to_scale,
        )
        if not aligned.is_to_scale:
            self._say(f"place: not to scale: {later(self.folder.scene)}")
        self._say(f"place: {folder.scene} is a scene: nw-eval scenes check {folder.scene}")

    def check(self) -> bool:
        """Say what is measured and wrong along the course, and how the scene is run.

        Returns whether no error is found. The scene stays as it is, whatever is found: most is
        mended by hand.

        Raises:
            SceneError: what an earlier stage has left is damaged.
        """
        (checked,) = check_scenes([str(self.folder.scene)], robot=self._robot())
        survey = checked.survey
        if survey is not None:
            for line in (*survey_lines(survey), *footing_lines(survey)):
                self._say(f"check: {line}")
        findings = list(checked.findings)
        if all(finding.code != "unreadable" for finding in findings):
            findings += self._unlike_photographs(survey)
        for finding in findings:
            self._say(f"check: {finding}")
        self._write_page(findings, survey)
        suite, wrong = shlex.quote(str(self.folder.scene / SUITE)), has_errors(findings)
        if wrong:
            self._say(f"check: fix the errors, then: nw-eval run {suite}")
        else:
            self._say(f"check: ready: nw-eval run {suite}")
        return not wrong

    def _write_page(self, findings: Sequence[SceneFinding], survey: Survey | None) -> None:
        """Write the page of the build where everything that it shows is still there."""
        folder = self.folder
        needed = (folder.capture / "capture.json", folder.mesh / "depth", folder.align)
        if not all(path.exists() for path in (*needed, folder.splat / "splat.ply")):
            return
        try:
            scene = load_folder(folder.scene, needs_scale=False)
            write_page(folder, scene, self._robot(), findings, survey)
        except (SceneError, StoreError) as error:
            self._say(f"check: no page: {error}")
        else:
            self._say(f"check: pictures, and how well all is known: {folder.page}")

    def _unlike_photographs(self, survey: Survey | None) -> list[SceneFinding]:
        """Return where the mesh along the course is not as its own photographs show it.

        Where the course was surveyed, `trail.json` is written, and what depths differ by is said.
        """
        scene = load_folder(self.folder.scene, needs_scale=False)
        depths = self.folder.mesh / "depth"
        captured = (self.folder.capture / "capture.json").is_file() and depths.is_dir()
        if scene.splat is None or not captured:
            return []  # A scene from elsewhere, or whose build was cleared away: unknown.
        line = np.array([scene.spawn.position, *scene.trail])
        # The splat is in the capture's frame, wherever the scene was moved to since.
        capture, T = read_capture(self.folder.capture), scene.T_world_splat
        findings = unlike_photographs(scene.mesh(), line, seen_depths(capture, T, depths, SURE))
        if survey is not None:
            footing = survey.ground.footing
            seen = seen_depths(capture, T, depths)
            differences = depth_differences(scene.mesh(), footing.places, seen)
            self._say(f"check: {differences}")
            findings += difference_findings(differences, footing.along, footing.places)
            self._write_trail(survey, differences)
        return findings

    def _write_trail(self, survey: Survey, differences: DepthDifferences) -> None:
        """Write what is measured at each station of the course, metres and radians."""
        footing = survey.ground.footing
        columns = {
            "along": footing.along,
            "roughness": footing.roughness,
            "step": footing.step,
            "slope": footing.slope,
            "depths_median": differences.median,
            "depths_90": differences.most,
        }
        names = ("x", "y", "z", *columns, "photographs")
        values = np.column_stack([footing.places, *columns.values()]).round(4)
        rows = [
            dict(zip(names, [*(None if np.isnan(v) else v for v in row), count], strict=True))
            for row, count in zip(values.tolist(), differences.photographs.tolist(), strict=True)
        ]
        content = {"robot": survey.robot, "length": round(survey.length, 4), "stations": rows}
        with atomic_path(self.folder.trail) as temporary:
            temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")
        self._say(f"check: each 0.1 m of the course is in {self.folder.trail}")

    def _no_route(self, error: SceneError) -> Route:
        self._say(f"place: no course: {error}")
        self._say(
            "place: its course is one waypoint a metre from the start, for you to replace: "
            f"nw-eval twin label {shlex.quote(str(self.folder.scene))}"
        )
        return Route(task="hurdles", trail=np.array([[1.0, 0.0, 0.0]]))

    def _proposal(
        self,
        T_metric_capture: NDArray[np.float64],
        mesh: ColourMesh,
        capture: Capture,
        robot: str,
        *,
        silent: bool = False,
    ) -> CourseProposal:
        """Return the course of the walk, or else of the longest level ground, for the robot.

        Raises:
            SceneError: neither has enough ground.
        """
        moved = moved_mesh(T_metric_capture, mesh.vertices, mesh.faces)
        centres = moved_capture(T_metric_capture, capture).centres
        stance = stance_of(get_robot(robot))
        size = {"length": stance.length, "half_width": stance.half_width}
        depths, shown = self.folder.mesh / "depth", None
        if depths.is_dir():
            shown = shown_ground(moved, seen_depths(capture, T_metric_capture, depths))
        say = (lambda _: None) if silent else self._say
        walked = None
        try:
            walked = propose_course(moved, centres, **size, shown=shown)
            if walked.features or walked.whole:
                return walked
            say("place: where the cameras went the ground has holes")
        except SceneError as error:
            say(f"place: no course where the cameras went: {error}")
        try:
            free = propose_free_course(moved, centres, **size, shown=shown)
        except SceneError:
            if walked is None:
                raise
            return walked
        say("place: the course is on the longest straight strip of level ground")
        return free

    def _route(self, proposal: CourseProposal) -> Route:
        """Return the course that the scene suggests, and say what lies on it."""
        for line in (*proposal.reasons, *proposal.warnings):
            self._say(f"place: {line}")
        spawn = proposal.spawn
        return Route(
            task=proposal.task,
            trail=np.array(proposal.trail),
            spawn=spawn.position,
            yaw=spawn.yaw,
        )


def say_ahead(
    stage: Literal["reconstruct", "splat"],
    folder: BuildFolder,
    settings: BuildSettings,
    say: Callable[[str], None],
) -> None:
    """Say what a stage will take: by what was measured on a core of 2026, to a factor of two.

    Args:
        stage: which.
        folder: with the capture.
        settings: of the build.
        say: takes a line for people.

    Raises:
        SceneError: the capture cannot be read.
    """
    capture = read_capture(folder.capture)
    if stage == "reconstruct":
        seconds, memory = _matching(capture, settings)
    else:
        seconds, memory = _training(capture, settings)
    minutes = max(1, round(seconds / min(settings.threads, 2) / 60))
    say(
        f"{stage}: {len(capture.shots)} photographs, about {minutes} min and {memory / 1e9:.1f} GB "
        f"on {settings.threads} cores"
    )


def _matching(capture: Capture, settings: BuildSettings) -> tuple[float, float]:
    depth, shots = settings.reconstruct.depth, len(capture.shots)
    pixels, whole, each = _pixels(capture, depth.side), *_MATCH_BYTES
    work = shots * pixels * depth.neighbours * (_MATCH_S + _PLANES_S)
    at_once = settings.threads * depth.neighbours * each
    return work, 0.4e9 + pixels * (shots * whole + at_once)


def _training(capture: Capture, settings: BuildSettings) -> tuple[float, float]:
    options = settings.splat
    least, each, pixel = _STEP_S
    pixels = _pixels(capture, options.longest) * (1.0 - 0.75 * COARSE)
    step = least + each * options.most / 2 + pixel * pixels
    return options.steps(len(capture.shots)) * step, 0.4e9 + options.most * _GAUSSIAN_BYTES


def _pixels(capture: Capture, longest: int) -> float:
    camera = capture.shots[0].camera
    scale = min(1.0, longest / max(camera.width, camera.height))
    return camera.width * camera.height * scale * scale
