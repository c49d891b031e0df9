"""Original, twin and mesh side by side, as a robot's camera sees them."""

import numpy as np
from PIL import Image


def write_sheet(path, views):
    """Write a picture with a row for each view: original, the twin's splat, its mesh.

    Args:
        path: JPEG or PNG.
        views: `Look`s.
    """
    rows = [np.hstack([view.original, view.splat, view.mesh]) for view in views]
    sheet = np.round(255.0 * np.clip(np.vstack(rows), 0.0, 1.0)).astype(np.uint8)
    Image.fromarray(sheet).save(path, quality=88)
