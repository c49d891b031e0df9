"""Writes published scene folders the way the label tool does, by a code path of its own.

Follows the specification (COLMAP frame, label, crop, export) and shares nothing with the reader:
rotations by Rodrigues and Euler angles by inverse formulas here, by axis products there.
"""

import json
import math
from dataclasses import dataclass

import numpy as np
import pytest

LABEL = np.array([[-2.0, -3.0, -3.0], [7.0, 3.0, 3.0]])

XML = """\
<mujoco model="{robot} scene">
  <include file="{robot}/gabe_{robot}.xml"/>
  <option timestep="0.005"/>
  <option sdf_iterations="20" sdf_initpoints="40"/>
  <statistic center="0 0 0.1" extent="1"/>
  <visual><headlight diffuse="0.6 0.6 0.6" ambient="0.3 0.3 0.3" specular="0 0 0"/>
    <global azimuth="-130" elevation="-20"/></visual>
  <extension><plugin plugin="mujoco.sdf.sdflib"><instance name="sdf"><config key="aabb" value="0"/>
  </instance></plugin></extension>
  <default><default class="traffic_cone">
    <geom type="mesh" group="2" contype="0" conaffinity="0" euler="1.57 0 0"/></default></default>
  <asset>
    <mesh name="visual_mesh" file="real_scenes/{scene}/geometry/visual_mesh_simplified.obj"
          scale="{scale}"/>
    <mesh name="collision_mesh" file="real_scenes/{scene}/geometry/collision_mesh.obj">
      <plugin instance="sdf"/></mesh>
    <material name="collision_mesh_material" rgba="1 1 1 0"/>
    <material name="visual_mesh_material" rgba="0.2 0.2 0.2 1" reflectance="0.5"/>
    <mesh name="cone_0" file="assets/cone/SM_TrafficCone_V0_4/SM_TrafficCone_V0_4_0.obj"
          scale="0.005 0.005 0.005"/>
    <mesh name="cone_1" file="assets/cone/SM_TrafficCone_V0_4/SM_TrafficCone_V0_4_1.obj"
          scale="0.005 0.005 0.005"/>
  </asset>
  <worldbody>
    <light directional="true" pos="0 0 1.5" dir="0 0 -1"/>
    <body name="scene-group-2">
      <body name="collision_mesh" {collision_pose}>
        <geom name="collision_mesh_geom" type="sdf" mesh="collision_mesh" friction="{friction}"
              material="collision_mesh_material"><plugin instance="sdf"/></geom>
      </body>
      <body name="mesh" {mesh_pose}>
        <geom name="mesh_geom" type="mesh" mesh="visual_mesh" group="2" contype="0" conaffinity="0"
              material="visual_mesh_material"/>
      </body>
    </body>
{waypoints}
  </worldbody>
</mujoco>
"""

WAYPOINT = """\
    <body name="waypoint-{index}" mocap="true" pos="{pos}"{yaw}>
      <geom name="cone-{index}_1" class="traffic_cone" mesh="cone_0"/>
      <geom name="cone-{index}_2" class="traffic_cone" mesh="cone_1"/>
    </body>"""


@dataclass
class Label:
    """What a person dragged in the label tool: world = scale * R * colmap + position."""

    scale: float
    rotation: np.ndarray
    position: np.ndarray

    @property
    def matrix(self):
        T = np.eye(4)
        T[:3, :3] = self.scale * self.rotation
        T[:3, 3] = self.position
        return T


def rodrigues(axis, angle):
    k = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def euler_of(R):
    """Return a, b, c with Rx(a) Ry(b) Rz(c) = R."""
    return math.atan2(-R[1, 2], R[2, 2]), math.asin(R[0, 2]), math.atan2(-R[0, 1], R[0, 0])


def random_label(random):
    return Label(
        scale=float(random.uniform(0.3, 2.5)),
        rotation=rodrigues(random.normal(size=3), random.uniform(0.2, 3.0)),
        position=random.uniform(-4, 4, 3),
    )


def text(values):
    return " ".join(f"{float(value)!r}" for value in values)


def write_obj(path, vertices, faces):
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["# written by a toolchain", "mtllib nothing.mtl"]
    lines += [f"v {text(v)}" for v in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def cropped(vertices, faces, low, high):
    """Cut triangles at a box, without capping (Sutherland and Hodgman)."""
    points, triangles = [], []
    for face in faces:
        polygon = [vertices[i] for i in face]
        for axis in range(3):
            for sign, limit in ((1, low[axis]), (-1, -high[axis])):
                polygon = _clip(polygon, axis, sign, limit)
        for i in range(1, len(polygon) - 1):
            triangles.append(tuple(len(points) + k for k in range(3)))
            points += [polygon[0], polygon[i], polygon[i + 1]]
    return np.array(points), np.array(triangles)


def _clip(polygon, axis, sign, limit):
    result = []
    for a, b in zip(polygon, [*polygon[1:], *polygon[:1]], strict=True):
        da, db = sign * a[axis] - limit, sign * b[axis] - limit
        if da >= 0:
            result.append(a)
        if (da >= 0) != (db >= 0):
            result.append(a + (b - a) * (da / (da - db)))
    return result


def write_splat(folder, splat, label, normalise):
    """Write 3dgs/model.pt, and data_transforms.json if there is a normalisation."""
    import torch

    to_splat = np.linalg.inv(label.matrix)
    if normalise is not None:
        to_splat = normalise.matrix @ to_splat
        (folder / "3dgs").mkdir(parents=True, exist_ok=True)
        (folder / "3dgs" / "data_transforms.json").write_text(
            json.dumps({"transform": normalise.matrix[:3].tolist(), "scale": 123.0})
        )
    scale = np.cbrt(np.linalg.det(to_splat[:3, :3]))
    R = to_splat[:3, :3] / scale
    quats = quaternion_product(quaternion_of(R), splat["quats"])
    random = np.random.default_rng(11)
    quats *= random.uniform(0.3, 3.0, (len(quats), 1))
    state = {
        "means": splat["means"] @ to_splat[:3, :3].T + to_splat[:3, 3],
        "scales": splat["log_scales"] + np.log(scale),
        "quats": quats,
        "opacities": splat["opacity_logits"],
        "sh0": splat["sh"][:, :1],
        "shN": np.zeros((len(quats), 15, 3)),
    }
    state = {k: torch.tensor(np.asarray(v), dtype=torch.float32) for k, v in state.items()}
    poses = {"embeds.weight": torch.zeros(3, 9), "identity": torch.zeros(6)}
    (folder / "3dgs").mkdir(parents=True, exist_ok=True)
    torch.save({"step": 29999, "splats": state, "pose_adjust": poses}, folder / "3dgs" / "model.pt")


def quaternion_of(R):
    """Return w x y z by the eigenvector of Bar-Itzhack's matrix."""
    m = R
    K = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    _, vectors = np.linalg.eigh(K / 3)
    return vectors[[3, 0, 1, 2], 3]


def quaternion_product(p, q):
    w, x, y, z = p
    a, b, c, d = np.asarray(q, dtype=float).T
    return np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=-1,
    )


@dataclass
class Writer:
    """Writes folders; every field can be changed before `write`."""

    folder: object
    label: Label
    normalise: Label | None
    vertices: np.ndarray
    faces: np.ndarray
    trail: np.ndarray
    splat: dict | None = None
    robots: tuple = ("go1", "go2")
    offset: tuple = (0.0, 0.0, 0.0)
    turn: tuple = (0.0, 0.0, 0.0)
    yaw: float | None = None
    scale: str | None = None
    friction: str = "1.25 0.3 0.3"

    def write(self):
        folder, label = self.folder, self.label
        folder.mkdir(parents=True, exist_ok=True)
        local = (self.vertices - label.position) @ label.rotation / label.scale
        write_obj(folder / "geometry" / "visual_mesh_simplified.obj", local, self.faces)
        points, triangles = cropped(self.vertices, self.faces, *LABEL)
        # The collision body's pose is undone in the file.
        a, b, c = self.turn
        R = rodrigues((1, 0, 0), a) @ rodrigues((0, 1, 0), b) @ rodrigues((0, 0, 1), c)
        points = (points - np.asarray(self.offset)) @ R
        write_obj(folder / "geometry" / "collision_mesh.obj", points, triangles)
        for robot in self.robots:
            self.write_xml(robot)
        if self.splat is not None:
            write_splat(folder, self.splat, label, self.normalise)
        return folder

    def xml(self, robot="go1"):
        label = self.label
        pose = f'pos="{text(self.offset)}"'
        if any(self.turn):
            pose += f' euler="{text(self.turn)}"'
        yaw = "" if self.yaw is None else f' euler="0 0 {self.yaw}"'
        return XML.format(
            robot=robot,
            scene=self.folder.name,
            scale=self.scale or text([label.scale] * 3),
            collision_pose=pose,
            mesh_pose=f'pos="{text(label.position)}" euler="{text(euler_of(label.rotation))}"',
            friction=self.friction,
            waypoints="\n".join(
                WAYPOINT.format(index=i, pos=text(p), yaw=yaw) for i, p in enumerate(self.trail)
            ),
        )

    def write_xml(self, robot="go1"):
        (self.folder / f"nw-{robot}-{self.folder.name}.xml").write_text(self.xml(robot))


def plain_mesh():
    """Return a floor of 12 x 8 m with a bar across it at x = 1.7: vertices, faces."""
    x, y, z = (1.6, 1.8), (-0.8, 0.8), (0.0, 0.15)
    corners = np.array([[a, b, c] for a in x for b in y for c in z])
    box = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
        (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    n = 25
    gx, gy = np.meshgrid(np.linspace(-3, 9, n), np.linspace(-4, 4, n))
    grid = np.stack([gx, gy, np.zeros_like(gx)], -1).reshape(-1, 3)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    floor = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return np.concatenate([grid, corners]), np.concatenate([floor, np.array(box) + n * n])


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def writer(tmp_path):
    """A writer of a small scene, its label and normalisation drawn from a fixed seed."""
    random = np.random.default_rng(7)
    vertices, faces = plain_mesh()
    return Writer(
        folder=tmp_path / "real_scenes" / "hurdle_stata_v1",
        label=random_label(random),
        normalise=random_label(random),
        vertices=vertices,
        faces=faces,
        trail=np.array([[1.7, 0.0, 0.15], [3.0, 0.1, 0.0]]),
    )


@pytest.fixture
def writer_of(tmp_path):
    """A function that returns a writer of a mesh, a trail and a splat, by seed."""

    def make(vertices, faces, trail, splat, seed):
        random = np.random.default_rng(seed)
        return Writer(
            folder=tmp_path / "real_scenes" / f"hurdle_twin_{seed}",
            label=random_label(random),
            normalise=random_label(random) if seed % 2 == 0 else None,
            vertices=vertices,
            faces=faces,
            trail=trail,
            splat=splat,
        )

    return make
