"""Where networks learn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.errors import PrerequisiteError

if TYPE_CHECKING:
    import torch

    from nw_eval.learn.program.config import DeviceName


def device_of(name: DeviceName) -> torch.device:
    """Return the device of a name; `auto` is CUDA where there is one.

    Raises:
        PrerequisiteError: it is `cuda`, and there is none.
    """
    import torch

    has_cuda = torch.cuda.is_available()
    if name == "cuda" and not has_cuda:
        raise PrerequisiteError("device: cuda, and there is no CUDA here", fix="set device: auto")
    return torch.device("cuda" if has_cuda and name != "cpu" else "cpu")


def one_thread() -> None:
    """Let torch compute in one thread: sums come in one order, and processes share the cores."""
    import torch

    torch.set_num_threads(1)
