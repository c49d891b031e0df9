"""Photographs of a room that is known, by a lens that bends them."""

import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import synthetic_room
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent))

RADIAL = -0.08


@dataclass
class Photographed:
    """A folder of photographs and what is true of them."""

    folder: Path
    cameras: dict
    patches: list


@pytest.fixture(scope="session")
def photographed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    patches = synthetic_room.room()
    cameras = {f"IMG_{i:04d}.png": c for i, c in enumerate(synthetic_room.cameras())}
    for name, camera in cameras.items():
        picture = synthetic_room.render(patches, camera, radial=RADIAL)
        Image.fromarray(picture).save(folder / name)
    return Photographed(folder, cameras, patches)
