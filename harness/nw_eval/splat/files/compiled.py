"""nw-eval's own compiled splats (`.nwsplat`), which lie in the cache: read back as Gaussians.

The format is private and changes with versions. It has covariances in place of scales and
rotations, and lacks what no camera sees; what is read renders as the file itself does.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.layout import unpack
from nw_eval.splat.store import open_store
from nw_eval.splat.transform import quaternions

_THINNEST = 1e-8  # of the largest variance, which is what float32 knows.
_OPAQUE = 1.0 - 2.0**-24


def read_compiled(path: Path) -> Gaussians:
    """Read a compiled splat.

    Raises:
        SceneError: it is damaged, or another version wrote it.
    """
    store = open_store(path)
    held = unpack(store.layout)
    # A seal keeps damage out, and no stranger's hand.
    whole = np.isfinite(held.covariances).all(axis=(1, 2)) & np.isfinite(held.opacities)
    variances, axes = np.linalg.eigh(held.covariances[whole].astype(np.float64))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1.0  # A reflection is no rotation.
    variances = np.maximum(variances, np.maximum(variances[:, 2:] * _THINNEST, 1e-38))
    opacities = np.clip(held.opacities[whole].astype(np.float64), 1e-38, _OPAQUE)
    return Gaussians(
        means=held.means[whole],
        log_scales=(0.5 * np.log(variances)).astype(np.float32),
        quats=quaternions(axes).astype(np.float32),
        opacity_logits=np.log(opacities / (1.0 - opacities)).astype(np.float32),
        sh=held.sh[whole],
        rasterize_mode=store.rasterize_mode,
    )
