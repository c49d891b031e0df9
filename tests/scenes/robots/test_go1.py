"""The Go1 against figures that were not used to write it."""

import mujoco
import numpy as np
import pytest

from nw_base.errors import UsageError
from nw_scenes.robots import _IN_MENAGERIE, get_robot
from nw_scenes.robots.spec import COLLISION_GROUP, VISUAL_GROUP

GO1 = get_robot("go1")


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(GO1.mjcf)


def posed(model, joints, height):
    data = mujoco.MjData(model)
    data.qpos[:3] = (0.0, 0.0, height)
    data.qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
    data.qpos[7:] = joints
    mujoco.mj_forward(model, data)
    return data


def test_it_weighs_what_the_published_robot_weighs(model):
    # Published total, with the 1 kg head cube: 12.986 kg.
    assert model.body_mass.sum() == pytest.approx(12.986, abs=5e-4)
    assert model.body("face").mass[0] == pytest.approx(1.0, rel=1e-12)
    # A 0.1 m cube of 1 kg: m a^2 / 6.
    np.testing.assert_allclose(model.body("face").inertia, 1.0 * 0.1**2 / 6.0, rtol=1e-12)


def test_its_centre_of_mass_gives_the_published_scandots_camera(model):
    # Measured on the published file: the height camera stands at COM + (-0.02443, -0.00170,
    # 25.03206), fixed by the zero pose. It depends on every mass, joint offset and leg figure.
    data = posed(model, np.zeros(12), 0.0)
    offset = data.cam("heightmap").xpos - data.subtree_com[model.body("trunk").id]
    np.testing.assert_allclose(offset, (-0.02443, -0.00170, 25.03206), atol=6e-6)
    np.testing.assert_allclose(offset, GO1.height_camera_offset, atol=6e-6)


def test_in_the_default_stance_the_scandots_camera_is_1_43_cm_above_its_nominal_height(model):
    # Published: trunk_z + 0.0143 - 0.3 - ground in the default stance.
    data = posed(model, GO1.default_pose, 0.4)
    assert data.cam("heightmap").xpos[2] - 0.4 - 25.0 == pytest.approx(0.0143, abs=5e-5)


def test_at_the_spawn_height_the_feet_hang_where_the_published_ones_do(model):
    # Published: foot centres at z = 0.098 in front, 0.107 behind.
    data = posed(model, GO1.default_pose, GO1.spawn_height)
    heights = [data.geom(foot).xpos[2] for foot in GO1.feet]
    np.testing.assert_allclose(heights, (0.098, 0.098, 0.107, 0.107), atol=5e-4)


def test_foot_positions_follow_from_trigonometry(model):
    # Legs straightened by hand: at zero angles a foot hangs two segments below its thigh joint.
    data = posed(model, np.zeros(12), 0.0)
    for foot, x, y in (
        ("FR", 0.1881, -0.12675),
        ("FL", 0.1881, 0.12675),
        ("RR", -0.1881, -0.12675),
        ("RL", -0.1881, 0.12675),
    ):
        np.testing.assert_allclose(data.geom(foot).xpos, (x, y, -0.426), atol=1e-12)


def test_joint_ranges_and_order_are_the_published_ones(model):
    hip, thigh, calf = (-0.802851, 0.802851), (-1.0472, 4.18879), (-2.69653, -0.916298)
    assert GO1.joint_ranges == (hip, thigh, calf) * 4
    assert [model.joint(i).name for i in range(1, model.njnt)] == list(GO1.joints)
    assert [model.actuator(i).name for i in range(model.nu)] == list(GO1.joints)
    np.testing.assert_array_equal(model.jnt_range[1:], GO1.joint_ranges)
    assert GO1.joints[:4] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "FL_hip_joint")
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 1, 0]] * 4)
    np.testing.assert_array_equal(model.jnt_axis[1:], axes)


def test_the_default_pose_is_within_reach():
    low, high = np.array(GO1.joint_ranges).T
    assert np.all(low < GO1.default_pose)
    assert np.all(high > GO1.default_pose)


def test_servos_are_the_published_ones(model):
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], 20.0)
    np.testing.assert_array_equal(model.actuator_biasprm[:, :3], [[0.0, -20.0, 0.0]] * 12)
    np.testing.assert_array_equal(model.actuator_forcerange, [[-23.7, 23.7]] * 12)
    np.testing.assert_array_equal(model.dof_damping[6:], 0.5)
    np.testing.assert_array_equal(model.dof_armature[6:], 0.01)
    np.testing.assert_array_equal(model.dof_frictionloss[6:], 0.2)


def test_mirrored_legs_have_mirrored_mass(model):
    # Reflection in the x-z plane turns a right leg into a left one: so does it the inertia tensor.
    flip = np.diag([1.0, -1.0, 1.0])
    for right, left in (("FR", "FL"), ("RR", "RL")):
        for kind in ("hip", "thigh"):
            a, b = model.body(f"{right}_{kind}"), model.body(f"{left}_{kind}")
            np.testing.assert_allclose(flip @ a.ipos, b.ipos, atol=1e-12)
            np.testing.assert_allclose(flip @ tensor(a) @ flip, tensor(b), atol=2e-8)


def tensor(body):
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.array(body.iquat))
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(body.inertia) @ rotation.T


def test_the_ego_camera_looks_ahead_from_the_head_with_90_degrees():
    ego = GO1.cameras["ego"]
    assert ego.position == (0.27, 0.0, 0.015)
    # f = 360 px for an image 720 high.
    assert 0.5 * 720 / np.tan(ego.fovy / 2) == pytest.approx(360.0)
    right, down, forward = np.array(ego.R_trunk_camera).T
    np.testing.assert_array_equal(right, (0, -1, 0))
    np.testing.assert_array_equal(down, (0, 0, -1))
    np.testing.assert_array_equal(forward, (1, 0, 0))


def test_camera_mounts_agree_with_the_cameras_of_the_mjcf(model):
    data = posed(model, GO1.default_pose, 0.4)
    for name, mount in GO1.cameras.items():
        np.testing.assert_allclose(
            data.cam(name).xpos, np.array((0.0, 0.0, 0.4)) + mount.position, atol=1e-12
        )
        # MuJoCo cameras look along minus z with y up: half a turn about x from OpenCV's.
        rotation = data.cam(name).xmat.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
        np.testing.assert_allclose(rotation, mount.R_trunk_camera, atol=1e-12)
        assert model.cam(name).fovy[0] == pytest.approx(np.degrees(mount.fovy))


def test_what_is_seen_and_what_collides_are_kept_apart(model):
    collides = model.geom_group == COLLISION_GROUP
    seen = model.geom_group == VISUAL_GROUP
    assert (collides | seen).all()
    assert collides.sum() == 2 + 4 * 3
    np.testing.assert_array_equal(model.geom_contype[collides], 1)
    np.testing.assert_array_equal(model.geom_conaffinity[collides], 1)
    # No pair that involves a visual geom passes MuJoCo's filter.
    filtered = model.geom_contype[seen][:, None] & model.geom_conaffinity[None, :]
    assert not filtered.any()
    np.testing.assert_array_equal(model.geom_conaffinity[seen], 0)


def test_its_looks_weigh_nothing(model):
    spec = mujoco.MjSpec.from_string(GO1.mjcf)
    for geom in [each for body in spec.bodies for each in body.geoms]:
        if geom.group == VISUAL_GROUP:
            spec.delete(geom)
    plain = spec.compile()
    assert plain.ngeom == model.ngeom - len(GO1.visuals)
    np.testing.assert_array_equal(plain.body_mass, model.body_mass)
    np.testing.assert_array_equal(plain.body_inertia, model.body_inertia)


def test_the_head_one_sees_is_the_head_that_collides(model):
    # A camera image or a replay should show the robot touch what it touches: the visible head
    # lies within 1 cm of the monitored cube.
    data = posed(model, GO1.default_pose, 0.0)
    face = data.geom("face").xpos
    front = max(
        shape.position[0] + shape.size[0] for shape in GO1.visuals if shape.kind == "ellipsoid"
    )
    assert front == pytest.approx(face[0] + 0.05, abs=0.01)


def test_the_spec_names_only_what_the_model_has(model):
    for name in (*GO1.feet, *GO1.monitored, *GO1.published_monitored):
        assert model.geom(name).group[0] == COLLISION_GROUP
    assert [model.body(i).name for i in range(1, model.nbody)] == list(GO1.bodies)


def test_a_misspelt_robot_gets_the_nearest_name():
    with pytest.raises(UsageError, match=r"unknown robot 'go_1'; did you mean 'go1'\?"):
        get_robot("go_1")


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("a1", "unitree_a1"),
        ("g1", "unitree_g1"),
        ("G1", "unitree_g1"),
        ("h1", "unitree_h1"),
        ("unitree-g1", "unitree_g1"),
        ("spot", "boston_dynamics_spot"),
        ("t1", "booster_t1"),
        ("anymal_c", "anybotics_anymal_c"),
        ("anymal", "anybotics_anymal_b or menagerie:anybotics_anymal_c"),
        ("cassie", "agility_cassie"),
        ("barkour_v0", "google_barkour_v0"),
    ],
)
def test_a_robot_that_menagerie_has_is_answered_with_what_to_type(name, model, monkeypatch):
    monkeypatch.setattr("nw_scenes.robots._folders", {})  # Of tests before.
    with pytest.raises(UsageError) as caught:
        get_robot(name)
    assert caught.value.message == f"unknown robot {name!r}"
    assert caught.value.fix.startswith(f"give menagerie:{model}, or your own robot's folder")
    assert "did you mean" not in str(caught.value)


@pytest.mark.parametrize("name", ["b2", "go2w", "h1_2", "anymal_d", "digit"])
def test_a_robot_that_is_nowhere_is_answered_with_how_to_make_its_folder(name, monkeypatch):
    monkeypatch.setattr("nw_scenes.robots._folders", {})  # Of tests before.
    with pytest.raises(UsageError) as caught:
        get_robot(name)
    assert caught.value.fix == (
        f"give your own robot's folder, such as ./{name} (`nw-eval robots init` makes one)"
    )


def test_the_robots_that_the_answer_names_are_those_of_menagerie():
    menagerie = pytest.importorskip("mujoco_menagerie")
    assert set(_IN_MENAGERIE) <= set(menagerie.names())
