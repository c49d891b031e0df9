"""The Go2 against the published figures (reference: robot files of ziyc/neverwhere, 5774a18)."""

import math

import mujoco
import numpy as np
import pytest

from nw_scenes.robots import get_robot

GO2 = get_robot("go2")


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(GO2.mjcf)


def test_total_mass_is_the_published_one(model):
    assert model.body_subtreemass[0] == pytest.approx(13.086, abs=1e-3)


def test_joint_order_is_right_before_left_and_front_before_rear(model):
    names = [model.joint(index).name for index in range(1, model.njnt)]
    assert names == list(GO2.joints)
    assert names[0] == "FR_hip_joint"
    assert names[-1] == "RL_calf_joint"
    assert [model.actuator(i).name for i in range(model.nu)] == names


def test_front_and_rear_thighs_have_their_own_ranges(model):
    assert model.joint("FL_thigh_joint").range == pytest.approx([-1.5708, 3.4907])
    assert model.joint("RL_thigh_joint").range == pytest.approx([-0.5236, 4.5379])
    assert model.joint("RL_calf_joint").range == pytest.approx([-2.7227, -0.83776])


def test_servos_and_joints_have_the_release_figures(model):
    assert model.actuator_gainprm[:, 0] == pytest.approx(np.full(12, 30.0))
    assert model.actuator_forcerange == pytest.approx(np.tile([-23.7, 23.7], (12, 1)))
    assert model.dof_damping[6:] == pytest.approx(np.full(12, 0.6))
    assert (model.dof_damping[:6] == 0).all()


@pytest.mark.parametrize(
    ("name", "kind", "size", "position"),
    [
        ("base", "BOX", (0.1881, 0.04675, 0.057), (0, 0, 0)),
        ("face_head", "CYLINDER", (0.05, 0.045), (0.285, 0, 0.01)),
        ("face_dome", "SPHERE", (0.047,), (0.293, 0, -0.06)),
        ("FR", "SPHERE", (0.022,), (-0.002, 0, -0.213)),
        ("RL", "SPHERE", (0.022,), (-0.002, 0, -0.213)),
        ("FR_upper_calf", "CYLINDER", (0.013, 0.06), (0.01, 0, -0.06)),
        ("FL_upper_calf", "CYLINDER", (0.012, 0.06), (0.008, 0, -0.06)),
    ],
)
def test_collision_geometry_is_the_published_one(model, name, kind, size, position):
    geom = model.geom(name)
    assert geom.type[0] == getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
    assert geom.size[: len(size)] == pytest.approx(size)
    assert geom.pos == pytest.approx(position, abs=1e-12)
    assert geom.contype[0] == 1
    assert geom.conaffinity[0] == 1


def test_monitored_geoms_exist_and_are_the_published_three(model):
    robot = GO2
    assert robot.published_monitored == ("face_head", "face_dome", "base")
    for name in (*robot.monitored, *robot.feet):
        model.geom(name)


def test_ego_camera_looks_18_degrees_down_from_above_the_head(model):
    camera = GO2.cameras["ego"]
    rotation = np.array(camera.R_trunk_camera)
    assert rotation.T @ rotation == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    forward = rotation[:, 2]
    assert math.degrees(math.asin(-forward[2])) == pytest.approx(18.4, abs=0.05)
    assert camera.position == (0.285, 0.0, 0.175)
    assert camera.fovy == pytest.approx(math.pi / 2)
    # MuJoCo's own reading of the axes: x right, y up, looking along minus z.
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    seen = data.cam_xmat[model.camera("ego").id].reshape(3, 3)
    assert seen @ np.diag([1, -1, -1]) == pytest.approx(rotation, abs=1e-9)


def test_height_camera_is_the_published_constant_above_the_centre_of_mass(model):
    data = mujoco.MjData(model)
    data.qpos[2] = 0.4
    data.qpos[7:] = GO2.default_pose
    mujoco.mj_forward(model, data)
    offset = data.cam_xpos[model.camera("heightmap").id] - data.subtree_com[1]
    assert offset == pytest.approx(GO2.height_camera_offset, abs=2e-5)


def test_legs_mirror_each_other(model):
    data = mujoco.MjData(model)
    data.qpos[7:] = GO2.default_pose
    mujoco.mj_forward(model, data)
    for right, left in (("FR", "FL"), ("RR", "RL")):
        mirrored = data.geom_xpos[model.geom(left).id] * [1, -1, 1]
        assert data.geom_xpos[model.geom(right).id] == pytest.approx(mirrored, abs=1e-9)


def test_it_stands_in_its_default_pose():
    spec = mujoco.MjSpec.from_string(GO2.mjcf)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    spec.option.timestep = 0.005
    standing = spec.compile()
    data = mujoco.MjData(standing)
    data.qpos[2] = 0.33
    data.qpos[7:] = data.ctrl[:] = GO2.default_pose
    for _ in range(400):
        mujoco.mj_step(standing, data)
    assert 0.2 < data.qpos[2] < 0.34
    assert data.qpos[3] > 0.99
    touching = {standing.geom(int(g)).name for g in data.contact.geom[:, 1]}
    assert touching == {"FR", "FL", "RR", "RL"}


def test_seen_shapes_carry_no_mass_and_touch_nothing(model):
    visual = model.geom_group == 2
    assert visual.sum() == len(GO2.visuals)
    assert (model.geom_conaffinity[visual] == 0).all()
