"""The compiled half of training.

project.py       Gaussians to the renderer's records
project_back.py  gradient of records with respect to Gaussians
blend.py         the records that touch one window, and the gradient of their blend
rows.py          the optimiser's step, nearest neighbours, noise; similarity of pictures

Kernels are built of the renderer's vector layer, so that the name of their kept code carries a hash
of its sources as well as of these.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import nw_splat.kernels as renderer
from nw_base import machine_code
from nw_base.machine_code import hash_sources, kept_code

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile like the renderer's kernels; see `nw_base.machine_code.kernel`."""
    compiled: Any = machine_code.kernel(function)
    kept = kept_code(function, _version())
    if kept is not None:
        compiled._cache = kept  # noqa: SLF001 - Numba has no public way to bring one's own cache.
    return compiled


@cache
def _version() -> str:
    folders = (Path(__file__).parent, Path(renderer.__path__[0]))
    return "".join(hash_sources(folder) for folder in folders)
