"""Robots from elsewhere: a folder on a hub, and a model of MuJoCo Menagerie."""

import json
import tarfile
from pathlib import Path

import pytest

from nw_base.errors import FetchError, PolicyError, PrerequisiteError, RobotError
from nw_eval import api
from nw_eval.cli import main
from nw_policies.cards import load_card
from nw_scenes.robots import find_robot, get_robot, know_robot

MODEL = """\
<mujoco model="table">
  <compiler meshdir="assets" autolimits="true"/>
  <include file="legs.xml"/>
  <asset><mesh name="plate" file="plate.obj"/></asset>
  <worldbody><body name="top" pos="0 0 0.4"><freejoint/>
    <geom type="mesh" mesh="plate" mass="6"/>
    <body name="leg_l" pos="0 0.15 0"><joint name="hip_l" axis="0 1 0" range="-1 1"/>
      <geom type="capsule" fromto="0.2 0 0 0.2 0 -0.3" size="0.02" mass="0.5"/></body>
    <body name="leg_r" pos="0 -0.15 0"><joint name="hip_r" axis="0 1 0" range="-1 1"/>
      <geom type="capsule" fromto="-0.2 0 0 -0.2 0 -0.3" size="0.02" mass="0.5"/></body>
  </body></worldbody>
</mujoco>
"""
SERVOS = """\
<mujoco><actuator>
  <position joint="hip_l" kp="60" kv="2" forcerange="-30 30"/>
  <position joint="hip_r" kp="60" kv="2" forcerange="-30 30"/>
</actuator></mujoco>
"""
PLATE = "".join(
    f"v {x} {y} {z}\n" for x in (-0.25, 0.25) for y in (-0.15, 0.15) for z in (-0.03, 0.03)
) + ("f 1 2 3\nf 2 3 4\nf 5 6 7\nf 6 7 8\nf 1 2 5\nf 3 4 7\n")
YAML = "nw-robot: 1\nname: table\nmodel: {file: table.xml}\n"
CARD = """\
nw-policy: 1
name: still
robot: table
adapter: zero
control: {action: joint_position_offset, scale: 0.25}
"""
SUITE = """\
nw-eval: 1
name: little
robot: hub:lab/table
policy: ./still
trials: 1
seed: 1
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
"""
FILES = {"table.xml": MODEL, "legs.xml": SERVOS, "assets/plate.obj": PLATE}


def on_hub(hub, files=None):
    files = FILES | {"robot.yaml": YAML} if files is None else files
    return hub.add("models", "lab/table", {name: text.encode() for name, text in files.items()})


def test_a_suite_runs_with_a_robot_of_a_hub_whose_revision_its_run_names(hub, tmp_path, capsys):
    commit = on_hub(hub).revisions["main"]
    (tmp_path / "still").mkdir()
    (tmp_path / "still" / "policy.yaml").write_text(CARD)
    (tmp_path / "little.yaml").write_text(SUITE)
    command = ["run", str(tmp_path / "little.yaml"), "--baseline", "none", "--out"]
    with pytest.raises(SystemExit, match=r"^0$"):
        main([*command, str(tmp_path / "first")])
    assert f"fetching hub:lab/table, revision {commit[:12]}" in capsys.readouterr().err
    hub.close()
    with pytest.raises(SystemExit, match=r"^0$"):
        main([*command, str(tmp_path / "second"), "--no-cache"])
    first, second = (
        json.loads((tmp_path / name / "run.json").read_text()) for name in ("first", "second")
    )
    assert first["robot_fetched"]["revision"] == commit
    assert set(first["robot_fetched"]["files"]) == {*FILES, "robot.yaml"}
    assert first["rows_digest"] == second["rows_digest"]
    assert f"hub:lab/table {commit[:12]}" in (tmp_path / "first" / "report.html").read_text()


def test_a_repository_without_a_robot_is_none(hub):
    on_hub(hub, FILES)
    with pytest.raises(RobotError, match=r"hub:lab/table: its revision \w{12} has no robot.yaml"):
        find_robot("hub:lab/table")


def test_a_reference_that_names_nothing_is_refused():
    with pytest.raises(RobotError, match="'hub:lab' names nothing on a hub; write hub:org/name"):
        find_robot("hub:lab")
    with pytest.raises(RobotError, match=r"'menagerie:../x' names no robot of MuJoCo Menagerie"):
        find_robot("menagerie:../x")


@pytest.mark.parametrize("reference", ["hub:lab/table", "menagerie:table"])
def test_neither_a_trial_nor_a_card_of_a_stranger_has_a_robot_fetched(hub, tmp_path, reference):
    on_hub(hub)
    with pytest.raises(RobotError, match=f"a trial of the robot '{reference}', which is not its"):
        know_robot(reference, tmp_path)
    (tmp_path / "policy.yaml").write_text(CARD.replace("robot: table", f"robot: {reference}"))
    with pytest.raises(PolicyError, match="a card names its robot by name"):
        load_card(tmp_path / "policy.yaml")
    assert not hub.calls


@pytest.fixture
def menagerie(tmp_path, monkeypatch):
    """Return a function of a model's files, which makes Menagerie be that one robot.

    It is packed and fetched by the package itself, from a folder of this machine.
    """
    package = pytest.importorskip("mujoco_menagerie", reason="needs the extra robots")
    if not hasattr(tarfile, "data_filter"):
        pytest.skip("the package needs Python 3.11.4 or newer")
    from mujoco_menagerie._archive import sha256_file, write_archive

    shelf = tmp_path / "shelf"
    shelf.mkdir()
    monkeypatch.setenv("MENAGERIE_BASE_URL", shelf.as_uri())
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "packages"))
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)

    def stocked(files=FILES, oid="ab" * 20, scene=None):
        files = files if scene is None else files | {"scene.xml": scene}
        source = tmp_path / f"source-{oid}"
        for name, text in files.items():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_text(text)
        archive = shelf / f"table-{oid[:16]}.tar.xz"
        write_archive(source, [source / name for name in files], archive, "table")
        listed = {
            "display_name": "Table",
            "category": "quadruped",
            "license": "MIT",
            "oid": oid,
            "asset": archive.name,
            "sha256": sha256_file(archive),
            "download_size": archive.stat().st_size,
            "installed_size": 1,
            "entry_points": {
                "table": {"kind": "robot", "file": "table.xml"},
                "scene": {"kind": "scene", "file": "scene.xml"},
            },
            "default_model": "table",
            "default_scene": None if scene is None else "scene",
        }
        registry = package.Registry.from_dict(
            {"schema": 1, "menagerie_commit": "0" * 40, "robots": {"table": listed}}
        )
        monkeypatch.setattr(package, "bundled", lambda: registry)
        return archive

    return stocked


def test_a_robot_of_menagerie_is_derived_from_its_model_alone(menagerie, ears):
    archive = menagerie()
    fetched = api.fetch_robot("menagerie:table", listener=ears)
    assert [name for name, done, total in ears.heard if done == total] == ["table"]
    assert set(fetched.files) == {*FILES, "robot.yaml"}
    archive.unlink()
    found = find_robot("menagerie:table")
    assert found.spec == get_robot(found.reference)
    assert found.reference == f"table@{found.identity}"
    assert found.folder == fetched.folder.resolve()
    assert (found.spec.joints, found.spec.feet) == (("hip_l", "hip_r"), ("leg_l", "leg_r"))
    assert (found.spec.kp, found.spec.joint_damping) == ((60.0, 60.0), (2.0, 2.0))
    assert found.spec.torque_limits == (30.0, 30.0)
    assert "# Table of MuJoCo Menagerie, licence MIT" in (found.folder / "robot.yaml").read_text()


def test_a_robot_of_menagerie_stays_what_it_was_until_it_is_fetched_again(menagerie):
    menagerie()
    first = find_robot("menagerie:table")
    menagerie(FILES | {"legs.xml": SERVOS.replace('kp="60"', 'kp="70"')}, oid="cd" * 20)
    assert find_robot("menagerie:table") == first
    with pytest.raises(RobotError, match=f"has revision {'cd' * 20} of it"):
        api.fetch_robot(f"menagerie:table@{'ef' * 20}")
    api.fetch_robot("menagerie:table")
    assert find_robot("menagerie:table").spec.kp == (70.0, 70.0)
    assert find_robot(f"menagerie:table@{'ab' * 20}").spec.kp == (60.0, 60.0)


SCENE = """\
<mujoco>
  <include file="table.xml"/>
  <worldbody><light pos="0 0 2"/><geom name="floor" type="plane" size="1 1 1"/></worldbody>
  <keyframe><key name="up" qpos="0 0 0.4 1 0 0 0 0.3 -0.2"/></keyframe>
</mujoco>
"""


def test_a_pose_that_stands_beside_the_floor_is_the_robots(menagerie):
    menagerie(scene=SCENE)
    spec = find_robot("menagerie:table").spec
    assert spec.default_pose == (0.3, -0.2)
    assert "floor" not in spec.mjcf
    menagerie(oid="cd" * 20, scene=SCENE.replace("key name", "kez name"))
    assert api.fetch_robot("menagerie:table").files.keys() == {*FILES, "robot.yaml"}
    assert find_robot("menagerie:table").spec.default_pose == (0.0, 0.0)


def test_what_menagerie_does_not_say_is_written_in_a_copy(menagerie):
    menagerie(
        FILES | {"legs.xml": SERVOS.replace("position", "motor").replace(' kp="60" kv="2"', "")}
    )
    with pytest.raises(RobotError) as caught:
        find_robot("menagerie:table")
    message = str(caught.value)
    assert "motors: nothing says the kp of hip_l, hip_r; copy /" in message
    assert 'robots/table and name that; in its robot.yaml, add `- {joints: "*", kp:' in message


def test_an_archive_that_is_not_the_one_announced_is_refused(menagerie):
    archive = menagerie()
    content = bytearray(archive.read_bytes())
    content[-1] ^= 1
    archive.write_bytes(content)
    with pytest.raises(FetchError, match=r"table-\w+.tar.xz does not match the digest"):
        find_robot("menagerie:table")
    archive.unlink()
    with pytest.raises(FetchError, match="not found; check the network"):
        find_robot("menagerie:table")


def test_a_misspelt_robot_of_menagerie_is_guessed(menagerie):
    menagerie()
    with pytest.raises(RobotError, match=r"has no robot 'tabel'; did you mean 'table'\?"):
        find_robot("menagerie:tabel")


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco_menagerie", None)
    with pytest.raises(PrerequisiteError, match=r"pip install 'nw-eval\[robots\]'"):
        find_robot("menagerie:unitree_go1")


def test_the_package_and_its_list_are_the_real_ones():
    package = pytest.importorskip("mujoco_menagerie", reason="needs the extra robots")
    if not hasattr(tarfile, "data_filter"):
        pytest.skip("the package needs Python 3.11.4 or newer")
    robot = package.get("unitree_go1")
    assert (robot.default_model, len(robot.oid)) == ("go1", 40)
    assert Path(robot.entry(robot.default_model).file).suffix == ".xml"
