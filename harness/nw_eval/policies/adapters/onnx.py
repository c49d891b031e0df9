"""ONNX checkpoints, run by onnxruntime on one thread."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnxruntime as ort

from nw_eval.errors import PolicyError, TrialError, nearest
from nw_eval.policies.adapters.stateless import Stateless
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.inputs import InputAssembler
from nw_eval.policies.policy import Action, InputSpec, Observation, checked_action

_DTYPES: dict[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}


class OnnxPolicy(Stateless):
    """A feed-forward ONNX graph.

    The graph is loaded from bytes that were verified, without external data files and without
    custom operators, so it can do arithmetic and nothing else.
    """

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        self._name = bundle.name
        self._joints = joints
        self._session: ort.InferenceSession | None = _open(bundle)
        self.inputs = tuple(_spec(bundle, node) for node in self._session.get_inputs())
        self._assemble = InputAssembler(bundle.card, self.inputs)
        self._outputs = [_output(bundle, self._session.get_outputs(), joints)]

    def act(self, observation: Observation) -> Action:
        """Run the graph once."""
        if self._session is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        feeds = self._assemble(observation)
        try:
            (raw,) = self._session.run(self._outputs, feeds)
        except Exception as error:
            raise TrialError(f"policy {self._name!r} failed: {_reason(error)}") from error
        return checked_action(raw, joints=self._joints, policy=self._name)

    def close(self) -> None:
        """Free the graph."""
        self._session = None


def _open(bundle: Bundle) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # What is wrong is raised; a warning would only be noise.
    data = bundle.read_checkpoint()
    try:
        return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # noqa: BLE001 - onnxruntime's exceptions share no public base.
        raise PolicyError(
            f"{bundle.checkpoint}: not a usable ONNX file: {_reason(error)}",
            fix="export it again as one file with standard operators",
        ) from None


def _spec(bundle: Bundle, node: Any) -> InputSpec:
    if node.type not in _DTYPES:
        raise PolicyError(
            f"{bundle.checkpoint}: input {node.name!r} is a {node.type}",
            fix=f"export it as one of {', '.join(_DTYPES)}",
        )
    shape = tuple(size if isinstance(size, int) else None for size in node.shape)
    return InputSpec(name=node.name, shape=shape, dtype=np.dtype(_DTYPES[node.type]))


def _output(bundle: Bundle, nodes: Any, joints: int) -> str:
    by_name = {node.name: node for node in nodes}
    wanted = bundle.card.output
    if wanted is not None and wanted not in by_name:
        raise PolicyError(
            f"{bundle.card_path}: the checkpoint has no output {wanted!r}",
            fix=nearest(wanted, by_name),
        )
    node = by_name[wanted] if wanted is not None else nodes[0]
    size = node.shape[-1] if node.shape else None
    if isinstance(size, int) and size != joints:
        raise PolicyError(
            f"{bundle.card_path}: output {node.name!r} of the checkpoint has {size} numbers, "
            f"the robot {bundle.card.robot!r} has {joints} joints",
            fix="name the action with `output`, or the right robot with `robot`",
        )
    return str(node.name)


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
