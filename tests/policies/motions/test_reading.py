"""Files of reference motions: the layouts that others write, and what is refused of them."""

import io
import os
import pickle  # noqa: TID251 - to write what must be read without it.
import sys
import tracemalloc
import types
import zipfile
from contextlib import suppress

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_base.errors import PolicyError
from nw_policies.motions.reading import read_motion

FRAMES, JOINTS = 6, 4
ANGLES = np.linspace(0.0, 1.0, FRAMES * JOINTS).reshape(FRAMES, JOINTS)
ROOT = np.column_stack([np.linspace(0, 1, FRAMES), np.zeros(FRAMES), np.full(FRAMES, 0.8)])
WXYZ = np.tile([0.8, 0.0, 0.0, 0.6], (FRAMES, 1))
XYZW = WXYZ[:, [1, 2, 3, 0]]


def npz(**changed):
    """An .npz as `csv_to_npz.py` of whole_body_tracking writes it: single precision, no names."""
    arrays = {
        "fps": np.array([50]),
        "joint_pos": ANGLES.astype(np.float32),
        "joint_vel": np.ones((FRAMES, JOINTS), np.float32),
        "body_pos_w": np.stack([ROOT, ROOT + 0.1], axis=1).astype(np.float32),
        "body_quat_w": np.stack([WXYZ, WXYZ], axis=1).astype(np.float32),
        **changed,
    }
    buffer = io.BytesIO()
    np.savez(buffer, **{name: array for name, array in arrays.items() if array is not None})
    return buffer.getvalue()


def csv(rows=None, header=""):
    rows = np.column_stack([ROOT, XYZW, ANGLES]) if rows is None else rows
    return (header + "\n".join(",".join(f"{x:.6f}" for x in row) for row in rows)).encode()


class NumpyArrayWrapper:
    """Has the attributes that joblib 1.4 gives its own."""

    __module__ = "joblib.numpy_pickle"

    def __init__(self, array):
        self.subclass, self.shape, self.order = np.ndarray, array.shape, "C"
        self.dtype, self.allow_mmap, self.numpy_array_alignment_bytes = array.dtype, True, 16


class JoblibPickler(pickle._Pickler):
    """Writes arrays as `joblib.numpy_pickle` does: a description, padding, and the numbers."""

    def __init__(self, stream):
        super().__init__(stream, protocol=4)
        self.stream = stream

    def save(self, obj, save_persistent_id=True):
        if type(obj) is not np.ndarray:
            super().save(obj, save_persistent_id)
            return
        super().save(NumpyArrayWrapper(obj), save_persistent_id)
        self.framer.commit_frame(force=True)
        padding = 16 - (self.stream.tell() + 1) % 16
        self.stream.write(bytes([padding]) + b"\xff" * padding + obj.tobytes())


@pytest.fixture
def joblib_pickle(monkeypatch):
    """Dump as joblib does, whose package is not installed here."""
    module = types.ModuleType("joblib.numpy_pickle")
    module.NumpyArrayWrapper = NumpyArrayWrapper
    monkeypatch.setitem(sys.modules, "joblib", types.ModuleType("joblib"))
    monkeypatch.setitem(sys.modules, "joblib.numpy_pickle", module)

    def dump(tree):
        stream = io.BytesIO()
        JoblibPickler(stream).dump(tree)
        return stream.getvalue()

    return dump


def policy_with_motion():
    """A policy as whole_body_tracking exports it: `time_step` picks a row of each table."""
    tables = {
        "joint_pos": ANGLES,
        "joint_vel": np.ones((FRAMES, JOINTS)),
        "body_pos_w": np.stack([ROOT, ROOT + 0.1], axis=1),
        "body_quat_w": np.stack([WXYZ, WXYZ], axis=1),
    }
    nodes = [
        helper.make_node("Cast", ["time_step"], ["long"], to=TensorProto.INT64),
        helper.make_node("Squeeze", ["long", "last"], ["flat"]),
        helper.make_node("Min", ["flat", "end"], ["row"]),
        helper.make_node("MatMul", ["obs", "weight"], ["actions"]),
    ]
    constants = {"last": np.array([1]), "end": np.array([FRAMES - 1])}
    constants["weight"] = np.ones((3, JOINTS), np.float32)
    for name, table in tables.items():
        constants[f"{name}_table"] = table.astype(np.float32)
        nodes.append(helper.make_node("Gather", [f"{name}_table", "row"], [name], axis=0))
    graph = helper.make_graph(
        nodes,
        "policy",
        [
            helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 3]),
            helper.make_tensor_value_info("time_step", TensorProto.FLOAT, [1, 1]),
        ],
        [
            helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, JOINTS]),
            *(
                helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, *table.shape[1:]])
                for name, table in tables.items()
            ),
        ],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"joint_names": "a,b,c,d", "anchor_body_name": "torso"})
    return model.SerializeToString()


def test_an_npz_has_joints_rates_and_the_bodies_as_they_are():
    motion = read_motion(npz(), "dance.npz")
    assert (motion.rate, motion.joints) == (50.0, ())
    np.testing.assert_allclose(motion.joint_positions, ANGLES, atol=1e-6)
    np.testing.assert_array_equal(motion.joint_velocities, 1.0)
    np.testing.assert_allclose(motion.positions[:, 1] - motion.positions[:, 0], 0.1, atol=1e-6)
    np.testing.assert_allclose(motion.quats[:, 0], WXYZ, atol=1e-6)


def test_an_npz_of_mujocos_coordinates_loses_the_root_and_the_world():
    angles = np.column_stack([ROOT, WXYZ, ANGLES])
    rates = np.column_stack([np.full((FRAMES, 6), 9.0), np.ones((FRAMES, JOINTS))])
    motion = read_motion(
        npz(
            joint_pos=angles,
            joint_vel=rates,
            joint_names=np.array(["a", "b", "c", "d"]),
            body_names=np.array(["world", "pelvis"]),
            body_pos_w=np.stack([np.zeros_like(ROOT), ROOT], axis=1),
        ),
        "box.npz",
    )
    assert motion.joints == ("a", "b", "c", "d")
    np.testing.assert_array_equal(motion.joint_positions, ANGLES)
    np.testing.assert_array_equal(motion.joint_velocities, 1.0)
    np.testing.assert_array_equal(motion.positions, ROOT[:, np.newaxis])


@pytest.mark.parametrize("header", ["", "x,y,z,qx,qy,qz,qw,a,b,c,d\n"])
def test_a_csv_is_root_quaternion_with_w_last_and_joints(header):
    motion = read_motion(csv(header=header), "dance.csv")
    assert motion.rate is None
    np.testing.assert_allclose(motion.joint_positions, ANGLES, atol=1e-6)
    np.testing.assert_allclose(motion.positions[:, 0], ROOT, atol=1e-6)
    np.testing.assert_allclose(motion.quats[:, 0], WXYZ, atol=1e-6)


def test_a_pickle_of_joblib_is_read_without_joblib(joblib_pickle):
    inner = {
        "root_trans_offset": ROOT.astype(np.float32),
        "pose_aa": np.zeros((FRAMES, 3, 3), np.float32),
        "dof": ANGLES.astype(np.float32),
        "root_rot": XYZW,
        "fps": 30,
    }
    motion = read_motion(joblib_pickle({"0-kick": inner}), "kick.pkl")
    assert motion.rate == 30.0
    np.testing.assert_allclose(motion.joint_positions, ANGLES, atol=1e-6)
    np.testing.assert_allclose(motion.positions[:, 0], ROOT, atol=1e-6)
    np.testing.assert_allclose(motion.quats[:, 0], WXYZ, atol=1e-12)


def test_a_pickle_of_gmr_has_names_of_its_own():
    fields = {"fps": 30, "root_pos": ROOT, "root_rot": XYZW, "dof_pos": ANGLES}
    motion = read_motion(pickle.dumps(fields), "dance.pkl")
    np.testing.assert_array_equal(motion.joint_positions, ANGLES)
    np.testing.assert_allclose(motion.quats[:, 0], WXYZ, atol=1e-12)


def test_a_pickle_of_mimickit_has_rotation_vectors():
    turn = 2.0 * np.arccos(0.8)  # About z, as the quaternions above.
    rows = np.column_stack([ROOT, np.tile([0.0, 0.0, turn], (FRAMES, 1)), ANGLES])
    motion = read_motion(pickle.dumps({"loop_mode": 0, "fps": 60, "frames": rows}), "spin.pkl")
    assert motion.rate == 60.0
    np.testing.assert_allclose(motion.quats[:, 0], WXYZ, atol=1e-12)
    np.testing.assert_array_equal(motion.joint_positions, ANGLES)


def test_a_policy_that_holds_its_motion_is_one():
    motion = read_motion(policy_with_motion(), "policy.onnx")
    assert (motion.rate, motion.joints) == (None, ("a", "b", "c", "d"))
    np.testing.assert_allclose(motion.joint_positions, ANGLES, atol=1e-6)
    np.testing.assert_allclose(motion.positions[:, 0], ROOT, atol=1e-6)


def broken(array, value, place):
    array = array.copy()
    array[place] = value
    return array


class Evil:
    def __reduce__(self):
        return os.system, ("true",)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.npz", lambda: npz(joint_vel=None), "has no joint_vel; it has fps, joint_pos"),
        (
            "a.npz",
            lambda: npz(body_pos_w=np.zeros((FRAMES, 2))),
            "body_pos_w has the shape (6, 2), and not 3 axes",
        ),
        (
            "a.npz",
            lambda: npz(joint_pos=broken(ANGLES, np.nan, (3, 1))),
            "joint angles are not finite at frame 3",
        ),
        ("a.npz", lambda: npz(fps=np.array([0])), "fps is 0"),
        ("a.npz", lambda: npz(joint_pos=np.array([object()])), "joint_pos has object"),
        ("a.npz", lambda: npz()[:300], "not a usable .npz file"),
        (
            "a.npz",
            lambda: npz(joint_pos=None, joint_vel=None, body_pos_w=None, poses=ANGLES),
            "that is AMASS",
        ),
        ("a.csv", lambda: csv(np.column_stack([ROOT, WXYZ * 2, ANGLES])), "has the norm 2"),
        ("a.csv", lambda: csv(ROOT), "it has 3 numbers a line"),
        ("a.csv", lambda: csv() + b"\n1,2\n", "line 7 has 2 numbers, the first 11"),
        ("a.csv", lambda: csv()[:90] + b",x,1\n" + csv(), "cannot be read"),
        ("a.csv", lambda: csv(np.column_stack([ROOT, XYZW, ANGLES])[:1]), "has 1 frames"),
        ("a.bvh", lambda: b"\xff\xfe\x00", "no motion that is known here"),
        ("a.pkl", lambda: pickle.dumps({"a": {}, "b": {}}), "the file has 2 motions: a, b"),
        ("a.pkl", lambda: pickle.dumps({"fps": 30, "dof": ANGLES}), "has no root_trans_offset"),
        ("a.pkl", lambda: pickle.dumps({"dof": Evil()}), "asks to call 'posix.system'"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_its_name(name, data, words):
    with pytest.raises(PolicyError) as error:
        read_motion(data(), name)
    assert str(error.value).startswith(f"{name}: ")
    assert words in str(error.value)
    assert error.value.fix


def test_an_array_that_its_header_makes_huge_takes_no_memory():
    small = io.BytesIO()
    np.save(small, np.zeros(4))
    bomb = small.getvalue().replace(b"(4,), }         ", b"(400000000000,)}")
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("fps.npy", bomb)
    with pytest.raises(PolicyError, match="more than 256 MiB in double precision, fps"):
        read_motion(content.getvalue(), "bomb.npz")


def test_small_numbers_count_by_what_they_take_here():
    # One byte each and all 0, they are a small file, and 8 bytes each once they are read.
    rows, bodies = 19_000, 1900
    bodies_here = {
        "body_pos_w": np.zeros((rows, bodies, 3), np.int8),
        "body_quat_w": np.zeros((rows, bodies, 4), np.int8),
    }
    stored = io.BytesIO()
    with zipfile.ZipFile(stored, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in bodies_here.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.save(member, array)
    del bodies_here
    tracemalloc.start()
    with pytest.raises(PolicyError, match="body_pos_w with the shape"):
        read_motion(stored.getvalue(), "bomb.npz")
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()


def member(name, header, numbers=b"", *, method=zipfile.ZIP_STORED):
    """An .npz of which one member has a header that NumPy would not write."""
    with zipfile.ZipFile(io.BytesIO(npz())) as whole:
        contents = {each.filename: whole.read(each) for each in whole.infolist()}
    contents[f"{name}.npy"] = (
        b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + numbers
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for filename, content in contents.items():
            archive.writestr(filename, content)
    return buffer.getvalue()


def shaped(shape):
    return f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n"


def damaged(method):
    """An .npz with a broken byte in what was compressed, 50 bytes on."""
    data = bytearray(member("fps", shaped("(1,)"), bytes(8), method=method))
    data[50] ^= 0xFF
    return bytes(data)


def gmr(**changed):
    fields = {"fps": 30, "root_pos": ROOT, "root_rot": XYZW, "dof_pos": ANGLES, **changed}
    return pickle.dumps(fields)


def shared_list():
    """A list of 8e9 numbers that is a file of some kB."""
    row = [0.0] * 2000
    return [[row] * 2000] * 2000


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (lambda: npz(fps=np.array("abc")), "fps has <U3"),
        (lambda: npz(fps=np.array([])), "fps is [], and not one number"),
        (lambda: npz(fps=np.array([50, 60])), "fps is [50. 60.], and not one number"),
        (lambda: npz(fps=np.array(True)), "fps has bool"),
        (lambda: npz(fps=np.array(np.inf)), "fps is inf"),
        (lambda: npz(fps=np.array(10_001)), "fps is 10001"),
        (lambda: npz(joint_pos=np.array(["a", "b"])), "joint_pos has <U1"),
        (lambda: npz(joint_pos=np.array(3.0)), "joint_pos has the shape ()"),
        (lambda: npz(body_pos_w=np.array(1.0)), "body_pos_w has the shape ()"),
        (lambda: npz(body_quat_w=np.zeros(5)), "body_quat_w has the shape (5,)"),
        (
            lambda: npz(body_pos_w=np.full((FRAMES, 2, 3), 1e5)),
            "positions of bodies are over 10000 at frame 0",
        ),
        (
            lambda: npz(
                body_pos_w=np.zeros((FRAMES, 513, 3)), body_quat_w=np.zeros((FRAMES, 513, 4))
            ),
            "the motion has 513 bodies",
        ),
        (lambda: npz(joint_names=np.array(3.0)), "joint_names is no array"),
        (lambda: member("fps", "{'descr': '<f8', 'shape': (1,"), "fps cannot be read"),
        (lambda: member("fps", "-" * 9000 + "1"), "fps cannot be read"),
        (lambda: member("fps", shaped(f"({2**70},)")), "fps with the shape"),
        (lambda: member("joint_pos", shaped(f"(0, {2**70})")), "joint_pos cannot be read"),
        (lambda: member("joint_pos", shaped("(True, 3)"), bytes(24)), "the shape (True, 3)"),
        (lambda: member("joint_pos", shaped("(-1, 3)"), bytes(24)), "the shape (-1, 3)"),
        (lambda: member("joint_pos", shaped("(6, 4)"), bytes(24)), "more or fewer bytes"),
        (lambda: damaged(zipfile.ZIP_LZMA), "fps cannot be read: LZMAError"),
        (lambda: damaged(zipfile.ZIP_BZIP2), "fps cannot be read: OSError"),
        (lambda: damaged(zipfile.ZIP_DEFLATED), "fps cannot be read"),
        (lambda: gmr(fps=10**400), "fps is 1000"),
        (lambda: gmr(fps=True), "fps is True"),
        (lambda: gmr(fps="30"), "fps is 30, and not one number"),
        (lambda: gmr(fps=np.bool_(True)), "fps is"),
        (lambda: gmr(root_pos=5), "root_pos is no array of numbers"),
        (lambda: gmr(root_pos=[10**400]), "root_pos is no array of numbers"),
        (lambda: gmr(root_rot=XYZW[0]), "the shape of the root's quaternion is (4,)"),
        (lambda: gmr(dof_pos=None), "dof_pos is no array of numbers"),
        (lambda: gmr(dof_pos=shared_list()), "dof_pos with the shape (2000, 2000, 2000)"),
        (lambda: gmr(dof_pos=[[0.0], shared_list()]), "dof_pos is no array of numbers"),
        *(
            (
                lambda value=value: pickle.dumps({"fps": 60, "frames": np.full((5, 9), value)}),
                f"joint angles are {words} at frame 0",
            )
            for value, words in ((np.inf, "not finite"), (1e200, "over 10000"))
        ),
    ],
)
def test_a_damaged_file_is_an_error_that_names_file_and_field(data, words):
    with pytest.raises(PolicyError) as error:
        read_motion(data(), "dance")
    assert str(error.value).startswith("dance: ")
    assert words in str(error.value)
    assert error.value.fix


@pytest.mark.parametrize("protocol", [2, 4])
@pytest.mark.parametrize("rate", [np.int64(30), np.float32(30.0)])
def test_frames_a_second_may_be_a_number_of_numpy(rate, protocol):
    fields = {"fps": rate, "root_pos": ROOT, "root_rot": XYZW, "dof_pos": ANGLES}
    assert read_motion(pickle.dumps(fields, protocol), "dance.pkl").rate == 30.0


@pytest.mark.parametrize("seed", range(4))
def test_whatever_bytes_a_motion_has_no_other_error_comes_of_them(seed):
    generator = np.random.default_rng(seed)
    for whole in (npz(), csv(), gmr(), policy_with_motion()):
        for number in range(50):
            data = bytearray(whole[: generator.integers(4, len(whole))] if number % 2 else whole)
            for place in generator.integers(1, len(data), 3):
                data[place] = generator.integers(256)
            with suppress(PolicyError):
                assert read_motion(bytes(data), "dance").positions.ndim == 3


def test_a_policy_without_a_motion_is_none():
    graph = helper.make_graph(
        [helper.make_node("Identity", ["obs"], ["actions"])],
        "policy",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 3])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 3])],
    )
    data = onnx.helper.make_model(graph, ir_version=8).SerializeToString()
    with pytest.raises(PolicyError, match="has no joint_pos, joint_vel, body_pos_w, body_quat_w"):
        read_motion(data, "policy.onnx")
