"""A set of real photographs: built as anybody would, measured, walked in.

    python tests/twin/loop/real_sets.py ../shared/assets/photographs/street --out street \
        --camera-height 1.6

Nothing is done by hand but what gives the scale. Prints a line for each figure and leaves them in
`--out` as `figures.json`. Options that are not of this file are those of `nw-eval twin build`.
"""

import argparse
import json
import resource
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[1] / "reconstruct")]

from room_figures import stacked

from nw_eval import api, cli
from nw_twin.align.alignment import read_alignment
from nw_twin.align.planes import find_planes
from nw_twin.capture import read_capture
from nw_twin.place import moved_capture
from nw_twin.reconstruct.depth import read_depth
from nw_twin.reconstruct.surface import read_colour_mesh

_WITHIN = 12.0
"""Ground is judged up to this distance from the camera, metres."""
_ASIDE = 2.0
"""And up to this one beside the line along which the cameras went."""
_OFF = 0.3
"""A depth is of the ground if it lies within this of the plane of calibration's points, metres."""
_NEAR = 8.0
"""The residual to a plane is taken up to this distance, metres."""


@dataclass(frozen=True, kw_only=True)
class RealSet:
    """What came of a set of photographs.

    Attributes:
        placed: photographs that calibration placed, of `photographs`.
        up: to how many degrees up is known.
        scale: metres in one unit of the calibration.
        ground: share of the pixels that look at ground within 12 m of the camera and 2 m of the
            cameras' way, whose depth lies within .3 m of the plane of calibration's points.
        residual: of the depths within 8 m, the median distance from the photograph's own plane, m;
            the median photograph and the worst.
        sheets: share of vertical lines through the mesh that meet two sheets which look up.
        roughness: median along the trail, off the plane of .25 m, m.
        depths: median distance of mesh and depth maps along the trail, m.
        psnr: of photographs that training did not see, or had not seen yet, dB.
        ssim: of these.
        length: of the trail, m.
        trials: of `go1-parkour`; `completed` of them reached all waypoints.
        exit: of `twin build`.
        seconds: of the build, wall clock.
        cpu: of the build, seconds of all processes.
        peak: the most memory that a process of the build held, GB.
    """

    placed: int
    photographs: int
    up: float
    scale: float
    ground: float
    residual: tuple[float, float]
    sheets: float
    roughness: float
    depths: float
    psnr: float
    ssim: float
    length: float
    trials: int
    completed: int
    exit: int
    seconds: float
    cpu: float
    peak: float


def build(photographs, out, options=()):
    """Run `nw-eval twin build`; return its exit code, wall seconds, and seconds of processors."""
    before, spent, code = time.monotonic(), _spent(), 0
    try:
        cli.main(["twin", "build", str(photographs), "--out", str(out), *options])
    except SystemExit as end:
        code = int(end.code or 0)
    return code, time.monotonic() - before, _spent() - spent


def _spent():
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(use.ru_utime + use.ru_stime for use in map(resource.getrusage, kinds))


def ground_of(out):
    """Return the share of ground with its depth, and each photograph's median residual, m."""
    T = read_alignment(out / "build" / "align.json").T_metric_capture
    capture = moved_capture(T, read_capture(out / "build" / "capture"))
    scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
    centres = capture.centres
    asked = right = 0
    residuals = []
    for shot in capture.shots:
        centre = shot.camera.T_world_camera[:3, 3]
        plane = _ground_below(capture.points, centre)
        if plane is None:
            continue
        depth, _ = read_depth(out / "build" / "mesh" / "depth", shot.name)
        ways = _ways(shot.camera, depth.shape)
        down = ways @ plane.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (plane.offset - centre @ plane.normal) / down  # Times the depth 1.
        length = np.linalg.norm(ways, axis=-1)
        meets = (far > 0) & (far * length < _WITHIN)
        meets &= _beside(centre + np.where(meets, far, 0.0)[..., None] * ways, centres) < _ASIDE
        metres = depth * scale
        points = centre + metres[..., None] * ways
        off = np.abs(points @ plane.normal - plane.offset)
        known = meets & (metres > 0) & (off < _OFF)
        asked, right = asked + int(meets.sum()), right + int(known.sum())
        close = known & (metres * length < _NEAR)
        if close.sum() > 200:
            residuals.append(_residual(points[close]))
    return right / max(asked, 1), residuals


def _ways(camera, shape):
    """Return the way (H, W, 3) from the camera to depth 1 of each pixel, in the world."""
    h, w = shape
    x, y = np.meshgrid(
        ((np.arange(w) + 0.5) * camera.width / w - camera.cx) / camera.fx,
        ((np.arange(h) + 0.5) * camera.height / h - camera.cy) / camera.fy,
    )
    return np.stack([x, y, np.ones_like(x)], axis=-1) @ camera.T_world_camera[:3, :3].T


def _ground_below(points, centre):
    """Return the level plane on which most of calibration's points below a camera lie."""
    away = points - centre
    below = (np.linalg.norm(away[:, :2], axis=1) < _WITHIN) & (away[:, 2] < -0.15)
    planes = find_planes(points[below & (away[:, 2] > -3.0)], 0.06, np.random.default_rng(0))
    level = [plane for plane in planes if abs(plane.normal[2]) > np.cos(np.radians(15.0))]
    return max(level, key=lambda plane: plane.share, default=None)


def _beside(points, centres):
    """Return how far points (H, W, 3) are from the line through cameras, seen from above, m."""
    line = centres[:, :2] - centres[:, :2].mean(axis=0)
    across = np.linalg.svd(line, full_matrices=False)[2][1]
    return np.abs((points[..., :2] - centres[:, :2].mean(axis=0)) @ across)


def _residual(points):
    """Return the median distance of points from the plane on which most of them lie, m."""
    some = points[:: max(1, len(points) // 20_000)]
    plane = find_planes(some, 0.1, np.random.default_rng(0), most=1)[0]
    return float(np.median(np.abs(plane.distances(some))))


def sheets_of(out):
    """Return the share of vertical lines through the mesh that meet two faces which look up."""
    upwards = read_alignment(out / "build" / "align.json").T_metric_capture[2, :3]
    report = json.loads((out / "build" / "mesh" / "report.json").read_text())
    mesh = read_colour_mesh(out / "build" / "mesh" / "mesh.ply")
    return float(stacked(mesh, upwards / np.linalg.norm(upwards), report["voxel"]))


def measure(photographs, out, options=(), trials=10):
    """Build a set, and return what came of it."""
    code, seconds, cpu = build(photographs, out, options)
    placed = json.loads((out / "build" / "capture" / "report.json").read_text())
    splat = json.loads((out / "build" / "splat" / "report.json").read_text())
    trail = json.loads((out / "build" / "trail.json").read_text())
    aligned = read_alignment(out / "build" / "align.json")
    ground, residuals = ground_of(out)
    with suppress(SystemExit):
        cli.main(
            ["run", str(out / "suite.yaml"), "--trials", str(trials), "--out", str(out / "run")]
        )
    rows = api.read_rows(out / "run")
    stations = trail["stations"]
    found = RealSet(
        placed=placed["placed"],
        photographs=placed["photographs"],
        up=aligned.up_uncertain,
        scale=aligned.scale,
        ground=ground,
        residual=(float(np.median(residuals)), max(residuals)) if residuals else (0.0, 0.0),
        sheets=sheets_of(out),
        roughness=float(np.median([one["roughness"] for one in stations])),
        depths=float(np.median([one["depths_median"] for one in stations if one["photographs"]])),
        psnr=splat["psnr"],
        ssim=splat["ssim"],
        length=trail["length"],
        trials=len(rows),
        completed=int((rows["success"] == 1.0).sum()),
        exit=code,
        seconds=seconds,
        cpu=cpu,
        peak=max(
            resource.getrusage(kind).ru_maxrss
            for kind in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )
        / 1e6,
    )
    (out / "figures.json").write_text(json.dumps(asdict(found), indent=1))
    return found


def main():
    """Build, measure, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder for all that comes of it")
    parser.add_argument("--trials", type=int, default=10)
    known, options = parser.parse_known_args()
    found = measure(known.photographs, known.out, options, known.trials)
    for name, value in asdict(found).items():
        print(f"{name:12} {value}")


if __name__ == "__main__":
    main()
