"""A build folder to train from."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from small_capture import PLACE, photos

from nw_twin.capture import Capture, PlacedShot, write_capture


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
        depth = np.divide(
            1.0,
            photo.inverse_depth,
            out=np.zeros_like(photo.rgb[..., 0], np.float32),
            where=photo.inverse_depth > 0,
        )
        np.savez(
            folder / "mesh" / "depth" / f"{name}.npz",
            depth=depth,
            confidence=np.ones_like(depth),
        )
        shots.append(
            PlacedShot(
                name=name,
                file=f"pictures/{name}",
                camera=photo.camera,
                seen=np.arange(5, dtype=np.int32),
            )
        )
    capture = Capture(
        shots=tuple(shots),
        points=PLACE.means[::10].astype(np.float64),
        colours=np.full((len(PLACE.means[::10]), 3), 128, np.uint8),
        errors=np.zeros(len(PLACE.means[::10]), np.float32),
    )
    write_capture(capture, folder / "capture")
    parts = [trimesh.creation.box((8.3, 8.3, 0.02))]
    for x, y in ((1.2, 0.3), (-0.8, 1.0), (0.0, -1.3)):
        ball = trimesh.creation.icosphere(2, 0.65)
        parts.append(ball.apply_translation((x, y, 0.6)))
    mesh = trimesh.util.concatenate(parts)
    mesh.visual.vertex_colors = np.tile([120, 110, 90, 255], (len(mesh.vertices), 1))
    mesh.export(folder / "mesh" / "mesh.ply")
    return folder
