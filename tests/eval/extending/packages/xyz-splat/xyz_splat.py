import numpy as np

from nw_eval import Gaussians, SceneError, SplatFormat


def read(path):
    try:
        points = np.loadtxt(path, delimiter=" ", ndmin=2, dtype=np.float32)
    except ValueError as error:
        raise SceneError(f"{path}: {error}", fix="write x y z in each line") from error
    if points.shape[1] != 3:
        raise SceneError(f"{path}: {points.shape[1]} numbers in a line", fix="write x y z")
    n = len(points)
    return Gaussians(
        means=points,
        log_scales=np.full((n, 3), np.log(0.02)),  # 2 cm
        quats=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        opacity_logits=np.full(n, 5.0),
        sh=np.zeros((n, 1, 3)),  # grey
    )


def write(path, gaussians):
    np.savetxt(path, gaussians.means, fmt="%.6g")


FORMAT = SplatFormat(name="xyz", description="points in text", read=read, write=write)
