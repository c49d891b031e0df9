"""States between NumPy and torch: what is kept on disk is tensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import torch


def as_tensors(tree: Any) -> Any:
    """Return nested mappings with every array as a tensor of its own memory."""
    if isinstance(tree, Mapping):
        mapping = cast("Mapping[str, Any]", tree)
        return {key: as_tensors(value) for key, value in mapping.items()}
    return torch.from_numpy(tree.copy()) if isinstance(tree, np.ndarray) else tree


def as_arrays(tree: Any) -> Any:
    """Return nested mappings with every tensor as an array of its own memory."""
    if isinstance(tree, Mapping):
        mapping = cast("Mapping[str, Any]", tree)
        return {key: as_arrays(value) for key, value in mapping.items()}
    return tree.numpy().copy() if isinstance(tree, torch.Tensor) else tree
