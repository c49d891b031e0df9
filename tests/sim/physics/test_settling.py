"""The height at which the robot comes to rest, against statics done by hand."""

import numpy as np
import pytest

from nw_sim.physics import World

GRAVITY, KP, FOOT_RADIUS, SEGMENT = 9.806, 20.0, 0.02, 0.213
REST = np.array([0.1, 0.8, -1.5, 0.1, 1.0, -1.5])  # front and rear left leg: hip, thigh, calf


def about_x(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def about_y(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def heights(joints, pitch):
    """Return sum of m z with the trunk's origin at 0, and foot heights in front and behind.

    Masses and lengths are the published table's; the robot is taken as symmetric.
    """
    trunk = about_y(pitch)
    moment = 4.801 * (trunk @ (0.0116053, 0, 0.000106692))[2] + (trunk @ (0.27, 0, 0.015))[2]
    feet = []
    for first, side in ((0, 1.0), (3, -1.0)):
        hip, thigh, calf = joints[first : first + 3]
        origin, turn = trunk @ (0.1881 * side, 0.04675, 0), trunk @ about_x(hip)
        moment += 2 * 0.679292 * (origin + turn @ (-0.00406411 * side, 0.0193463, 0))[2]
        origin, turn = origin + turn @ (0, 0.08, 0), turn @ about_y(thigh)
        moment += 2 * 0.898919 * (origin + turn @ (-0.003468, -0.018947, -0.032736))[2]
        origin, turn = origin + turn @ (0, 0, -SEGMENT), turn @ about_y(calf)
        moment += 2 * 0.218015 * (origin + turn @ (0.00455603, 0.0009473, -0.147239))[2]
        feet.append((origin + turn @ (0, 0, -SEGMENT))[2])
    return moment, feet


def standing(joints):
    """Return potential energy and trunk height with all four feet on the ground."""
    low, high = -0.5, 0.5
    for _ in range(60):  # The pitch that levels the feet: nose down lifts the rear ones.
        pitch = (low + high) / 2
        _, (front, rear) = heights(joints, pitch)
        low, high = (pitch, high) if rear < front else (low, pitch)
    moment, (front, _) = heights(joints, pitch)
    z = FOOT_RADIUS - front
    mass = 4.801 + 1.0 + 4 * (0.679292 + 0.898919 + 0.218015)
    springs = 0.5 * KP * 2 * np.sum((joints - REST) ** 2)
    return GRAVITY * (moment + mass * z) + springs, z


def height_of_least_energy():
    """Descend by Newton's method with differences; the potential has one smooth minimum."""
    joints, step = REST.copy(), 1e-3
    unit = step * np.eye(6)
    for _ in range(12):
        middle = standing(joints)[0]
        gradient, curvature = np.zeros(6), np.zeros((6, 6))
        for i in range(6):
            up, down = standing(joints + unit[i])[0], standing(joints - unit[i])[0]
            gradient[i] = (up - down) / (2 * step)
            curvature[i, i] = (up - 2 * middle + down) / step**2
            for j in range(i):
                mixed = sum(
                    a * b * standing(joints + a * unit[i] + b * unit[j])[0]
                    for a in (1, -1)
                    for b in (1, -1)
                )
                curvature[i, j] = curvature[j, i] = mixed / (4 * step**2)
        joints = joints - np.linalg.solve(curvature, gradient)
    assert np.abs(gradient).max() < 1e-4
    return standing(joints)[1]


@pytest.mark.nightly
def test_the_robot_sinks_to_the_height_of_least_energy(go1, flat):
    # Servos of kp 20 are springs of 20 N m / rad that sag under 12.986 kg. MuJoCo's friction is
    # soft and lets feet and joints creep until it carries no load, so that the robot ends where
    # springs and weight balance alone: at the minimum of their energy, 0.2515 m. What is left
    # over is the 1 mm contact margin less its compression, and joint friction of 0.2 N m, which
    # holds each joint within 0.01 rad.
    expected = height_of_least_energy()
    assert expected == pytest.approx(0.2515, abs=5e-4)
    with World(go1, flat) as world:
        for _ in range(2000):  # 40 s; the time constant of the creep is about 5 s.
            world.step(go1.default_pose)
        assert world.trunk_position[2] == pytest.approx(expected, abs=0.003)
        assert np.abs(world.joint_velocities).max() < 1e-3
        # Creeping is over, so the feet carry the weight and nothing else.
        assert world.foot_forces().sum() == pytest.approx(12.985904 * GRAVITY, rel=0.005)


def test_after_the_drop_the_robot_stands_on_four_feet_and_nothing_else(go1, flat):
    # The published start: a drop of about 8 cm. Nothing may strike a monitored geom.
    with World(go1, flat) as world:
        struck = 0.0
        for _ in range(50):
            world.step(go1.default_pose)
            struck = max(struck, world.monitored_force())
        assert struck == 0.0
        assert world.foot_contacts.all()
        assert 0.25 < world.trunk_position[2] < 0.30
        assert np.abs(world.roll_pitch_yaw[:2]).max() < 0.1
