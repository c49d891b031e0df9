"""How far the frame that a twin found for itself is from its original's."""

from dataclasses import dataclass

import numpy as np

from nw_scenes.folder import load_folder
from nw_twin.capture import read_capture
from nw_twin.place import moved_capture


@dataclass(frozen=True, kw_only=True)
class FrameFit:
    """A twin's frame against its original's.

    Attributes:
        T_twin_original: (4, 4) similarity that takes the original's points into the twin.
        registered: share of the photographs that were placed.
        centres: median distance of the placed cameras' centres after the fit, metres.
        gravity: angle between the twin's up and the original's, degrees.
        scale: of the twin, relative to the original's metre; 0.01 = one percent too large.
        floor: height of the original's spawn over the twin's z = 0, metres.
    """

    T_twin_original: np.ndarray
    registered: float
    centres: float
    gravity: float
    scale: float
    floor: float


def frame_fit(twin, cameras, spawn):
    """Return how a twin's frame lies to the original's, by where its cameras really were.

    Args:
        twin: folder of the scene; its splat is in the capture's frame.
        cameras: true ones by the names of their photographs, original frame.
        spawn: (3,) ground under the start, original frame.
    """
    capture = read_capture(twin / "build" / "capture")
    shots = moved_capture(load_folder(twin).T_world_splat, capture).shots
    found = np.array([shot.camera.T_world_camera[:3, 3] for shot in shots])
    true = np.array([cameras[shot.name].T_world_camera[:3, 3] for shot in shots])
    # A camera that is metres off would turn all: the fit is that of the nine tenths that agree.
    kept = np.ones(len(true), dtype=bool)
    for _ in range(5):
        T = similarity(true[kept], found[kept])
        scale = np.linalg.norm(T[:3, 0])
        off = np.linalg.norm(found - (true @ T[:3, :3].T + T[:3, 3]), axis=1) / scale
        kept = off <= np.quantile(off, 0.9)
    up = T[:3, 2] / scale
    return FrameFit(
        T_twin_original=T,
        registered=len(shots) / len(cameras),
        centres=float(np.median(off)),
        gravity=float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))),
        scale=float(scale - 1.0),
        floor=float((T[:3, :3] @ spawn + T[:3, 3])[2]),
    )


def similarity(source, target):
    """Return the similarity (4, 4) that takes points (N, 3) nearest to others (Umeyama 1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = float((S * sign).sum() / (a**2).sum())
    T = np.eye(4)
    T[:3, :3] = scale * (U * sign) @ Vt
    T[:3, 3] = target.mean(axis=0) - T[:3, :3] @ source.mean(axis=0)
    return T
