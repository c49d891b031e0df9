"""The verbs of a twin's stages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from nw_eval.cli.verbs.twin.options import (
    AlignFlags,
    AllFlags,
    CalibrateFlags,
    PlaceFlags,
    ReconstructFlags,
    SplatFlags,
    settings_of,
)


def _say(line: str) -> None:
    print(line, flush=True)


@dataclass(frozen=True, kw_only=True)
class BuildTwin(AllFlags):
    """Photographs to a place, all stages one after another; what is done stays, and goes on.

    A folder of photographs, a video, or cameras that COLMAP, nerfstudio or Polycam know. Ends with
    what `scenes check` says of the place, and with 2 where that is an error; the place stays.
    """

    photographs: tyro.conf.Positional[Path]
    """The folder, or the video."""
    out: Path
    """The scene's folder; work in progress lies in its `build/`."""
    threads: int | None = None
    """That share the work; one for each core when absent. They change no result."""

    def __call__(self) -> int:
        from nw_eval.errors import SceneError
        from nw_eval.twin.building.build import Build

        build = Build(self.out, settings_of(self, self.threads), _say)
        return 0 if build.whole(self.photographs) else SceneError.exit_code


@dataclass(frozen=True, kw_only=True)
class Calibrate(CalibrateFlags):
    """Find where each photograph was taken from, and take the lens's distortion out."""

    photographs: tyro.conf.Positional[Path]
    """A folder of photographs, a video, or cameras of COLMAP, nerfstudio or Polycam."""
    out: Path
    """The scene's folder."""
    threads: int | None = None
    """That share the work; one for each core when absent. They change no result."""

    def __call__(self) -> int:
        from nw_eval.twin.building.build import Build

        Build(self.out, settings_of(self, self.threads), _say).calibrate(self.photographs)
        return 0


@dataclass(frozen=True, kw_only=True)
class Reconstruct(ReconstructFlags):
    """Measure the depth of every photograph, and make the mesh."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    threads: int | None = None
    """That share the work; one for each core when absent. They change no result."""

    def __call__(self) -> int:
        from nw_eval.twin.building.build import Build

        Build(self.scene, settings_of(self, self.threads), _say).reconstruct()
        return 0


@dataclass(frozen=True, kw_only=True)
class Align(AlignFlags):
    """Find which way is up, how large it is, and where the floor is."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""

    def __call__(self) -> int:
        from nw_eval.twin.building.build import Build

        Build(self.scene, settings_of(self, None), _say).align()
        return 0


@dataclass(frozen=True, kw_only=True)
class TrainSplat(SplatFlags):
    """Train the Gaussians; a training that was cut off goes on."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""
    threads: int | None = None
    """That share the work; one for each core when absent. They change no result."""

    def __call__(self) -> int:
        from nw_eval.twin.building.build import Build

        Build(self.scene, settings_of(self, self.threads), _say).splat()
        return 0


@dataclass(frozen=True, kw_only=True)
class PlaceScene(PlaceFlags):
    """Write the scene: mesh and splat in metres, and the trail that the place suggests."""

    scene: tyro.conf.Positional[Path]
    """The scene's folder."""

    def __call__(self) -> int:
        from nw_eval.twin.building.build import Build

        Build(self.scene, settings_of(self, None), _say).place()
        return 0
