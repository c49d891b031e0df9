"""Every reader of strangers' files, with valid files to start from.

A target says how to make its seeds (each a mapping of names to bytes), which of those files are
mutated, and how to read them. `read` raises an error of ours or returns; where a file carries a
checksum, it raises `AcceptedError` if something was read that no seed holds.
"""

import contextlib
import io
import itertools
import json
import struct
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from tempfile import gettempdir

import numpy as np

from nw_base.errors import PolicyError, PrerequisiteError

CARD = """\
nw-policy: 1
name: gift
title: a gift
licence: MIT
robot: go1
adapter: {adapter}
checkpoint: {{file: {file}}}
control: {{action: joint_position_offset, scale: 0.25, kp: 20, kd: 0.5, delay_steps: 1}}
command: {{source: trail_follower, speed: 0.8}}
observations:
  obs:
    sensor: proprio
    terms:
      - {{term: ang_vel, scale: 0.25}}
      - gravity
      - command
      - joint_pos
      - {{term: joint_vel, scale: 0.05}}
      - last_output
"""
SUITE = """\
nw-eval: 1
name: mine
robot: go1
policy: go1-parkour
protocol: strict
trials: 3
seed: 7
episode: {duration: 5.0, contact_termination: true}
scenes: [hurdles/one_low_carpet, "stairs/*", ./place]
perturb: {friction: [0.5, 1.0]}
record: failures
gate: {success_rate: 0.75, confidence: 0.95, tiers: {hurdles/one_low_carpet: critical}}
"""
SCENE = """\
nw-scene: 1
name: mine/kerb
task: hurdles
title: A kerb
licence: CC-BY-4.0
trail: [[1.5, 0, 0.2], [3, 0, 0]]
spawn: {position: [0, 0, 0], yaw: 0.1, x_jitter: 0.1, y_jitter: 0.1, yaw_jitter: 0.1}
waypoint_noise: [0.0, 0.1]
ground: 0.0
collision: COLLISION
splat: splat.ply
T_world_splat: {scale: 2.0, quat: [1, 0, 0, 0], translation: [1, 2, 3]}
"""
BOXES = """\
boxes:
  - {center: [1.5, 0, 0.1], half_size: [0.2, 1.0, 0.1], quat: [1, 0, 0, 0]}
  - {center: [2.5, 0, 0.1], half_size: [0.1, 1.0, 0.1], friction: [1.0, 0.3, 0.3], kind: clutter}
"""
PUBLISHED = """\
<mujoco model="go1 scene">
  <option timestep="0.005"/>
  <asset>
    <material name="stone" rgba="1 1 1 0"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.05" friction="1.25 0.3 0.3"/>
    <body name="start" pos="0 0 0" euler="0 0 0"><geom type="box" size="1 1 0.05" pos="0 0 -0.05"/>
    </body>
    <body name="bar" pos="1.5 0 0"><geom name="bar-0" type="box" size="0.1 1 0.1" pos="0 0 0.1"/>
    </body>
    <body name="waypoint-0" mocap="true" pos="1.5 0 0.2"/>
    <body name="waypoint-1" mocap="true" pos="3 0 0"/>
  </worldbody>
</mujoco>
"""


PARQUET_APART = f"subprocess.Popen ({sys.executable!r}, [{sys.executable!r}, '-P', '-m', 'nw_base."
"""Rows that may be damaged are read by a process of their own: that one may be started."""


class AcceptedError(AssertionError):
    """A damaged file was read as something that it never held."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """One reader under fire."""

    name: str
    seeds: object  # folder -> list of {name: bytes}
    read: object  # folder -> anything
    only: tuple = ()  # names that are mutated; all if empty
    lists: bool = False  # whether its errors may have several lines, one a fault
    may: tuple = ()  # forbidden acts that are its own: how they begin

    def mutable(self, name):
        return not self.only or any(name.endswith(end) for end in self.only)

    def names(self, folder):
        return [path.name for path in folder.rglob("*") if path.is_file()]

    def warm(self, seeds):
        """Read every seed once here, so that forks inherit imports; the first one must be good."""
        import tempfile

        for number, files in enumerate(seeds):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                for path, content in files.items():
                    (folder / path).parent.mkdir(parents=True, exist_ok=True)
                    (folder / path).write_bytes(content)
                try:
                    self.read(folder)
                except PolicyError:
                    if number == 0:
                        raise
                except Exception as error:
                    raise AssertionError(f"seed {number} of {self.name}: {error!r}") from error


def _mesh():
    """A floor of 3 x 3 m with a bump, and its triangles."""
    x, y = np.meshgrid(np.linspace(-1, 4, 11), np.linspace(-1.5, 1.5, 7))
    z = np.where((x > 1.4) & (x < 2.1), 0.1, 0.0)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return np.stack([x, y, z], -1).reshape(-1, 3), faces


def _mesh_files():
    import trimesh

    vertices, faces = _mesh()
    mesh = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    made = {}
    for name, options in (
        ("a.obj", {}), ("a.stl", {}), ("a.ply", {}),
        ("b.ply", {"encoding": "ascii"}), ("b.stl", {"file_type": "stl_ascii"}), ("a.glb", {}),
    ):  # fmt: skip
        kind = options.pop("file_type", name.rsplit(".", 1)[1])
        content = mesh.export(file_type=kind, **options)
        made[name] = content if isinstance(content, bytes) else content.encode()
    # Relative indices, continued lines, a notch; then triangles beside a quad, and a strip.
    made["b.obj"] = (
        b"v 0 0 0\nv 2 0 0\n v 2 1 0\nv 1 1 0 .5 .5 .5\r\nv 1 2 0\nv 0 2 0\n"
        b"f -6 -5 \\\n-4 -3 -2 -1\n"
        b"v 0 0 1\nv 1 0 1\nv 1 1 1\nvt 0 0\nf -3/-1 -2/-1 -1/-1\nl 1 2\n"
    )
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\n"
    head += b"property float y\nproperty float z\nelement face 2\nproperty list uchar int %s\n"
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4").tobytes()
    lists = struct.pack("<B4iB3i", 4, 0, 1, 2, 3, 3, 0, 1, 2)
    made["c.ply"] = head % b"vertex_indices" + b"end_header\n" + points + lists
    strips = head.replace(b"element face 2", b"element tristrips 2") % b"vertex_indices"
    made["d.ply"] = strips + b"end_header\n" + points + lists
    return made


def _cloud(count=30, degree=1):
    from nw_splat.gaussians import Gaussians

    rng = np.random.default_rng(5)
    return Gaussians(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        log_scales=np.full((count, 3), -3.0, np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        opacity_logits=np.full(count, 2.0, np.float32),
        sh=rng.normal(size=(count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def _splat_files(folder):
    import torch

    from nw_splat.files import write_splat
    from nw_splat.files.spz import write_spz

    folder.mkdir(parents=True, exist_ok=True)
    write_splat(folder / "a.ply", _cloud())
    write_splat(folder / "a.splat", _cloud(degree=0))
    write_spz(folder / "two.spz", _cloud(), version=2)
    write_spz(folder / "three.spz", _cloud(), version=3)
    with contextlib.suppress(PrerequisiteError):
        write_spz(folder / "four.spz", _cloud(), version=4)
    cloud = _cloud()
    splats = {
        "means": cloud.means, "scales": cloud.log_scales, "quats": cloud.quats,
        "opacities": cloud.opacity_logits, "sh0": cloud.sh[:, :1], "shN": cloud.sh[:, 1:],
    }  # fmt: skip
    plain = {name: torch.from_numpy(np.array(array)) for name, array in splats.items()}
    torch.save({"step": 1, "splats": plain}, folder / "a.pt")
    fixtures = Path(__file__).parents[1] / "splat" / "fixtures"
    (folder / "c.ply").write_bytes((fixtures / "cloud.compressed.ply").read_bytes())
    for name in ("st.sog", "spz_v3_axes8.spz", "spz_v4_axes10.spz", "spz_v2_orbit_antialiased.spz"):
        (folder / name).write_bytes((fixtures / "written" / name).read_bytes())
    names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
    names += [*(f"rot_{i}" for i in range(4)), "filter_3D"]
    head = "ply\nformat ascii 1.0\nelement vertex 3\n"
    head += "".join(f"property float {name}\n" for name in names)
    rows = "0.1 -0.2 0.3 0.5 0.5 0.5 2 -3 -3 -3 1 0 0.1 0 0.01\n" * 3
    (folder / "text.ply").write_text(head + "end_header\n" + rows)
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def _torch_networks():
    """Networks of 45 observations and 12 actions: plain, with a memory, with a convolution."""
    import torch
    from torch import nn

    class Remembering(nn.Module):
        def __init__(self):
            super().__init__()
            self.rnn = nn.GRU(45, 8)
            self.head = nn.Linear(8, 12)
            self.register_buffer("hidden", torch.zeros(1, 1, 8))

        def forward(self, obs):
            output, hidden = self.rnn(obs[None], self.hidden)
            self.hidden.copy_(hidden)
            return self.head(output[0])

    torch.manual_seed(1)
    return nn.Sequential(nn.Linear(45, 8), nn.ELU(), nn.Linear(8, 12)), Remembering()


def _scripts():
    import torch

    plain, remembering = _torch_networks()
    for module in (
        torch.jit.trace(plain, torch.zeros(1, 45)),
        torch.jit.script(plain),
        torch.jit.script(remembering),
    ):
        packed = io.BytesIO()
        torch.jit.save(module, packed)
        yield packed.getvalue()


def _exported():
    import torch

    for module in _torch_networks():
        packed = io.BytesIO()
        torch.export.save(torch.export.export(module, (torch.zeros(1, 45),)), packed)
        yield packed.getvalue()


def _state_dicts():
    import torch

    for module in _torch_networks():
        packed = io.BytesIO()
        torch.save({"model_state_dict": module.state_dict(), "iter": 3}, packed)
        yield packed.getvalue()


def _safetensors():
    state = {name: tensor.numpy() for name, tensor in _torch_networks()[0].state_dict().items()}
    header, body = {}, b""
    for name, array in state.items():
        raw = array.tobytes()
        header[name] = {"dtype": "F32", "shape": list(array.shape),
                        "data_offsets": [len(body), len(body) + len(raw)]}  # fmt: skip
        body += raw
    text = json.dumps(header).encode()
    yield len(text).to_bytes(8, "little") + text + body


def _onnx():
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    rng = np.random.default_rng(2)
    weights = numpy_helper.from_array(rng.normal(size=(45, 12)).astype(np.float32), "w")
    obs = helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 45])
    action = helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])
    plain = helper.make_graph(
        [
            helper.make_node("MatMul", ["obs", "w"], ["h"]),
            helper.make_node("Tanh", ["h"], ["action"]),
        ],
        "plain", [obs], [action], [weights],
    )  # fmt: skip
    hidden = [
        helper.make_tensor_value_info(f"h_{end}", TensorProto.FLOAT, [1, 12])
        for end in ("in", "out")
    ]
    memory = helper.make_graph(
        [
            helper.make_node("MatMul", ["obs", "w"], ["m"]),
            helper.make_node("Add", ["m", "h_in"], ["sum"]),
            helper.make_node("Tanh", ["sum"], ["h_out"]),
            helper.make_node("Identity", ["h_out"], ["action"]),
        ],
        "memory", [obs, hidden[0]], [action, hidden[1]], [weights],
    )  # fmt: skip
    for graph in (plain, memory):
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        onnx.checker.check_model(model)
        yield model.SerializeToString()


def _bundles(contents, adapter, file):
    card = CARD.format(adapter=adapter, file=file).encode()
    return [{"policy.yaml": card, file: content} for content in contents]


def _open_bundle(folder, file):
    """Load a bundle with the mutated weights, as `--checkpoint` does, and ask it for an action."""
    from nw_policies import load_bundle
    from nw_sim.rollout.confined.vetting import check_bundle

    check_bundle(load_bundle(folder / "policy.yaml", checkpoint=folder / file))


def _inspect(folder):
    from nw_policies.drafting.checkpoint import inspect_checkpoint

    (path,) = folder.iterdir()
    return inspect_checkpoint(path)


def _tensors(folder):
    from nw_policies.safety import read_tensors, tensor_facts

    (path,) = folder.iterdir()
    tensor_facts(path.read_bytes(), str(path))
    for tensor in read_tensors(path.read_bytes(), str(path)).values():
        tensor.sum()


def _card(folder):
    from nw_policies.cards.load import load_card
    from nw_scenes.robots import get_robot
    from nw_sim.sensors import check_card

    path = folder / "policy.yaml"
    card = load_card(path)
    check_card(card, get_robot(card.robot), where=path)


def _suite(folder):
    from nw_eval.api.plans import Faults, open_scenes
    from nw_eval.suite import draft_suite

    draft = draft_suite(folder / "mine.yaml")
    faults = Faults(draft)
    open_scenes(draft, faults, None)
    faults.raise_any()


def _suite_seeds(_folder):
    scene = SCENE.replace("COLLISION", "boxes.yaml").replace("splat: splat.ply\n", "")
    place = {"place/scene.yaml": scene.encode(), "place/boxes.yaml": BOXES.encode()}
    return [{"mine.yaml": SUITE.encode(), **place}]


def _scene_seeds(folder):
    splat = _splat_files(folder)["a.ply"]
    meshes = _mesh_files()
    seeds = []
    for file, content in (("boxes.yaml", BOXES.encode()), ("a.obj", meshes["a.obj"]),
                          ("a.ply", meshes["a.ply"])):  # fmt: skip
        text = SCENE.replace("COLLISION", file).encode()
        seeds.append({"scene.yaml": text, file: content, "splat.ply": splat})
    return seeds


def _scene(folder):
    """Load a place, compile its world, cast a ray and read its splat, as a run would."""
    from nw_scenes.rays import RayScene
    from nw_scenes.robots import get_robot
    from nw_sim.catalogue import get_scene
    from nw_sim.physics import World

    scene = get_scene(folder)
    RayScene(scene.mesh()).height(scene.trail[:, :2])
    world = World(get_robot("go1"), scene)
    world.reset(position=(0.0, 0.0, 0.5), yaw=0.0)
    if scene.splat is not None:
        scene.splat_store()


def _published(folder):
    from nw_scenes.rays import RayScene
    from nw_sim.catalogue import get_scene

    (path,) = folder.rglob("*.xml")
    scene = get_scene(f"neverwhere:{path if path.parent == folder else path.parent}")
    RayScene(scene.mesh()).height(scene.trail[:, :2])


def _published_seeds(folder):
    """A course of boxes in one XML, and a scanned place as the label tool writes it."""
    import runpy

    made = runpy.run_path(str(Path(__file__).parents[1] / "scenes" / "neverwhere" / "conftest.py"))
    vertices, faces = _mesh()
    scan = folder / "real_scenes" / "kerb"
    made["Writer"](
        folder=scan, label=made["random_label"](np.random.default_rng(7)), normalise=None,
        vertices=vertices, faces=faces, trail=np.array([[1.7, 0, 0.1], [3, 0.1, 0]]),
        robots=("go1",),
    ).write()  # fmt: skip
    files = {str(path.relative_to(folder)): path.read_bytes() for path in scan.rglob("*.*")}
    return [{"parkour.xml": PUBLISHED.encode()}, files]


def _read_mesh(folder):
    from nw_scenes.mesh_file import read_mesh

    (path,) = folder.iterdir()
    read_mesh(path)


def _elevation_seeds(_):
    from PIL import Image
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    heights = np.add.outer(np.arange(12), np.arange(20)).astype(np.float32) / 20
    grey = (heights * 30_000).astype(np.uint16)
    seen = np.dstack([(grey >> 8).astype(np.uint8)] * 3 + [np.full(grey.shape, 255, np.uint8)])
    band = '<GDALMetadata><Item name="S" sample="0" role="scale">0.5</Item></GDALMetadata>'
    tags = ImageFileDirectory_v2()
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 3076, 0, 1, 9001, 4099, 0, 1, 9003)
    for tag, kind, value in (
        *((33550, 12, (0.1, 0.1, 0.0)), (34735, 3, keys), (42112, 2, band)),
        (42113, 2, "-9999"),
    ):
        tags.tagtype[tag], tags[tag] = kind, value
    found = []
    for name, pixels, how in (
        *(("a.tif", heights, {"tiffinfo": tags}), ("a.png", grey, {}), ("b.png", seen, {})),
        ("b.tif", heights, {"tiffinfo": tags, "compression": "tiff_lzw"}),
    ):
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, {"tif": "TIFF", "png": "PNG"}[name[2:]], **how)
        found.append({name: stream.getvalue()})
    return found


def _read_elevation(folder):
    from nw_scenes.elevation_file import elevation_mesh, read_elevation

    (path,) = folder.iterdir()
    white = 1.0 if path.suffix == ".png" else None
    found = read_elevation(path, cell=None if white is None else 0.1, white=white)
    vertices, faces = elevation_mesh(found)
    assert np.isfinite(vertices).all()
    assert not len(faces) or faces.max() < len(vertices)


_LEG = """
<body name="leg{0}" pos="{1} {2} 0">
<joint name="j{0}" axis="0 1 0" range="-1 1" damping="1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body>"""
_INERTIA = """<inertial><mass value="{0}"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
_LINK = """
<link name="l{0}">INERTIA<collision><origin xyz="0 0 -0.15"/>
<geometry><cylinder radius="0.02" length="0.3"/></geometry></collision></link>
<joint name="j{0}" type="revolute"><parent link="base"/><child link="l{0}"/>
<origin xyz="{1} {2} 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="20" velocity="10"/>
<dynamics damping="1" friction="0.1"/></joint>""".replace("INERTIA", _INERTIA.format(0.5))
_MOTOR = '<position name="j{0}" joint="j{0}" kp="30" forcerange="-20 20"/>'


def _robot_seeds(_):
    places = [(n, 0.2 * (-1) ** n, 0.1 * (-1) ** (n // 2)) for n in range(4)]
    legs, links, motors = (
        "".join(part.format(*place) for place in places) for part in (_LEG, _LINK, _MOTOR)
    )
    mjcf = f"""<mujoco model="four"><worldbody>
<body name="base" pos="0 0 0.4"><freejoint/>
<geom type="box" size="0.3 0.1 0.05" mass="5"/>{legs}</body></worldbody>
<actuator>{motors}</actuator></mujoco>"""
    urdf = f"""<robot name="four"><link name="base">{_INERTIA.format(5)}<collision>
<geometry><box size="0.6 0.2 0.1"/></geometry></collision></link>{links}</robot>"""
    return [{"four.xml": mjcf.encode()}, {"four.urdf": urdf.encode()}]


def _read_robot(folder):
    """Draft a robot.yaml of a model, in this process."""
    from nw_sim.probe.robot_draft import _draft

    (path,) = folder.iterdir()
    _draft(root=str(folder), file=path.name)


def _robot_log_seeds(_):
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
    from mcap_protobuf.writer import Writer

    from nw_scenes.robots import get_robot

    stream, robot = io.BytesIO(), get_robot("go1")
    with Writer(stream) as writer:
        for step in range(100):
            message = JointStates()
            for name, angle in zip(robot.joints, robot.default_pose, strict=True):
                joint = message.joints.add()
                joint.name, joint.position = name, angle + 0.1 * np.sin(step / 10)
                joint.velocity, joint.effort = np.cos(step / 10), 2.0
            writer.write_message("/joints", message, log_time=step * 10**7)
    return [{"log.mcap": stream.getvalue()}]


def _read_robot_log(folder):
    from nw_sim.rollout.replaying.log_container import as_mcap
    from nw_sim.rollout.replaying.robot_log import read_robot_log

    with as_mcap(folder / "log.mcap") as log:
        read_robot_log(log, robot="go1", topics={})


def _camera_seeds(_):
    import tempfile

    import pycolmap

    found = []
    for name in ("OPENCV", "EUCM", "SIMPLE_FISHEYE"):
        model = pycolmap.Reconstruction()
        model.add_camera_with_trivial_rig(
            pycolmap.Camera.create_from_model_name(1, name, 500.0, 640, 480)
        )
        for number in (1, 2):
            image = pycolmap.Image(name=f"images/{number}.jpg", camera_id=1, image_id=number)
            model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
        for write, suffix in ((model.write_binary, ".bin"), (model.write_text, ".txt")):
            with tempfile.TemporaryDirectory() as folder:
                write(folder)
                files = {p.name: p.read_bytes() for p in sorted(Path(folder).glob(f"*{suffix}"))}
            kept = (f"cameras{suffix}", f"images{suffix}", f"points3D{suffix}")
            found.append({name: files[name] for name in kept})
    frame = {"file_path": "images/1", "transform_matrix": np.eye(4).tolist(), "k1": None}
    whole = {"fl_x": 50, "w": 64, "h": 48, "camera_angle_y": 1.0, "applied_scale": 2.0,
             "camera_model": "FULL_OPENCV", "applied_transform": np.eye(4).tolist(),
             "frames": [frame, frame, {**frame, "file_path": "images\\2.png"}]}  # fmt: skip
    record = {"w": 64, "h": 48, "K": [50, 0, 0, 0, 50, 0, 32, 24, 1],
              "poses": [[0, 0, 0, 1, 0, 0, 0], [0, 0.1, 0, 0.995, 0.1, 0, 0]]}  # fmt: skip
    frame = {"intrinsics": [50, 0, 32, 0, 50, 24, 0, 0, 1],
             "cameraPoseARFrame": np.eye(4).ravel().tolist()}  # fmt: skip
    apps = [
        {"metadata": json.dumps(record).encode(), "rgbd/0.jpg": b"", "rgbd/1.jpg": b""},
        {"frame_00000.json": json.dumps(frame).encode(), "frame_00000.jpg": b""},
        {"lowres_wide.traj": b"1.5 0 0.1 0 0 0 0\n", "wide/4_1.502.png": b"",
         "wide_intrinsics/4_1.502.pincam": b"64 48 50 50 32 24\n"},
    ]  # fmt: skip
    return [*found, {"transforms.json": json.dumps(whole).encode()}, *apps]


def _read_cameras(folder):
    from nw_twin.calibrate.calibrate import find_source

    footage = find_source(folder, folder / "work", frames=2, say=lambda _: None)
    placed = (
        footage.cameras.placed if footage.cameras else ()
    )  # An app's JSON that is none any more.
    assert np.isfinite([one.lens.params for one in placed[:1]]).all()


def _read_splat(folder):
    """Read a file as a renderer would, down to the arrays of the kernels, without a warning."""
    from nw_splat.files import read_splat
    from nw_splat.gaussians import describe
    from nw_splat.store import memory_store

    (path,) = folder.iterdir()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gaussians = read_splat(path)
        assert describe(gaussians).count == len(gaussians)
        memory_store(gaussians)


def _store_seeds(folder):
    from nw_splat.store import compile_store

    folder.mkdir(parents=True, exist_ok=True)
    compile_store(_cloud(), folder / "a.nwsplat")
    return [{"a.nwsplat": (folder / "a.nwsplat").read_bytes()}]


def _store(folder):
    from nw_splat.store import memory_store, open_store

    found, good = open_store(folder / "a.nwsplat").layout.arrays(), memory_store(_cloud()).layout
    for name, array in good.arrays().items():
        if not np.array_equal(found[name], array):
            raise AcceptedError(f"{name} of a damaged store was accepted")


def _rows(count=4):
    from nw_gate.results.row import Row

    for index in range(count):
        yield Row(
            trial_id=f"hurdles-one-{index:03}", suite="hurdles", scene="hurdles/one",
            task="hurdles", robot="go1",
            seed_index=index, seed=2**63 + index, policy="gift", status="ok", outcome="fell",
            end_reason="roll", completed=False, success=0.75, waypoints_reached=3,
            waypoints_total=4, waypoint_times=(1.1, 2.2, 3.3), steps=200, sim_s=4.0, physics_s=0.5,
            render_s=1.0, policy_s=0.1, log_s=0.2, wall_s=2.0, checkpoint_digest="cc" * 32,
            scene_digest="dd" * 32, mcap_path=f"mcap/hurdles/one/{index}.mcap", mcap_bytes=9,
        )  # fmt: skip


def _check_rows(found):
    from nw_gate.results.row import to_dict

    good = {row.trial_id: to_dict(row) for row in _rows()}
    for row in found:
        if to_dict(row) != good.get(row.trial_id):
            raise AcceptedError(f"another row was accepted for {row.trial_id!r}: {to_dict(row)}")


def _journal_seeds(folder):
    from nw_gate.results.journal import Journal, JournalHeader

    header = JournalHeader(
        suite_digest="aa" * 32, policy_digest="bb" * 32, scene_digests={"hurdles/one": "dd" * 32},
        engine={"mujoco": "4.0.0"},
    )  # fmt: skip
    path = folder / "journal.jsonl"
    with Journal.create(path, header) as journal:
        for row in _rows():
            journal.append(row)
    return [{"journal.jsonl": path.read_bytes()}]


def _journal(folder):
    from nw_gate.results.journal import read_journal

    _check_rows(read_journal(folder / "journal.jsonl").rows)


def _run_seeds(folder):
    """A finished run of one real trial, with its log."""
    from nw_eval import api

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "tiny.yaml").write_text(
        "nw-eval: 1\nname: tiny\nrobot: go1\npolicy: stand\ntrials: 2\nseed: 3\n"
        "episode: {duration: 0.3}\nscenes: [flat/carpet_room]\nrecord: none\n"
        "gate: {success_rate: 0.5}\n"
    )
    report = api.run(folder / "tiny.yaml", out=folder / "run", workers=1)
    keep = ("run.json", "journal.jsonl", "trials.parquet")
    files = {name: (report.folder / name).read_bytes() for name in keep}
    files["good.json"] = json.dumps({"success": report.verdict.success}).encode()
    (log, *_) = sorted(report.folder.rglob("*.mcap"))
    return files, log.read_bytes()


def _run_folder(folder):
    from nw_eval import api

    good = json.loads((folder / "good.json").read_text())
    told = api.report(folder)
    if told.verdict.success not in {good["success"], None}:
        raise AcceptedError(f"success {told.verdict.success} in place of {good['success']}")


def _log_seeds(folder):
    return [{"trial.mcap": _run_seeds(folder)[1]}]


def _log(folder):
    from nw_sim.rollout.mcap.reader import LogReader
    from nw_sim.rollout.replaying.logged import read_logged_trial

    path = folder / "trial.mcap"
    reader = LogReader(path)
    read_logged_trial(path)
    reader.attachments()
    reader.topics()
    reader.states()
    seen = reader.observations("proprio")
    for stream in (reader.messages(), reader.frames(), reader.poses(), seen):
        for _ in itertools.islice(stream, 100_000):
            pass


def _parquet_seeds(folder):
    from nw_gate.results.parquet import write_rows
    from nw_gate.results.row import rows_digest

    folder.mkdir(parents=True, exist_ok=True)
    rows = list(_rows())
    write_rows(folder / "trials.parquet", rows, {"run_id": "x", "rows_digest": rows_digest(rows)})
    return [{"trials.parquet": (folder / "trials.parquet").read_bytes()}]


def _parquet(folder):
    from nw_gate.results.parquet import read_rows

    _check_rows(read_rows(folder / "trials.parquet")[0])


def _baseline_seeds(_folder):
    """A baseline before it is sealed, as text: what a stranger who can seal may have written."""
    manifest = {
        "bank": 1, "name": "gift", "suite": "hurdles", "note": "a gift", "starts": 2,
        "key": {"suite_digest": "aa" * 32, "seed": 7, "protocol": "strict",
                "scenes": {"hurdles/one": "dd" * 32}, "simulator": {"mujoco": "4.0.0"}},
        "policy": {"name": "gift", "card_digest": "bb" * 32, "checkpoint_digest": "cc" * 32},
        "panels": [{"machine": {"cpu": "znver4"}, "saved": "2026-11-22", "by": "anna",
                    "rows_digest": "ee" * 32}],
    }  # fmt: skip
    starts = {
        "panel": [0, 0], "scene": ["hurdles/one"] * 2, "task": ["hurdles"] * 2,
        "perturbation": [[["friction", 0.5]]] * 2, "seed_index": [0, 1], "success": [1.0, 0.5],
        "completed": [True, False], "waypoints_reached": [4, 2], "waypoints_total": [4, 4],
        "outcome": ["completed", "fell"], "end_reason": ["last waypoint", "roll"],
        "trajectory": ["0123456789abcdef", "fedcba9876543210"],
    }  # fmt: skip
    return [{"baseline.json": json.dumps([manifest, starts]).encode()}]


def _baseline(folder):
    """Read it as its file would be read, once its sum is right."""
    from nw_base.errors import StoreError
    from nw_gate.results.baseline_file import baseline_of
    from nw_gate.results.tables import PlainTable

    try:
        manifest, starts = json.loads((folder / "baseline.json").read_bytes())
        lines = list(zip(*starts.values(), strict=True))
        columns = {name: [line[place] for line in lines] for place, name in enumerate(starts)}
        table = PlainTable(metadata={"bank": json.dumps(manifest)}, columns=columns)
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise StoreError("baseline.json is not a table at all") from error
    baseline_of(table, folder / "gift.parquet")


def _wire_seeds(_folder):
    from nw_policies.remote import encode

    hello = {
        "protocol": 2, "policy": "x", "joints": 12, "digest": "ab" * 32,
        "observations": {"obs": [45]}, "control": {"scale": 0.25},
    }  # fmt: skip
    return [
        {"hello.bin": encode(hello), "answer.bin": encode({"action": np.zeros(12)})},
        {"hello.bin": encode(hello), "answer.bin": encode({"error": "no"})},
    ]


class _Server:
    """A policy server's side of a connection, whose every message lies in a file."""

    def __init__(self, messages):
        self._messages = iter(messages)

    def send(self, _data):
        pass

    def recv(self, timeout=None):  # noqa: ARG002
        return next(self._messages)

    def close(self):
        pass


def _wire(folder):
    """Hold a conversation with a server that says what the files say; no socket is needed."""
    from nw_policies import load_bundle, remote

    text = CARD.format(adapter="remote", file="x").replace("checkpoint: {file: x}\n", "")
    card = folder / "policy.yaml"
    card.write_text(text + "options: {url: 'ws://localhost:1', timeout: 1.0}\n")
    answers = ((folder / name).read_bytes() for name in ("hello.bin", "answer.bin"))
    server = _Server(answers)
    remote._connect = lambda *_: server
    policy = remote.RemotePolicy(load_bundle(card), joints=12)
    try:
        policy.act({"obs": np.zeros(45, np.float32)})
    except Exception as error:
        # What a trial says of it names the policy; what a check says names the card.
        if "'gift'" in str(error):
            raise PolicyError(f"hello.bin: {error}") from error
        raise


_ALL = (
    Target(name="suite", seeds=_suite_seeds, read=_suite, only=("mine.yaml",), lists=True),
    Target(
        name="card",
        seeds=lambda _: [
            {"policy.yaml": CARD.format(adapter="onnx", file="x.onnx").encode()},
            {
                "policy.yaml": Path(__file__)
                .parents[2]
                .joinpath("policies", "go1-parkour", "policy.yaml")
                .read_bytes()
            },
        ],
        read=_card,
        lists=True,
    ),
    Target(
        name="onnx",
        seeds=lambda _: _bundles(_onnx(), "onnx", "policy.onnx"),
        read=lambda folder: _open_bundle(folder, "policy.onnx"),
        only=("policy.onnx",),
        lists=True,
    ),
    Target(
        name="tensors",
        seeds=lambda _: (
            [{"a.pt": data} for data in _state_dicts()]
            + [{"a.safetensors": data} for data in _safetensors()]
        ),
        read=_tensors,
    ),
    Target(
        name="inspect",
        seeds=lambda _: [
            {name: data}
            for name, made in (
                ("a.onnx", _onnx),
                ("a.pt", _scripts),
                ("a.pt2", _exported),
                ("b.pt", _state_dicts),
                ("a.safetensors", _safetensors),
            )
            for data in made()
        ],
        read=_inspect,
    ),
    Target(name="scene", seeds=_scene_seeds, read=_scene, lists=True),
    Target(name="published", seeds=_published_seeds, read=_published, lists=True),
    Target(
        name="mesh",
        seeds=lambda _: [{name: data} for name, data in _mesh_files().items()],
        read=_read_mesh,
    ),
    Target(
        name="splat",
        seeds=lambda folder: [{name: data} for name, data in _splat_files(folder).items()],
        read=_read_splat,
    ),
    Target(name="elevation", seeds=_elevation_seeds, read=_read_elevation),
    Target(name="robot", seeds=_robot_seeds, read=_read_robot, lists=True),
    Target(name="robot log", seeds=_robot_log_seeds, read=_read_robot_log),
    Target(name="cameras", seeds=_camera_seeds, read=_read_cameras),
    Target(name="store", seeds=_store_seeds, read=_store),
    Target(name="journal", seeds=_journal_seeds, read=_journal),
    Target(name="parquet", seeds=_parquet_seeds, read=_parquet),
    Target(name="baseline", seeds=_baseline_seeds, read=_baseline),
    Target(
        name="run",
        seeds=lambda folder: [_run_seeds(folder)[0]],
        read=_run_folder,
        only=("run.json", "journal.jsonl", "trials.parquet"),
        lists=True,
        may=(PARQUET_APART, f"open {gettempdir()} for writing"),
    ),
    Target(name="mcap", seeds=_log_seeds, read=_log),
    Target(name="remote", seeds=_wire_seeds, read=_wire, only=(".bin",)),
)
TARGETS = {target.name: target for target in _ALL}
