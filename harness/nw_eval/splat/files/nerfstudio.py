"""A splatfacto export of nerfstudio: splat.ply in the trainer's frame, and the way back from it.

dataparser_transforms.json holds {"transform": 3x4 [R | t], "scale": s} with
x_trainer = s (R x_capture + t). The exporter leaves splat.ply in the trainer's frame; reading the
folder brings it back to the frame of the capture (COLMAP's or the device's).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.files.inside import regular
from nw_eval.files.ply import Ply
from nw_eval.splat.files.threedgs_ply import RestOrder, read_threedgs_ply
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.transform import transformed

_BYTES = 1_000_000
_REACH = 1e6  # of every number, either way
_TRANSFORMS = "dataparser_transforms.json"
_FIX = "give the folder that `ns-export gaussian-splat` wrote, with that file beside splat.ply"


def read_nerfstudio(folder: Path, *, rest_order: RestOrder = "detect") -> Gaussians:
    """Read a splatfacto export in the frame of the capture.

    Raises:
        SceneError: when a part is missing or the transform is no similarity.
    """
    clouds = sorted(folder.glob("*.ply"))
    cloud = folder / "splat.ply" if folder / "splat.ply" in clouds else None
    if cloud is None and len(clouds) == 1:
        cloud = clouds[0]
    if cloud is None:
        raise SceneError(f"{folder}: {len(clouds)} .ply files, none is splat.ply", fix=_FIX)
    T_trainer_capture = _read_transform(folder / _TRANSFORMS)
    gaussians = read_threedgs_ply(Ply.open(regular(cloud)), rest_order=rest_order)
    return transformed(gaussians, np.linalg.inv(T_trainer_capture).astype(np.float64))


def _read_transform(path: Path) -> NDArray[np.float64]:
    """(4, 4) of a similarity from capture to trainer."""
    try:
        if regular(path).stat().st_size > _BYTES:
            raise SceneError(f"{path}: too large", fix="it holds one 3 x 4 matrix and a scale")
        content = json.loads(path.read_text(encoding="utf-8"))
        matrix = np.array(content["transform"], dtype=np.float64)
        scale = float(content["scale"])
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", fix=_FIX) from error
    except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise SceneError(f"{path}: no transform and scale in it ({error!r})", fix=_FIX) from error
    if matrix.shape not in ((3, 4), (4, 4)) or not (np.abs(matrix) <= _REACH).all():
        raise SceneError(f"{path}: transform has shape {matrix.shape}", fix="it must be 3x4")
    if not 1 / _REACH <= scale <= _REACH:
        raise SceneError(f"{path}: scale is {scale}", fix="it must be positive")
    T = np.eye(4)
    T[:3] = scale * matrix[:3]
    if abs(np.linalg.det(T)) < _REACH**-3:
        raise SceneError(f"{path}: transform flattens", fix="it must be a rotation and a shift")
    return T
