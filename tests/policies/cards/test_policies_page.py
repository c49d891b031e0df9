"""The pages on policies name what the code has: every key, adapter, term, camera and default.

Its files and commands are used as they stand there.
"""

import ast
import math
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_policies import load_bundle, open_policy
from nw_policies.cards import Card, load_card
from nw_policies.cards.control import Control
from nw_policies.cards.networks import ADAPTERS
from nw_policies.cards.observations import (
    BUILT_IN_SENSORS,
    BaseObservation,
    History,
    ProprioObservation,
)
from nw_policies.cards.terms import (
    Acceleration,
    AnyTerm,
    FootContacts,
    Gravity,
    LastOutput,
    Yaw,
)
from nw_policies.remote import RemoteOptions
from nw_scenes.robots import get_robot
from nw_sim.rollout.confined.vetting import check_bundle
from nw_sim.sensors import check_card
from nw_sim.sensors.heights import grid

NW_EVAL = [sys.executable, "-c", "from nw_eval.cli import main; main()"]
DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGES = (
    "how-to/policy-card.md",
    "reference/policy-card.md",
    "reference/observations.md",
    "how-to/policy-in-python.md",
    "how-to/policy-server.md",
)
PAGE = "\n".join((DOCS / page).read_text(encoding="utf-8") for page in PAGES)
FILES = dict(re.findall(r"^```\w+ (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
TERMS = [get_args(term.model_fields["term"].annotation)[0] for term in get_args(AnyTerm)]
OPTIONS = ("depth_every", "steer_by_depth", "heads", "ensemble", "query_every")


@pytest.mark.parametrize(
    "name",
    [
        *Control.model_fields,
        *TERMS,
        *ADAPTERS,
        *BUILT_IN_SENSORS,
        *BaseObservation.model_fields,
        *OPTIONS,
        *RemoteOptions.model_fields,
    ],
)
def test_it_names(name):
    assert re.search(rf"`{name}\b", PAGE) or re.search(rf"`{name}`", PAGE)


def test_it_has_every_key_of_a_card_and_of_histories():
    keys = {field.alias or name for name, field in Card.model_fields.items()}
    for key in keys | set(ProprioObservation.model_fields) - {"sensor"}:
        assert re.search(rf"\b{key}\b", PAGE), key
    for key in History.model_fields:
        assert re.search(rf"\b{key}:", PAGE), key


def rows(heading):
    """The rows of the table whose first column has this heading, as lists of cells."""
    (table,) = re.findall(
        rf"^\| {re.escape(heading)} \|.*\n\|[-|]+\n((?:\|.*\n)+)", PAGE, re.MULTILINE
    )
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines()]


def card(folder, observation):
    """A card with one observation, written as on the page."""
    (folder / "policy.yaml").write_text(
        "nw-policy: 1\nname: c\nrobot: go1\nadapter: zero\n"
        "control: {action: joint_position_offset, scale: 0.25}\n"
        f"observations:\n  seen: {observation}\n"
    )
    return load_card(folder / "policy.yaml")


@pytest.mark.parametrize("term", [Acceleration, FootContacts, LastOutput, Yaw])
def test_the_row_of_a_term_has_its_keys_and_words(term):
    (name,) = get_args(term.model_fields["term"].annotation)
    (row,) = (cells for cells in rows("term") if f"`{name}`" in cells[0])
    for key in set(term.model_fields) - set(Gravity.model_fields):
        assert re.search(rf"`{key}\b", row[2]), key
        for word in get_args(term.model_fields[key].annotation):
            if isinstance(word, str):
                assert re.search(rf"\b{word}\b", row[2]), word


def test_its_filters_are_filters(tmp_path):
    said = re.findall(r"^filter: (\{.*\}) +#", PAGE, re.MULTILINE)
    assert len(said) == 3
    for line in said:
        (tmp_path / "policy.yaml").write_text(
            "nw-policy: 1\nname: c\nrobot: go1\nadapter: zero\ncontrol:\n"
            f"  action: joint_position_offset\n  filter: {line}\n"
        )
        low_pass = load_card(tmp_path / "policy.yaml").control.filter
        assert f"kind: {low_pass.kind}" in line


def test_its_clocks_are_clocks_of_the_size_that_their_stacks_see(tmp_path):
    said = re.findall(r"^(\{term: clock.*\}) +# ([\w-]+)", PAGE, re.MULTILINE)
    sizes = {}
    for line, stack in said:
        written = card(tmp_path, f"{{sensor: proprio, terms: [{line}]}}")
        (spec,) = check_card(written)
        sizes[stack] = spec.shape
    assert sizes == {
        "walk-these-ways": (4,),
        "unitree_rl_gym": (2,),
        "unitree_rl_mjlab": (2,),
        "Playground": (4,),
    }


def test_its_defaults_of_histories_are_those_of_the_code():
    (line,) = re.findall(r"`history: \{steps: 6, (.*?)\}`", PAGE)
    said = dict(pair.split(": ") for pair in line.split(", "))
    fields = History(steps=6).model_dump(exclude={"steps", "zero"})
    assert said == {name: str(value).replace("True", "true") for name, value in fields.items()}


@pytest.mark.parametrize(("robot", "degrees_down"), [("go1", 0.0), ("go2", 18.4)])
def test_its_cameras_are_the_robots(robot, degrees_down):
    cameras = get_robot(robot).cameras
    said = {name.strip("`"): float(view.split()[0]) for name, view in rows("camera")}
    assert said == {name: round(math.degrees(c.fovy), 1) for name, c in cameras.items()}
    (where,) = re.findall(
        rf"{robot.title()} are (?:in|above) the head, at \((.*?)\) m", PAGE.replace("\n", " ")
    )
    for mount in cameras.values():
        assert mount.position == pytest.approx([float(part) for part in where.split(",")])
        forward = np.array(mount.R_trunk_camera)[:, 2]
        assert math.degrees(-math.asin(forward[2])) == pytest.approx(degrees_down, abs=0.05)


def test_its_height_scan_of_isaac_lab_has_the_points_of_isaac_lab(tmp_path):
    (said,) = re.findall(r"`(\{sensor: scandots, .*?\})`", PAGE)
    written = card(tmp_path, said)
    (spec,) = check_card(written)
    assert spec.shape == (187,)
    seen = written.observations["seen"]
    # GridPatternCfg(resolution=0.1, size=(1.6, 1.0)): torch.meshgrid(x, y, indexing="xy"), flat.
    points = [(-0.8 + 0.1 * i, -0.5 + 0.1 * j) for j in range(11) for i in range(17)]
    np.testing.assert_allclose(grid(seen.x, seen.y, seen.order), points, atol=1e-12)


def test_its_command_folds_the_weights_into_the_graph(tmp_path):
    weight = np.random.default_rng(0).normal(0, 0.1, (48, 12)).astype(np.float32)
    node = helper.make_node("MatMul", ["obs", "w"], ["actions"])
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        [node],
        "g",
        [value("obs", TensorProto.FLOAT, [1, 48])],
        [value("actions", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(weight, "w")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(
        model, tmp_path / "policy.onnx", save_as_external_data=True, location="policy.onnx.data"
    )
    words, _ = re.findall(r"^nw-eval (policies fold .*)$", PAGE, re.MULTILINE)
    subprocess.run([*NW_EVAL, *words.split()], cwd=tmp_path, check=True)
    (tmp_path / "policy.onnx.data").unlink()
    (folded,) = onnx.load(tmp_path / "one.onnx").graph.initializer
    np.testing.assert_array_equal(numpy_helper.to_array(folded), weight)


def unpack(folder):
    """Write the files of the page that stand in `folder` there, and return it."""
    for name, text in FILES.items():
        if name.startswith(f"{folder.name}/"):
            folder.mkdir(exist_ok=True)
            (folder.parent / name).write_text(text)
    return folder


def test_its_policy_in_python_runs_and_remembers(tmp_path):
    bundle = load_bundle(unpack(tmp_path / "my-trot"))
    (spec,) = check_bundle(bundle, allow_code=True)
    policy = open_policy(bundle, allow_code=True)
    seen = {"body": np.zeros(spec.shape, spec.dtype)}
    policy.reset(5)
    policy.act(seen)
    state = policy.state()
    after = [policy.act(seen) for _ in range(20)]
    assert np.ptp(after, axis=0).max() > 0.5
    policy.restore(state)
    np.testing.assert_array_equal([policy.act(seen) for _ in range(20)], after)
    policy.reset(5)
    policy.act(seen)
    np.testing.assert_array_equal(policy.act(seen), after[0])


def test_its_policy_in_python_has_its_code_in_its_digest(tmp_path):
    folder = unpack(tmp_path / "my-trot")
    before = load_bundle(folder).digest
    (folder / "trot.py").write_text(FILES["my-trot/trot.py"].replace("0.25 *", "0.5 *"))
    assert load_bundle(folder).digest != before


@pytest.fixture
def served(tmp_path):
    """The page's server in a process of its own at a free port, and its card."""
    folder = unpack(tmp_path / "my-server")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    for name in ("server.py", "policy.yaml"):
        text = (folder / name).read_text()
        assert "8765" in text
        (folder / name).write_text(text.replace("8765", str(port)))
    process = subprocess.Popen([sys.executable, "server.py"], cwd=folder)
    try:
        until = time.monotonic() + 60.0
        while not answers(port):
            assert time.monotonic() < until, "the page's server does not listen"
            time.sleep(0.05)
        yield folder
    finally:
        process.kill()
        process.wait()


def answers(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_its_server_serves_its_card(served):
    bundle = load_bundle(served)
    (spec,) = check_bundle(bundle)
    policy = open_policy(bundle)
    policy.reset(0)
    body = np.arange(spec.shape[0], dtype=spec.dtype)
    np.testing.assert_array_equal(policy.act({"body": body}), -0.5 * body[3:])
    policy.restore(policy.state())
    policy.close()


def test_its_server_knows_nothing_of_this_package():
    tree = ast.parse(FILES["my-server/server.py"])
    imported = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert imported
    assert not any("nw_eval" in ast.unparse(node) for node in imported)
