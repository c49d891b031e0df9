"""The Gaussians of a trial's place, as Rerun draws them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nw_eval.errors import NwEvalError
from nw_eval.rollout.library import Library
from nw_eval.splat.files import read_splat
from nw_eval.splat.gaussians import SH0, sigmoid, unit_quats
from nw_eval.splat.transform import transformed
from nw_eval.viewing.recording.sdk import rerun_sdk

if TYPE_CHECKING:
    from nw_eval.rollout.replaying.logged import LoggedTrial
    from nw_eval.splat.gaussians import Gaussians


def place_splat(logged: LoggedTrial) -> tuple[Gaussians | None, str]:
    """Return the Gaussians of a logged trial's place in its world, or None and why there are none.

    The place is found as for a replay. A log shows the rest of its trial without it.
    """
    job = logged.job
    try:
        scene = Library().scene(job.scene, job.collision)
        if scene.digest != job.trial.scene_digest:
            return None, f"scene {scene.name} has changed since"
        if scene.splat is None:
            return None, f"scene {scene.name} has no splat"
        return transformed(read_splat(scene.splat_store()), scene.T_world_splat), ""
    except NwEvalError as error:
        return None, str(error)


def splat_archetype(gaussians: Gaussians) -> Any:
    """Return Gaussians with the colour that they have from all sides: without harmonics."""
    colours = 0.5 + SH0 * gaussians.sh[:, 0].astype(np.float64)
    rgba = np.concatenate([colours, sigmoid(gaussians.opacity_logits)[:, np.newaxis]], axis=1)
    return rerun_sdk().GaussianSplats3D(
        centers=gaussians.means,
        scales=np.exp(gaussians.log_scales),
        quaternions=unit_quats(gaussians.quats)[:, [1, 2, 3, 0]].astype(np.float32),
        colors=np.rint(np.clip(rgba, 0.0, 1.0) * 255.0).astype(np.uint8),
    )
