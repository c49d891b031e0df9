"""A build folder to train from."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from small_capture import PLACE, photos
from twin_parts import captured, placed

from nw_twin.capture import write_capture


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """A build folder after reconstruction: eight shots, their depths, floor and balls as mesh."""
    folder = tmp_path_factory.mktemp("build")
    (folder / "capture" / "pictures").mkdir(parents=True)
    (folder / "mesh" / "depth").mkdir(parents=True)
    shots = []
    for number, photo in enumerate(photos(8, depth=True)):
        name = f"{number:02d}.png"
        Image.fromarray(photo.rgb).save(folder / "capture" / "pictures" / name)
        near = photo.inverse_depth > 0
        depth = np.divide(1.0, photo.inverse_depth, out=np.zeros(near.shape, "f4"), where=near)
        path = folder / "mesh" / "depth" / f"{name}.npz"
        np.savez(path, depth=depth, confidence=np.ones_like(depth))
        shots.append(placed(name, photo.camera, range(5), file=f"pictures/{name}"))
    capture = captured(shots, PLACE.means[::10].astype(np.float64))
    write_capture(capture, folder / "capture")
    parts = [trimesh.creation.box((8.3, 8.3, 0.02))]
    for x, y in ((1.2, 0.3), (-0.8, 1.0), (0.0, -1.3)):
        ball = trimesh.creation.icosphere(2, 0.65)
        parts.append(ball.apply_translation((x, y, 0.6)))
    mesh = trimesh.util.concatenate(parts)
    mesh.visual.vertex_colors = np.tile([120, 110, 90, 255], (len(mesh.vertices), 1))
    mesh.export(folder / "mesh" / "mesh.ply")
    return folder
