"""Checkpoints of given inputs, and the cards drafted from them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_eval.api.policies import init_policy
from nw_policies import load_bundle, open_policy
from nw_policies.cards.card import Card
from nw_policies.cards.feeding import shape_problems
from nw_policies.cards.load import load_card
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.drafting.draft import write_card_draft
from nw_scenes.robots import get_robot
from nw_sim.sensors import check_card


@pytest.fixture
def onnx_file(tmp_path: Path) -> Callable[..., Path]:
    """Save a graph of twelve actions that takes `inputs`, by name and shape."""

    def save(
        inputs: dict[str, list[int | None]], metadata: dict[str, str] | None = None, name="p.onnx"
    ) -> Path:
        nodes = [
            helper.make_node("ReduceMean", [given], [f"mean{i}"], keepdims=0)
            for i, given in enumerate(inputs)
        ]
        means = [node.output[0] for node in nodes]
        nodes.append(helper.make_node("Sum", ["zeros", *means], ["actions"]))
        graph = helper.make_graph(
            nodes,
            "g",
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs.items()],
            [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12])],
            [numpy_helper.from_array(np.zeros((1, 12), np.float32), "zeros")],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        helper.set_model_props(model, metadata or {})
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        onnx.save(model, str(path))
        return path

    return save


@pytest.fixture
def drafted() -> Callable[[Path], tuple[str, Card, list[str]]]:
    """Write a draft beside a checkpoint, open it, and say what does not fit."""

    def write(path: Path) -> tuple[str, Card, list[str]]:
        text = write_card_draft(inspect_checkpoint(path), get_robot("go1"))
        (path.parent / "policy.yaml").write_text(text)
        bundle = load_bundle(path.parent)
        policy = open_policy(bundle)
        shapes = {seen.name: seen.shape for seen in check_card(bundle.card)}
        problems = shape_problems(bundle.card, policy.inputs, shapes)
        policy.close()
        return text, bundle.card, problems

    return write


@pytest.fixture
def card_of(onnx_file):
    """Write files beside a graph, and return the text of its card and the card."""

    def draft(
        size: int | dict[str, int],
        beside: dict[str, str],
        robot="go2",
        metadata=None,
        name="run/exported/policy.onnx",
    ) -> tuple[str, Card]:
        inputs = size if isinstance(size, dict) else {"obs": size}
        shapes = {given: [1, numbers] for given, numbers in inputs.items()}
        path = onnx_file(shapes, metadata, name=name)
        for file, text in beside.items():
            (path.parent / file).parent.mkdir(parents=True, exist_ok=True)
            (path.parent / file).write_text(text)
        text = init_policy(path, robot=robot).text
        return text, load_card(path.parent / "policy.yaml")

    return draft
