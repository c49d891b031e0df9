"""A build of all stages: what is kept, what runs again, and a whole one by night."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from base64 import b64decode
from dataclasses import replace
from io import BytesIO

import cv2
import numpy as np
import pytest
from PIL import Image
from synthetic_room import cameras, render, room
from twin_parts import blobs, captured, placed

from nw_base.errors import SceneError, StoreError
from nw_eval.suite.load import load_suite
from nw_scenes.folder import load_folder
from nw_scenes.mesh import box_mesh, merge, quad_mesh
from nw_splat.camera import Camera
from nw_splat.files import write_splat
from nw_twin.align.alignment import Alignment, ScaleCue, read_alignment, write_alignment
from nw_twin.building.build import Build, BuildSettings
from nw_twin.building.folder import BuildFolder, digest_of_files
from nw_twin.capture import read_capture, write_capture
from nw_twin.reconstruct.depth import write_arrays
from nw_twin.reconstruct.surface import ColourMesh, write_mesh


class Stages:
    """Counts what is done in a build."""

    def __init__(self, scene):
        self.folder = BuildFolder(scene)
        self.done = []
        self.lines = []

    def run(self, stage, of):
        return self.folder.carry_out(stage, [of], lambda: self._leave(stage), self.lines.append)

    def _leave(self, stage):
        self.done.append(stage)
        result = {"calibrate": self.folder.capture / "capture.json"}.get(
            stage, self.folder.mesh / "mesh.ply"
        )
        result.parent.mkdir(parents=True, exist_ok=True)
        result.write_text(stage)


@pytest.fixture
def stages(tmp_path):
    """Calibrated once, of photographs."""
    stages = Stages(tmp_path)
    assert stages.run("calibrate", "photographs")
    return stages


def test_a_stage_runs_once_for_the_same_things_and_again_for_others(stages):
    assert not stages.run("calibrate", "photographs")
    assert stages.lines == ["calibrate: done before, of the same things"]
    assert stages.run("calibrate", "others")
    assert stages.done == ["calibrate", "calibrate"]


def test_a_stage_whose_result_was_removed_runs_again(stages):
    (stages.folder.capture / "capture.json").unlink()
    with pytest.raises(SceneError, match="no result of `calibrate`"):
        stages.folder.needs("calibrate")
    assert stages.run("calibrate", "photographs")
    stages.folder.needs("calibrate")


def test_what_comes_later_runs_again_when_something_before_it_did(stages):
    stages.run("reconstruct", "capture")
    stages.run("calibrate", "others")
    with pytest.raises(SceneError, match="no result of `reconstruct`"):
        stages.folder.needs("reconstruct")


def test_a_stage_that_was_cut_off_has_no_result(tmp_path):
    folder = BuildFolder(tmp_path)

    def cut():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        folder.carry_out("calibrate", ["photographs"], cut, lambda _: None)
    with pytest.raises(SceneError, match=f"nw-eval twin calibrate {tmp_path}"):
        folder.needs("calibrate")


def test_damaged_stamps_are_named(stages):
    (stages.folder.path / "stamps.json").write_text("{")
    with pytest.raises(SceneError, match=r"stamps\.json cannot be read"):
        stages.run("calibrate", "photographs")


def test_a_digest_of_files_changes_with_a_byte_and_with_a_name(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "one.png").write_bytes(b"1")
    first = digest_of_files(tmp_path / "a")
    assert digest_of_files(tmp_path / "a") == first
    (tmp_path / "a" / "one.png").write_bytes(b"2")
    other = digest_of_files(tmp_path / "a")
    (tmp_path / "a" / "one.png").rename(tmp_path / "a" / "two.png")
    assert len({first, other, digest_of_files(tmp_path / "a")}) == 3
    with pytest.raises(StoreError, match="gone"):
        digest_of_files(tmp_path / "gone")


@pytest.fixture
def photographs(tmp_path):
    """A folder of four."""
    (tmp_path / "in").mkdir()
    for number in range(4):
        Image.new("RGB", (64, 48)).save(tmp_path / "in" / f"{number}.jpg")
    return tmp_path / "in"


@pytest.mark.parametrize(
    ("source", "out", "words", "said"),
    [
        ("gone", "room", (), "error: there is nothing at"),
        ("in", "none/..", (), "there is no"),
        ("in", "file/room", (), "file is not a folder"),
        ("in", "file", (), "file is not a folder"),
        ("in", "room", ("--robot", "go9"), "unknown robot 'go9'"),
        ("in", "room", ("--name", "../x"), "name '../x': "),
        ("in", "room", ("--name", ""), "name '': "),
        ("in", "room", ("--held-out", "low_*"), "'low_*' holds out 0 of 4 photographs"),
        ("in", "new/room", ("--held-out", "*.jpg"), "'*.jpg' holds out 4 of 4 photographs"),
        ("in", "new/room", ("--length", "0.jpg:1,1", "0.jpg:99,1", "1"), "outside the photo"),
    ],
)
@pytest.mark.usefixtures("photographs")
def test_a_build_that_cannot_be_is_refused_before_anything_is_computed_and_leaves_nothing(
    source, out, words, said, tmp_path, ended
):
    (tmp_path / "file").write_text("here")
    before = set(tmp_path.rglob("*"))
    code, printed = ended("twin", "build", tmp_path / source, "--out", tmp_path / out, *words)
    assert code == 2
    assert said in printed.err
    assert "photographs read" not in printed.out
    assert set(tmp_path.rglob("*")) == before


def test_a_build_that_is_refused_keeps_an_earlier_capture(photographs, tmp_path, ended):
    capture = tmp_path / "room" / "build" / "capture"
    (capture / ".calibrate.sqlite").mkdir(parents=True)
    (capture / "capture.json").write_text("{}")
    words = ("twin", "build", photographs, "--out", tmp_path / "room", "--held-out", "low_*")
    for said in (r".calibrate.sqlite is a folder; remove it", "holds out 0 of 4"):
        code, printed = ended(*words)
        assert code == 2
        assert said in printed.err
        assert (capture / "capture.json").read_text() == "{}"
        if "folder" in said:
            (capture / ".calibrate.sqlite").rmdir()


@pytest.mark.parametrize(("z", "said"), [(0.0, "ready"), (-1.0, "fix the errors, then")])
def test_a_place_is_checked_and_its_suite_named(tmp_path, z, said):
    boxes = "boxes: [{center: [2.0, 0, 0.05], half_size: [0.5, 1.0, 0.05]}]"
    (tmp_path / "collision.yaml").write_text(boxes)
    (tmp_path / "scene.yaml").write_text(
        "{nw-scene: 1, name: room, task: stairs, licence: MIT, "
        f"trail: [[2.0, 0, 0.1], [4.0, 0, {z}]]}}"
    )
    lines = []
    assert Build(tmp_path, BuildSettings(), lines.append).check() == (said == "ready")
    assert lines[-1] == f"check: {said}: nw-eval run {tmp_path / 'suite.yaml'}"
    assert any("dropped feet sank in" in line for line in lines) == (said == "ready")
    assert any("error waypoint_below_surface" in line for line in lines) == (said != "ready")


METRES = (ScaleCue(name="poses", scale=1.0, difference=0.0, used=True, reason="they are metres"),)
FIELD = quad_mesh((-5, -5, 0), (15, 0, 0), (0, 10, 0), "ground")


@pytest.fixture
def walked(tmp_path):
    """Return a build as its first stages leave it, for a walk along x with the camera ahead, and
    the lines that it says."""

    def run(mesh, height, scales=METRES, **settings):
        lines = []
        build = Build(tmp_path / "room", BuildSettings(**settings), lines.append)
        folder, shots = build.folder, []
        ahead = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        for x in np.arange(-2.0, 5.0, 0.25):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = ahead, (x, 0.0, height)
            camera = Camera.from_fovy(width=64, height=36, fovy=0.8, T_world_camera=pose)
            shots.append(placed(f"{len(shots):03d}.png", camera))
        for path in (folder.capture, folder.mesh, folder.splat):
            path.mkdir(parents=True)
        write_capture(captured(shots), folder.capture)
        colours = np.full((len(mesh.vertices), 3), 99, np.uint8)
        grey = ColourMesh(vertices=mesh.vertices, faces=mesh.faces, colours=colours)
        write_mesh(grey, folder.mesh / "mesh.ply")
        (folder.splat / "splat.ply").write_bytes(b"ply")
        facts = {"scale": 1.0, "gravity": (), "floor_share": 1.0, "warnings": ()}
        write_alignment(Alignment(T_metric_capture=np.eye(4), scales=scales, **facts), folder.align)
        for stage in ("calibrate", "reconstruct", "align", "splat"):
            folder.carry_out(stage, ["a walk"], lambda: None, lambda _: None)
        return build, lines

    return run


def test_a_walk_over_platforms_starts_on_ground_at_zero_with_the_pit_below(walked):
    tops = [
        box_mesh((x, 0.0, 0.2), (half, 0.8, 0.2), (1.0, 0.0, 0.0, 0.0), "obstacle")
        for x, half in ((-0.9, 2.1), (3.5, 1.9))
    ]
    build, lines = walked(merge([FIELD, *tops]), 1.9)
    build.place()
    scene = load_folder(build.folder.scene)
    assert "place: moved by -0.40 m: the ground under the start is z = 0" in lines
    assert not any("move the scene" in line for line in lines)
    assert scene.task == "gaps"
    assert scene.spawn.position[2] == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(scene.trail[:, 2], 0.0, atol=1e-3)
    assert scene.mesh().vertices[:, 2].min() == pytest.approx(-0.4)
    assert scene.T_world_splat[2, 3] == pytest.approx(-0.4)


def test_a_place_with_pits_changes_nothing_that_its_splat_is_of(walked):
    build, _ = walked(FIELD, 1.5)
    (build.folder.mesh / "depth").mkdir()
    for shot in read_capture(build.folder.capture).shots:
        depth = np.zeros((shot.camera.height, shot.camera.width), np.float32)
        write_arrays(
            build.folder.mesh / "depth" / f"{shot.name}.npz", depth=depth, confidence=depth
        )
        Image.new("RGB", (64, 36)).save(build.folder.capture / shot.file)
    before = digest_of_files(build.folder.capture, build.folder.mesh)
    build.place()
    assert digest_of_files(build.folder.capture, build.folder.mesh) == before
    assert (build.folder.path / "ground.ply").is_file()


def test_the_ground_of_the_trail_is_measured_and_written_down(walked):
    build, lines = walked(quad_mesh((-5, -2, 0), (15, 0, 0), (0, 4, 0), "ground"), 1.5)
    points = np.random.default_rng(0).uniform((-2, -1, 0), (6, 1, 0), (2_000, 3))
    write_splat(build.folder.splat / "splat.ply", blobs(points, size=0.05))
    # The mesh is 1 cm above what the photographs show; none shows what is before x = 0.
    for shot in read_capture(build.folder.capture).shots:
        camera = shot.camera
        down = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
        depth = np.where(down > 0.1, 1.51 / np.maximum(down, 0.1), 0.0)
        depth = np.where(depth + camera.T_world_camera[0, 3] > 0.0, depth, 0.0)
        depth = np.repeat(depth[:, None], camera.width, axis=1).astype(np.float32)
        path = build.folder.mesh / "depth" / f"{shot.name}.npz"
        # As little as depths of a road have that is seen at a slant.
        write_arrays(path, depth=depth, confidence=np.full_like(depth, 0.05))
    build.place()
    build.check()
    said = "\n".join(lines)
    assert "check: roughness: the ground is 0 mm off" in said
    assert "check: steps: 0.00 m over 0.04 m at most" in said
    assert "check: depths: mesh and depth maps are 10 mm apart (median), 90 % within 10 mm" in said
    written = json.loads(build.folder.trail.read_text())
    assert written["robot"] == "go1"
    assert {row["roughness"] for row in written["stations"]} == {0.0}
    assert [row["along"] for row in written["stations"][:3]] == [0.0, 0.1, 0.2]
    assert written["stations"][9]["depths_median"] == pytest.approx(0.01, abs=1e-3)
    assert max(row["photographs"] for row in written["stations"]) >= 2
    # The walk begins at x = -2, where the mesh has ground as well.
    assert load_folder(build.folder.scene).spawn.position[0] > -0.5
    assert any(line.startswith("check: no page: ") for line in lines), "no photograph is there"


def test_a_build_ends_with_a_page_of_what_is_known_and_what_is_not(walked):
    build, lines = walked(quad_mesh((-5, -2, 0), (15, 0, 0), (0, 4, 0), "ground"), 1.5)
    folder = build.folder
    points = np.random.default_rng(0).uniform((-2, -1, 0), (6, 1, 0), (500, 3))
    write_splat(folder.splat / "splat.ply", blobs(points, size=0.05))
    (folder.splat / "report.json").write_text('{"psnr": 21.25, "views": [{"name": "a<b>.jpg"}]}')
    (folder.mesh / "report.json").write_text('["of another kind"]')
    for shot in read_capture(folder.capture).shots:
        Image.new("RGB", (64, 36), (40, 80, 120)).save(folder.capture / shot.file)
        depth = np.zeros((36, 64), np.float32)
        depth[27:] = 1.5 * shot.camera.fy / (np.arange(27, 36)[:, None] + 0.5 - shot.camera.cy)
        path = folder.mesh / "depth" / f"{shot.name}.npz"
        write_arrays(path, depth=depth, confidence=np.ones_like(depth))
    build.place()
    build.check()
    assert f"check: pictures, and how well all is known: {folder.page}" in lines
    page = folder.page.read_text()
    pictures = [
        np.asarray(Image.open(BytesIO(b64decode(data))))
        for data in re.findall(r"data:image/jpeg;base64,([\w+/=]+)", page)
    ]
    assert len(pictures) == 6
    photograph, _, mesh, unknown, *_ = pictures
    assert abs(photograph[18, 32].astype(int) - (40, 80, 120)).max() < 6
    assert mesh[2, 32].min() > 245, "open above the horizon"
    assert mesh[33, 32].max() < 130, "grey ground below it"
    assert unknown[10, 32, 0] > 110, "red where no depth is known"
    assert unknown[34, 32, 0] < 60, "as it was where one is"
    assert "28 placed of 28" in page.replace("\u00a0", " ")
    assert "21.2 dB" in page.replace("\u00a0", " ")
    first = folder.page.read_bytes()
    build.check()
    assert folder.page.read_bytes() == first
    (folder.mesh / "report.json").write_text(f'{{"coverage": 1{"0" * 400}}}')
    build.check()
    assert "of the pixels" not in folder.page.read_text(), "it is damaged"
    folder.page.unlink()
    folder.page.mkdir()
    build.check()
    assert any(line.startswith("check: no page: cannot write ") for line in lines)


def test_a_place_without_room_for_a_trail_says_why_and_names_the_label_page(walked):
    build, lines = walked(quad_mesh((0, 0, 0), (1.1, 0, 0), (0, 0.8, 0), "ground"), 1.5)
    build.place()
    (why,) = [line for line in lines if line.startswith("place: no course: ")]
    assert "too little for a waypoint 0.60 m from the start, with 0.60 m behind it" in why
    assert any(line.endswith(f"nw-eval twin label {build.folder.scene}") for line in lines)


def test_a_place_without_a_scale_is_written_marked_and_runs_nowhere(walked, ended):
    build, lines = walked(FIELD, 1.5, scales=())
    room = build.folder.scene
    build.place()
    (said,) = [line for line in lines if "not to scale" in line]
    assert f"nw-eval twin place {room} --length A B METRES" in said
    assert not build.check()
    assert any("error not_to_scale" in line for line in lines)
    assert load_folder(room, needs_scale=False).trail.shape[1] == 3
    for words in (("run", room / "suite.yaml"), ("scenes", "check", room)):
        code, printed = ended(*words)
        assert code == 2
        assert "nw-eval twin label" in printed.out + printed.err


@pytest.fixture
def unscaled(walked):
    """A place without a scale, whose points are seen by all shots of a walk; asked to be called
    otherwise."""
    asked = {"name": "my-room", "licence": "CC0-1.0", "robot": "go2"}
    build, _ = walked(FIELD, 1.5, scales=(), **asked)
    points = np.random.default_rng(0).uniform((-2, -2, 0), (6, 2, 0), (400, 3))
    seen = np.arange(len(points), dtype=np.int32)
    shots = [replace(shot, seen=seen) for shot in read_capture(build.folder.capture).shots]
    write_capture(captured(shots, points), build.folder.capture)
    build.place()
    return build


def test_a_length_scales_a_place_that_is_built_and_no_other_stage_runs_again(unscaled, ended):
    room = unscaled.folder.scene
    before = (room / "build" / "stamps.json").read_text()
    # 30 pixels below the middle of a picture that is 36 high is far below its lower edge.
    for ends, code, said in (
        (["003.png:20,1", "003.png:44,30"], 2, "the point 003.png:20,1 does not meet the surface"),
        (["003.png:20,30", "03.png:44,30"], 2, "'03.png', which is not a shot of the capture"),
        (["003.png:20,30", "003.png:44,30"], 0, "scale by length"),
    ):
        left, printed = ended("twin", "place", room, "--length", *ends, "6.0")
        assert left == code
        assert said in printed.out + printed.err
        if code:  # What was there before still holds.
            assert (room / "build" / "stamps.json").read_text() == before
    # The two pixels were 24 of 64 apart, on ground that the picture shows 30 - 18 pixels down.
    camera = read_capture(room / "build" / "capture").shots[0].camera
    units = 24 / camera.fx * (1.5 * camera.fx / 12.5)
    found = load_folder(room).T_world_splat[:3, :3]
    assert np.diag(found) == pytest.approx(6.0 / units, abs=1e-6)
    # How cameras are pitched moves up by less than 0.01 degrees beside a floor.
    assert found == pytest.approx(6.0 / units * np.eye(3), abs=5e-4)
    unscaled.folder.needs("splat")
    # Name, licence and robot are what they were, but for what is asked for now.
    changed = ("--licence", "MIT", "--robot", "go1")
    for words, licence, robot in (((), "CC0-1.0", "go2"), (changed, "MIT", "go1")):
        ended("twin", "place", room, *words)
        scene, suite = load_folder(room), load_suite(room / "suite.yaml")
        assert (scene.name, scene.licence, suite.robot) == ("my-room", licence, robot)


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_a_room_with_a_tag_becomes_a_place_in_metres(tmp_path, ended):
    marks = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag = cv2.aruco.generateImageMarker(marks, 3, 800, borderBits=1)
    tag = cv2.copyMakeBorder(tag, 80, 80, 80, 80, cv2.BORDER_CONSTANT, value=255)
    patches = room(0, tag=np.repeat(tag[..., None], 3, 2), tag_edge=0.3)
    (tmp_path / "photographs").mkdir()
    places = cameras(24, width=480, height=270)
    for number, camera in enumerate(places):
        picture = render(patches, camera)[..., ::-1]
        cv2.imwrite(str(tmp_path / "photographs" / f"IMG_{number:04d}.png"), picture)
    scene = tmp_path / "room"
    words = ("twin", "build", tmp_path / "photographs", "--out", scene, "--tag-edge", "0.25")
    words += ("--iterations", "300", "--licence", "CC0-1.0")
    code, printed = ended(*words)
    # The cameras stand about the room: that is no trail, and a hole where it would begin.
    assert code == 2
    assert "place: no course: " in printed.out
    assert "check: error ground_missing" in printed.out

    loaded = load_folder(scene)
    assert loaded.captures is not None
    assert loaded.splat is not None
    T = read_alignment(scene / "build" / "align.json").T_metric_capture
    capture = read_capture(scene / "build" / "capture")
    named = {shot.name: shot.camera.T_world_camera[:3, 3] for shot in capture.shots}
    found = np.array([named[f"IMG_{n:04d}.png"] for n in range(24)])
    true = np.array([camera.T_world_camera[:3, 3] for camera in places])
    metric = found @ T[:3, :3].T + T[:3, 3]
    spans = [np.linalg.norm(x[1:] - x[:-1], axis=1).sum() for x in (metric, true)]
    assert spans[0] == pytest.approx(spans[1], rel=0.01), "metres, within one percent"
    np.testing.assert_allclose(metric[:, 2], true[:, 2], atol=0.02)
    assert ended(*words)[1].out.count("done before, of the same things") == 5


HOLDER = """
import subprocess
import sys
from pathlib import Path
from nw_twin.building.folder import BuildFolder
with BuildFolder(Path(sys.argv[1])).held():
    print("held", flush=True)
    sys.stdin.read()
"""


def test_of_two_builds_on_one_folder_the_second_names_the_first_at_once(
    photographs, tmp_path, ended
):
    scene = tmp_path / "room"
    first = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(scene)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert first.stdout.readline() == b"held\n"
    before = sorted(scene.rglob("*"))
    for verb in ("build", "calibrate"):
        code, printed = ended("twin", verb, photographs, "--out", scene)
        assert (code, printed.out) == (2, "")
        said = f"{scene} is being built by process {first.pid}; wait for it or stop it"
        assert said in printed.err
    assert sorted(scene.rglob("*")) == before
    first.kill()  # Whoever dies lets go.
    first.communicate()
    with BuildFolder(scene).held():
        pass


def test_a_refused_build_leaves_no_folder_and_a_stage_within_a_build_is_not_refused(tmp_path):
    folder = BuildFolder(tmp_path / "room")
    with pytest.raises(ZeroDivisionError), folder.held():
        assert 1 / 0
    assert not folder.scene.exists()
    with folder.held(), folder.held():
        assert folder.carry_out("calibrate", ["photographs"], lambda: None, lambda _: None)
