"""How far a training came."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Trained:
    """How far a training came.

    Attributes:
        program: that trained.
        folder: of the training.
        policy: the folder of its policy.
        step: steps that it has learnt from.
        is_done: whether that is all of its budget.
        is_interrupted: whether a signal ended it.
    """

    program: Literal["teacher", "student"]
    folder: Path
    policy: Path
    step: int
    is_done: bool
    is_interrupted: bool
