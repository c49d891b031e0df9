"""LucidSim's terrains of boxes: names, sizes and floor as its XML files have them."""

import numpy as np
import pytest

from nw_scenes.neverwhere import load_published
from nw_scenes.rays import RayScene
from nw_sim.catalogue import inspect_scene, match_scenes

BOX = '<body name="{0}" pos="{1} {2} {3}"><geom name="{0}" type="box" size="{4} {5} {6}"/></body>'


def box(name, center, half):
    return BOX.format(name, *center, *half)


def waypoint(name, position):
    return '<body name="waypoint-{}" pos="{} {} {}"/>'.format(name, *position)


def write(folder, name, floor, *parts):
    """Write a scene as LucidSim does: the robot's file, a plane for the floor, and bodies."""
    path = folder / f"{name}.xml"
    path.write_text(
        '<mujoco><include file="go1/go1.xml"/><worldbody>'
        f'<geom name="floor" type="plane" size="0 0 0.05" pos="0 0 {floor}"/>'
        f"{''.join(parts)}</worldbody></mujoco>"
    )
    return f"neverwhere:{path}"


def parkour(folder, name="parkour", width=0.4572):
    """Two tilted boards after a start block, all on a floor 0.4 m lower."""
    boards = "".join(
        f'<body name="ramp-{k}" pos="{x} {y} 0" euler="{roll} 0 0">'
        f'<geom name="ramp-{k}" type="box" size="0.4 0.508 0.0254"/>'
        f"{waypoint(k, (0, 0, 0.0254))}</body>"
        for k, x, y, roll in ((1, 2.0256, -0.35, -0.4115), (2, 2.8892, 0.35, 0.4115))
    )
    start = box("platform", (0.4, 0, -0.2032), (1.1176, width, 0.2032))
    return write(folder, name, -0.4064, start, boards, waypoint("end", (5, 0, -0.4064)))


def stairs(folder, wall="wall"):
    """Twelve steps of 0.2 m between two walls, which begin below the stairs."""
    steps = [
        box(f"step-{k:02}", (1.5 + 0.35 * (k + 0.5), 0, 0.1 * (k + 1)), (0.175, 1, 0.1 * (k + 1)))
        for k in range(12)
    ]
    walls = [
        box(f"{wall}-{side}", (4, y, 1.5), (3, 0.1, 1.5)) for side, y in (("l", 1.1), ("r", -1.1))
    ]
    marks = [waypoint(f"{k:02}", (1.5 + 0.35 * k, 0, 0.2 * k)) for k in range(2, 13, 2)]
    return write(folder, "stairs_v1", 0, *steps, *walls, *marks)


def test_a_narrow_start_block_over_a_lower_floor_carries_the_robot(tmp_path):
    assert inspect_scene(parkour(tmp_path)).findings == ()


def test_a_start_block_narrower_than_the_robot_does_not(tmp_path):
    (finding,) = inspect_scene(parkour(tmp_path, width=0.1)).findings
    assert (finding.code, finding.severity) == ("spawn_blocked", "error")


def test_scandots_look_through_walls_and_everything_else_meets_them(tmp_path):
    scene = load_published(stairs(tmp_path))
    rays = RayScene(scene.mesh())
    on_wall, on_step, beyond = (4.0, 1.1), (2.0, 0.9), (4.0, 1.5)
    assert rays.height(np.array([on_wall, on_step, beyond])) == pytest.approx([0.0, 0.4, 0.0])
    sideways = rays.distance(np.array([[4.0, 0.0, 2.9]]), np.array([[0.0, 1.0, 0.0]]))
    assert sideways == pytest.approx([1.0])
    assert len(scene.solids) == 14


def test_only_what_the_reference_hides_is_looked_through(tmp_path):
    for name, height in (("wall", 0.0), ("ball", 0.0), ("cone", 0.0), ("soccer", 0.0),
                         ("basketball", 0.0), ("side-wall", 3.0), ("Wall", 3.0)):  # fmt: skip
        rays = RayScene(load_published(stairs(tmp_path, name)).mesh())
        assert rays.height(np.array([[4.0, 1.1]])) == pytest.approx([height]), name


def test_waypoints_move_as_the_environments_of_that_name_have_it(tmp_path):
    assert load_published(parkour(tmp_path)).waypoint_noise == (0.1, 0.1)
    assert load_published(stairs(tmp_path)).waypoint_noise == (0.0, 0.1)
    # A name of one's own means what it resembles, and the check says what was taken.
    (note,) = inspect_scene(parkour(tmp_path, "my_parkour")).findings
    assert (note.code, note.severity) == ("task_guessed", "note")
    assert "waypoint noise (0.0, 0.1) m" in note.message


def test_a_suite_names_the_xml_itself(tmp_path):
    (scene,) = match_scenes([parkour(tmp_path).replace(f"{tmp_path}/", "")], tmp_path)
    assert (scene.name, scene.task, scene.ground.z) == ("neverwhere/parkour", "ramps", -0.4064)
