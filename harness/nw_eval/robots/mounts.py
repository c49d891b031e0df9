"""Where a robot's cameras and its IMU are: what its robot.yaml says, else what its model has."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco as _mujoco
import numpy as np
import numpy.typing as npt

from nw_eval.errors import nearest
from nw_eval.robots.compiled import CompiledRobot
from nw_eval.robots.folder import Camera
from nw_eval.robots.spec import CameraMount, ImuMount, Vector3

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

Array = npt.NDArray[np.float64]

_AHEAD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
_TURN = 1e-6  # by which a rotation may miss
_CAMERA = re.compile(r"[A-Za-z0-9][\w.-]{0,63}", re.ASCII)  # name of a camera


class Mounts:
    """Finds what is mounted on a robot.

    Args:
        robot: in the pose in which it stands.
    """

    def __init__(self, robot: CompiledRobot) -> None:
        self.robot = robot
        self.settings = robot.settings
        self.model, self.data = robot.model, robot.data

    def cameras(self) -> dict[str, CameraMount]:
        """Return `ego`, then the other cameras of robot.yaml and of the model, by name."""
        settings = self.settings.cameras
        said = {name: self._mounted(eye, ("cameras", name)) for name, eye in settings.items()}
        if self.settings.eye is not None:
            if "ego" in said:
                raise self.robot.fault(
                    ("cameras", "ego"), "cameras: `eye` is `ego`, too", "remove one"
                )
            eye = self.settings.eye
            keys = {key: getattr(eye, key) for key in eye.model_fields_set}
            said["ego"] = self._mounted(Camera(**keys), ("eye",))
        own: dict[str, CameraMount] = {}
        for camera in range(self.model.ncam):
            name = str(self.model.camera(camera).name)
            mount = self._camera(camera)
            if mount is not None and _CAMERA.fullmatch(name):
                own[name] = mount
        first = self.first_camera()
        ego = (
            said.get("ego")
            or (None if first is None else first[1])
            or CameraMount(
                position=(self._front(), 0.0, 0.0), R_trunk_camera=_AHEAD, fovy=math.pi / 2
            )
        )
        return {"ego": ego} | {k: v for k, v in (own | said).items() if k != "ego"}

    def imu(self) -> ImuMount | None:
        """Return where the IMU of robot.yaml is; None = it is the root's own frame."""
        imu = self.settings.imu
        if imu is None:
            return None
        if imu.site is not None:
            sites = [str(self.model.site(number).name) for number in range(self.model.nsite)]
            if imu.site not in sites:
                fix = (
                    nearest(imu.site, sites) if sites else "name a body: {body: ..., position: ...}"
                )
                raise self.robot.fault(("imu", "site"), f"imu: no site {imu.site!r}", fix)
            number = sites.index(imu.site)
            body = self.robot.body_name(int(self.model.site_bodyid[number]))
            position, quaternion = self.model.site_pos[number], self.model.site_quat[number]
        else:
            (body,) = self.robot.known(("imu", "body"), [imu.body or self.robot.root])
            position, quaternion = np.array(imu.position), imu.quaternion
        carrier, T = self._carried(body)
        R = T[:3, :3] @ self._turn(quaternion, ("imu",))
        x, y, z = (T[:3, :3] @ position + T[:3, 3]).tolist()
        return ImuMount(body=carrier, position=(x, y, z), R_body_imu=_rows(R))

    def first_camera(self) -> tuple[str, CameraMount] | None:
        """Return the first camera of the model that nothing moves against the trunk, by name."""
        for camera in range(self.model.ncam):
            mount = self._camera(camera)
            if mount is not None and not mount.body:
                return str(self.model.camera(camera).name) or "camera without a name", mount
        return None

    def _mounted(self, camera: Camera, key: tuple[str, ...]) -> CameraMount:
        (body,) = self.robot.known((*key, "body"), [camera.body or self.robot.root])
        if camera.rotation is None:
            cosine, sine = math.cos(camera.pitch), math.sin(camera.pitch)
            turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
            axes = self._turn(camera.quaternion, key) @ np.array(_AHEAD) @ turn
        else:
            axes = np.array(camera.rotation)
            if np.abs(axes.T @ axes - np.eye(3)).max() > _TURN or np.linalg.det(axes) < 0.0:
                message = f"{'.'.join(key)}.rotation: it is no rotation"
                fix = "give rows of length 1, square to each other, of a right-handed frame"
                raise self.robot.fault((*key, "rotation"), message, fix)
        position, fovy = np.array(camera.position), math.radians(camera.fovy)
        if body == self.robot.root:  # Its numbers are taken as they are written, to the last bit.
            mount = _mount(position, axes, fovy, "")
        else:
            carrier, T = self._carried(body)
            mount = _mount(T[:3, :3] @ position + T[:3, 3], T[:3, :3] @ axes, fovy, carrier)
        lens = camera.intrinsics
        mount = replace(mount, readout=camera.readout, exposure=camera.exposure)
        return mount if lens is None else mount.with_intrinsics(lens)

    def _turn(self, quaternion: Sequence[float], key: tuple[str, ...]) -> Array:
        """Return the rotation of a quaternion, (3, 3)."""
        length = float(np.linalg.norm(quaternion))
        if not 0.9 < length < 1.1:
            message = f"{'.'.join(key)}: a quaternion of length {length:g}"
            raise self.robot.fault((*key, "quaternion"), message, "give w x y z of length 1")
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, np.array(quaternion, dtype=np.float64) / length)
        return R.reshape(3, 3)

    def _camera(self, camera: int) -> CameraMount | None:
        """Return a camera of the model; None if it is not fixed to its body."""
        if self.model.cam_mode[camera] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            return None
        carrier, T = self._carried(self.robot.body_name(int(self.model.cam_bodyid[camera])))
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, self.model.cam_quat[camera])
        axes = R.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])  # OpenCV's, of MuJoCo's
        position = T[:3, :3] @ self.model.cam_pos[camera] + T[:3, 3]
        fovy = math.radians(float(self.model.cam_fovy[camera]))
        return _mount(position, T[:3, :3] @ axes, fovy, carrier)

    def _front(self) -> float:
        own = np.flatnonzero(self.model.geom_bodyid == self.model.body(self.robot.root).id)
        reach = [float(self.model.geom_pos[g, 0] + self.model.geom_rbound[g]) for g in own.tolist()]
        return max(reach, default=0.1)

    def _is_rigid(self, body: str) -> bool:
        number, root = int(self.model.body(body).id), int(self.model.body(self.robot.root).id)
        return bool(self.model.body_weldid[number] == self.model.body_weldid[root])

    def _carried(self, body: str) -> tuple[str, Array]:
        """Return what carries things on a body, and T_carrier_body, (4, 4).

        That is the root ("") where no joint moves the body against it, else the body itself.
        """
        T = np.eye(4)
        if not self._is_rigid(body):
            return body, T
        root, own = self.data.body(self.robot.root), self.data.body(body)
        R = root.xmat.reshape(3, 3)
        T[:3, :3] = R.T @ own.xmat.reshape(3, 3)
        T[:3, 3] = R.T @ (own.xpos - root.xpos)
        return "", T


def _mount(position: Array, R: Array, fovy: float, body: str) -> CameraMount:
    x, y, z = position.tolist()
    return CameraMount(position=(x, y, z), R_trunk_camera=_rows(R), fovy=fovy, body=body)


def _rows(R: Array) -> tuple[Vector3, Vector3, Vector3]:
    one, two, three = ((a, b, c) for a, b, c in R.tolist())
    return one, two, three
