"""How near pictures of splats are to what they show: `python tests/bench/bench_truth.py`.

Built-in places are baked from paint and light, which `traced_truth` asks without any Gaussian. From
a Go1's camera along the way, 80x45 pixels: decibels against that by projection and samples, over
all views, in the lowest third of them, and how far skies are off where no edge is beside them.

changing      what of the error changes over a step of 2 cm: what flickers
turned        the same eye, turned by 12 degrees about two axes, and warped back, at 640x360: a
              right renderer repeats itself

Exits 1 when a target is missed. `--pictures FOLDER` writes views side by side instead: EWA and ray
above, ray with four samples and truth below.
"""

import argparse
import math
import sys
import zlib
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "splat"))

import numpy as np
from PIL import Image as PillowImage
from traced_truth import TracedPlace

from nw_sim.catalogue import get_scene
from nw_splat.camera import Camera, look_at
from nw_splat.render import CpuRenderer
from nw_splat.store import open_store

SCENES = (
    "hurdles/one_low_carpet", "hurdles/three_high_wood_hall", "gaps/three_20in_lobby",
    "gaps/two_14in_underpass", "gaps/two_16in_workshop", "gaps/three_crates_yard",
    "hurdles/two_beams_yard_night",
)  # fmt: skip
KINDS = {"ewa": ("ewa", 1), "ewa, 4": ("ewa", 4), "ray": ("ray", 1), "ray, 4": ("ray", 4)}
VIEWS = 6
SIZE = (80, 45)
FOVY = math.pi / 2
STEP = 0.02
"""m that a robot walks from picture to picture, at 50 a second."""
GAIN, SKY, TURNED = 4.0, 3.0, 40.0
"""Decibels that ray with four samples gains on EWA; of 255 that skies may be off; decibels."""


def views(scene):
    """Return poses (4, 4) of a Go1's camera along the way, each looking a little aside."""
    eyes = np.array(scene.splat.place.eyes)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(eyes, axis=0), axis=1))])
    rng = np.random.default_rng(zlib.crc32(scene.name.encode()))
    found = []
    for share in (np.arange(VIEWS) + 0.5) / VIEWS * 0.9:
        eye, ahead = (
            np.array([np.interp(at * along[-1], along, axis) for axis in eyes.T])
            for at in (share, min(share + 0.1, 1.0))
        )
        ahead[2] = eye[2]
        yaw = rng.uniform(-0.25, 0.25)
        way = ahead - eye
        turned = (
            math.cos(yaw) * way[0] - math.sin(yaw) * way[1],
            math.sin(yaw) * way[0] + math.cos(yaw) * way[1],
            -0.1 * np.linalg.norm(way),
        )
        found.append(look_at(eye, eye + np.array(turned)))
    return found


def camera(T, size=SIZE):
    return Camera.from_fovy(width=size[0], height=size[1], fovy=FOVY, T_world_camera=T)


def renderers(store):
    return {
        name: CpuRenderer(store, projection=projection, samples=samples)
        for name, (projection, samples) in KINDS.items()
    }


def shown(renderer, view):
    return np.clip(renderer.render(view).rgb, 0.0, 1.0).astype(np.float64)


class Errors:
    """Of one kind of picture: mean squares of each view, and the skies' mean errors."""

    def __init__(self):
        self.whole, self.lowest, self.changing, self.skies = [], [], [], []

    def add(self, pictures, truths):
        """Take in a view and the one after it."""
        (error, later), (truth, next_one) = (
            [picture - each.rgb for picture, each in zip(pictures, truths, strict=True)],
            truths,
        )
        low = truth.counts.copy()
        low[: 2 * SIZE[1] // 3] = False
        both = truth.counts & next_one.counts
        self.whole.append((error[truth.counts] ** 2).mean())
        self.lowest.append((error[low] ** 2).mean())
        self.changing.append(((later - error)[both] ** 2).mean())
        sky = _within(truth.sky)
        if sky.sum() > 20:
            self.skies.append(255.0 * error[sky].mean())


def against_truth(scenes, kinds_of=None):
    """Return `Errors` by kind."""
    errors = {}
    for name in scenes:
        scene = get_scene(name)
        traced = TracedPlace(scene.splat.place)
        kinds = (kinds_of or renderers)(open_store(scene.splat_store()))
        for T in views(scene):
            both = [camera(T), camera(_ahead(T))]
            truths = [traced.view(each) for each in both]
            for kind, renderer in kinds.items():
                pictures = [shown(renderer, each) for each in both]
                errors.setdefault(kind, Errors()).add(pictures, truths)
        line = "  ".join(f"{kind} {_db(each.whole[-VIEWS:]):5.2f}" for kind, each in errors.items())
        print(f"  {name:30} {line}", flush=True)
    return errors


def _within(mask):
    """Return the pixels of a mask whose neighbours are all in it: discs end a little over edges."""
    padded = np.pad(mask, 1, constant_values=True)
    height, width = mask.shape
    shifts = [(y, x) for y in range(3) for x in range(3)]
    return np.all([padded[y : y + height, x : x + width] for y, x in shifts], axis=0)


def _ahead(T):
    ahead = T.copy()
    ahead[:3, 3] += STEP * T[:3, 2]
    return ahead


def _db(errors):
    return float(np.mean([-10.0 * math.log10(max(each, 1e-12)) for each in errors]))


def _turn(axis, angle):
    c, s = math.cos(angle), math.sin(angle)
    T = np.eye(4)
    a, b = (i for i in range(3) if i != axis)
    T[a, a], T[a, b], T[b, a], T[b, b] = c, -s, s, c
    return T


def warp(image, view, other):
    """Return what `view` sees of a picture that `other` took from one eye, and where it does."""
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    ways = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], axis=-1)
    T = np.linalg.inv(other.T_world_camera) @ view.T_world_camera
    points = ways @ T[:3, :3].T
    u = other.fx * points[..., 0] / points[..., 2] + other.cx - 0.5
    v = other.fy * points[..., 1] / points[..., 2] + other.cy - 0.5
    seen = (points[..., 2] > 0) & (u >= 0) & (v >= 0)
    seen &= (u <= other.width - 1.001) & (v <= other.height - 1.001)
    u, v = np.where(seen, u, 0.0), np.where(seen, v, 0.0)
    i, j = v.astype(int), u.astype(int)
    a, b = (v - i)[..., None], (u - j)[..., None]
    top = image[i, j] * (1 - b) + image[i, j + 1] * b
    bottom = image[i + 1, j] * (1 - b) + image[i + 1, j + 1] * b
    return top * (1 - a) + bottom * a, seen


FINE = (640, 360)
"""In which turned pictures are compared: to warp a coarse one changes it more than they differ."""


def turned(renderer, T):
    """Return the squared errors of a view against those that are turned and warped back."""
    errors = []
    for axis in (0, 1):
        view, other = camera(T, FINE), camera(T @ _turn(axis, math.radians(12.0)), FINE)
        image = shown(renderer, view)
        back, seen = warp(shown(renderer, other), view, other)
        errors.append(((image - back)[seen] ** 2).mean())
    return errors


def write_pictures(folder):
    """Write a view of each scene: EWA, ray, ray with four samples, and truth side by side."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in SCENES:
        scene = get_scene(name)
        traced, kinds = TracedPlace(scene.splat.place), renderers(open_store(scene.splat_store()))
        for size, factor in ((SIZE, 6), ((480, 270), 1)):
            T = views(scene)[2]
            shots = [shown(kinds[kind], camera(T, size)) for kind in ("ewa", "ray", "ray, 4")]
            shots.append(traced.view(camera(T, size), side=4 if size == SIZE else 2).rgb)
            rows = [np.concatenate(shots[:2], axis=1), np.concatenate(shots[2:], axis=1)]
            whole = np.round(255 * np.concatenate(rows)).astype(np.uint8)
            large = PillowImage.fromarray(whole.repeat(factor, axis=0).repeat(factor, axis=1))
            large.save(folder / f"{name.replace('/', '-')}-{size[0]}.png")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two scenes")
    parser.add_argument("--pictures", type=Path, help="write views side by side into this folder")
    options = parser.parse_args()
    scenes = SCENES[:2] if options.quick else SCENES
    if options.pictures is not None:
        write_pictures(options.pictures)
        return 0
    print(f"decibels against traced truth, {VIEWS} views a scene, {SIZE[0]}x{SIZE[1]}")
    errors = against_truth(scenes)
    agree = {kind: [] for kind in KINDS}
    for name in scenes:
        scene = get_scene(name)
        for kind, renderer in renderers(open_store(scene.splat_store())).items():
            for T in views(scene)[::3]:
                agree[kind] += turned(renderer, T)
    print("           all   lowest third   changing   turned   skies off by at most, of 255")
    for kind, each in errors.items():
        sky = f"{np.abs(each.skies).max():5.1f}" if each.skies else "    -"
        row = (_db(values) for values in (each.whole, each.lowest, each.changing, agree[kind]))
        print(f"  {kind:7} " + "   ".join(f"{value:6.2f}" for value in row) + f"   {sky}")
    gain = _db(errors["ray, 4"].whole) - _db(errors["ewa"].whole)
    sky = max([abs(each) for each in errors["ray, 4"].skies], default=0.0)
    same = min(_db(agree[kind]) for kind in ("ray", "ray, 4"))
    print(
        f"gain {gain:.2f} dB (target {GAIN}), sky {sky:.1f} ({SKY}), turned {same:.1f} ({TURNED})"
    )
    return 0 if gain >= GAIN and sky <= SKY and same >= TURNED else 1


if __name__ == "__main__":
    sys.exit(main())
