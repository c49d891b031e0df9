"""`nw-eval twin`: which stage, or all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from nw_eval.cli.verbs.twin.ablation import AblateSplat
from nw_eval.cli.verbs.twin.label import LabelScene
from nw_eval.cli.verbs.twin.stages import (
    Align,
    BuildTwin,
    Calibrate,
    PlaceScene,
    Reconstruct,
    TrainSplat,
)


@dataclass(frozen=True, kw_only=True)
class Twin:
    """Turn photographs into a place that suites can name."""

    action: (
        Annotated[BuildTwin, tyro.conf.subcommand("build")]
        | Annotated[Calibrate, tyro.conf.subcommand("calibrate")]
        | Annotated[Reconstruct, tyro.conf.subcommand("reconstruct")]
        | Annotated[Align, tyro.conf.subcommand("align")]
        | Annotated[TrainSplat, tyro.conf.subcommand("splat")]
        | Annotated[PlaceScene, tyro.conf.subcommand("place")]
        | Annotated[AblateSplat, tyro.conf.subcommand("ablate")]
        | Annotated[LabelScene, tyro.conf.subcommand("label")]
    )

    def __call__(self) -> int:
        return self.action()
