"""Reading untrusted checkpoints.

Nothing here unpickles, imports or runs what a file contains. Archives, their pickled index and
every tensor's place and size are checked against `FileLimits` before memory is taken for them; what
fails is a `PolicyError` that says what the file is and how to export it.

    kind        the type of a file, by its first bytes and its members
    archive     members of a zip file: names, numbers, sizes, compression
    members     which of them a torch archive may have, and the archive written anew
    objects     the index of a torch file, read without pickle
    tensors     the tensors of a file of weights: torch, safetensors, pickled or msgpack arrays
    onnx_file   the tensors of an ONNX file
"""

from nw_policies.safety.archive import Archive, FileKind, FileLimits, file_kind, open_archive
from nw_policies.safety.onnx import check_onnx
from nw_policies.safety.tensors import (
    TensorFacts,
    read_tensors,
    tensor_facts,
    tensors_below,
)

__all__ = [
    "Archive",
    "FileKind",
    "FileLimits",
    "TensorFacts",
    "check_onnx",
    "file_kind",
    "open_archive",
    "read_tensors",
    "tensor_facts",
    "tensors_below",
]
