"""`nw-eval train export`: a checkpoint of a training as a policy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write the policy of a teacher's checkpoint: its card, and its weights as ONNX."""

    folder: tyro.conf.Positional[Path]
    """Of the training."""
    out: tyro.conf.Positional[Path]
    """The policy's folder, such as policies/mine."""
    checkpoint: int | None = None
    """Number of a kept checkpoint; the newest state when absent."""

    def __call__(self) -> int:
        from nw_eval.clean import clean
        from nw_eval.learn.teacher.policy import export_checkpoint

        print(clean(f"{export_checkpoint(self.folder, self.checkpoint, self.out)} -> {self.out}"))
        return 0
