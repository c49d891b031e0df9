"""How every ONNX graph is run here: on one thread, on the CPU, without a word."""

from __future__ import annotations

import onnxruntime as ort


def open_session(model: bytes) -> ort.InferenceSession:
    """Return a session that runs a graph; more threads would change the last bits of an action.

    Args:
        model: the bytes of an ONNX file.

    Raises:
        Exception: whatever onnxruntime has to say; its exceptions share no public base.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # What is wrong is raised; a warning would only be noise.
    return ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
