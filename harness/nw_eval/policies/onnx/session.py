"""How every ONNX graph is opened here: on one thread, on the CPU, without a word to anybody."""

from __future__ import annotations

import os
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import onnxruntime as ort


@cache
def _runtime() -> ModuleType:
    """Return onnxruntime with its telemetry off.

    Importing it is enough for a device id and a database of events to be written into the user's
    cache folder, so the variable is set before; the call is for versions that do not read it.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    return onnxruntime


def open_session(model: bytes, *, optimise: bool = True) -> ort.InferenceSession:
    """Return a session that runs a graph; more threads would change the last bits of an action.

    Args:
        model: the bytes of an ONNX file; a stranger's have passed `check_onnx`.
        optimise: whether constant parts are computed and nodes fused, which actions to the last
            bit depend on; without, a graph can be described but nothing of it is computed.

    Raises:
        Exception: whatever onnxruntime has to say; its exceptions share no public base.
    """
    runtime = _runtime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = runtime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # What is wrong is raised; a warning would only be noise.
    if not optimise:
        options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
