"""A capture and its depths in, Gaussians out: the stage of a build that makes the splat.

Shots become photographs to train on, reduced, with depth where it is known. Gaussians begin on the
mesh with its colours, or at the points that calibration found; where photographs look past both,
above the horizon, is the sky. The training is resumable.

Photographs are held out to compare with. Of few photographs each is needed: once the figures are
taken, the training goes on for a fifth of its steps with all of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from time import monotonic
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_base.errors import SceneError, StoreError, UsageError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import inside
from nw_base.files.pictures import open_picture
from nw_base.plural import plural
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.rays import RayScene
from nw_splat.files import write_splat
from nw_splat.gaussians import Gaussians, concatenate
from nw_twin.align.gravity import find_gravity
from nw_twin.capture import Capture, PlacedShot, read_capture, read_picture
from nw_twin.gaussians.config import Strategy, TrainConfig
from nw_twin.gaussians.images import Photo
from nw_twin.gaussians.initial import distances, gaussians_at, with_sky
from nw_twin.gaussians.kernels.rows import NEIGHBOURS
from nw_twin.gaussians.loss import ViewFigures, view_figures
from nw_twin.gaussians.rasteriser import Rasteriser
from nw_twin.gaussians.trainer import Trainer, resume_training, save_training
from nw_twin.reconstruct.depth import read_depth

SPLAT, REPORT = "splat.ply", "report.json"
_STATE, _LAST_STATE = "training.state", "last.state"
_WIDEST = 1.2
"""Of a Gaussian near the cameras, as a share of what they have between them on the mesh. Large ones
show plain ground as well to photographs, but a robot is nearer, and sees them stand out of it."""
_SURFACE = 0.7
"""Opacity of Gaussians that begin on a mesh: it is where something was seen."""
_KEEP_EVERY, _SAY_EVERY = 60.0, 15.0
"""Seconds between two states on disk, and between two lines; the result depends on neither."""

_SKY, _SKY_SHARE = 4000, 0.05
"""Gaussians that the sky begins with, and their share of all that there may be, at most."""
_FEWEST = 4
"""Photographs of which one is held out."""
_LAST = 5
"""One step with the photographs that were held out follows so many without them."""

COARSE = 0.5
"""Share of the steps, the first ones, with pictures of half their size: they take half as long."""
_EACH, _STEPS = 100, (1500, 6000)
"""Steps for each photograph, and the fewest and most of all. With more, a splat of few photographs
fits them and loses on those that were held out: a street of 14 has 20.7 dB after 2,000 steps and
19.6 after 6,000, a table of 12 20.5 and 18.9."""
_WHOLE = 2.0
"""Times as long as a step with a picture of half the size one with a whole picture takes."""
_LEAST_SIDE = 32
"""Pixels of a picture of half the size: structural similarity looks at squares of 11."""

_T = TypeVar("_T", bound=np.generic)
_DAMAGE = (OSError, ValueError, LookupError, TypeError, EOFError, SyntaxError)

Rows = NDArray[np.float64]

_NEAREST = 0.1
"""Share of a mesh that is nearest to photographs, and counts as equally near."""
_CLEAR = 0.05
"""Distance from a surface, as a share of that to the nearest camera, at which a point is off it."""
_FIX = "reconstruct again: `nw-eval twin reconstruct`"


@dataclass(frozen=True, kw_only=True)
class AppearanceOptions:
    """Options of the splat.

    Attributes:
        iterations: steps of training; None = `_EACH` for each photograph, within `_STEPS`.
        longest: largest side of the pictures that are learnt from, pixels; larger ones are reduced.
        most: Gaussians that there may be.
        begin: points on the mesh to begin with, three quarters of `most` at most.
        strategy: how Gaussians come and go.
        mesh: whether they begin on the mesh; else at the points that calibration found.
        depth: whether the depths of the reconstruction count.
        held_out_every: every so many-th picture is kept from training, to compare with; 0 = none.
            Of fewer than twice as many, about that share is, until the figures are taken.
        held_out: a glob of names that are kept from training instead; empty = none are named.
        seed: of all that is drawn.
    """

    iterations: int | None = None
    longest: int = 480
    most: int = 200_000
    begin: int = 100_000
    strategy: Strategy = "default"
    mesh: bool = True
    depth: bool = True
    held_out_every: int = 8
    held_out: str = ""
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers; UsageError says what cannot be."""
        least = {"iterations": 1, "longest": 32, "most": 100, "begin": 100, "seed": 0}
        for name, low in least.items():
            if (value := getattr(self, name)) is not None and value < low:
                raise UsageError(f"{name} is {value}", fix=f"give {low} or more")
        if self.held_out_every < 0 or self.held_out_every == 1:
            raise UsageError(
                f"held_out_every is {self.held_out_every}: nothing would be left to learn from",
                fix="give 2 or more, or 0 for none",
            )

    def steps(self, photographs: int) -> int:
        """Return the steps of training with so many photographs."""
        if self.iterations is not None:
            return self.iterations
        return min(max(_EACH * photographs, _STEPS[0]), _STEPS[1])


@dataclass(frozen=True, kw_only=True)
class AppearanceReport:
    """Results of the training.

    Attributes:
        gaussians: how many there are.
        photos: learnt from.
        views: figures of the photographs that were held out.
        floaters: Gaussians that were removed because they hung in the air near cameras.
        sky: share of the pixels that show the sky.
        learnt_after: whether the training went on with the photographs that were held out, after
            their figures were taken.
    """

    gaussians: int
    photos: int
    views: tuple[ViewFigures, ...]
    floaters: int = 0
    sky: float = 0.0
    learnt_after: bool = False

    @property
    def psnr(self) -> float | None:
        """Mean over the views, exposures allowed for, dB; None without views."""
        return float(np.mean([v.psnr_corrected for v in self.views])) if self.views else None

    @property
    def ssim(self) -> float | None:
        """Mean over the views; None without views."""
        return float(np.mean([v.ssim for v in self.views])) if self.views else None


def train_splat(
    capture_folder: Path,
    mesh_folder: Path | None,
    out: Path,
    options: AppearanceOptions,
    say: Callable[[str], None],
    *,
    threads: int = 2,
) -> AppearanceReport:
    """Train Gaussians in the capture's frame; a training that was cut off goes on.

    Args:
        capture_folder: what calibration left.
        mesh_folder: what reconstruction left: `mesh.ply` and `depth/`; None = there was none.
        out: where splat.ply, report.json and the state of the training go.
        options: the options given.
        say: takes a line for people.
        threads: that share each step; the result does not depend on them.

    Raises:
        SceneError: something of the capture or the mesh is missing or damaged.
        UsageError: no photograph is held out by that name, or all of them are.
        StoreError: nothing can be written.
    """
    capture = read_capture(capture_folder)
    check_held_out(options.held_out, [shot.name for shot in capture.shots])
    depths = None if mesh_folder is None or not options.depth else mesh_folder / "depth"
    photos = photos_of(capture, capture_folder, depths, longest=options.longest)
    sky, share, widest = None, 0.0, 0.0
    if options.mesh and mesh_folder is not None:
        photos, sky, share = _with_sky(capture, mesh_folder / "mesh.ply", photos, options, say)
        start, widest = _on_mesh(capture, mesh_folder / "mesh.ply", options, sky)
    else:
        start = gaussians_at(*points_of(capture))
    learnt, held = split_photos(photos, options)
    steps = options.steps(len(photos))
    config = TrainConfig.short(steps, seed=options.seed, strategy=options.strategy)
    sides = [min(photo.rgb.shape[:2]) for photo in learnt]
    coarse = COARSE if min(sides, default=0) >= 2 * _LEAST_SIDE else 0.0
    config = replace(config, most=options.most, widest=widest, coarse=coarse)
    trainer = _trained(out / _STATE, learnt, start, config, threads, say)
    rasteriser = Rasteriser(
        preset=config.preset,
        antialiased=config.antialiased,
        projection=config.projection,
        background=config.background,
    )
    views = tuple(view_figures(trainer.gaussians, photo, rasteriser) for photo in held)
    removed = trainer.floaters
    is_repeated = len(held) > 0 and not options.held_out and _are_few(photos, options)
    if is_repeated:
        everything = (*learnt, *held)
        trainer = _trained(out / _LAST_STATE, everything, trainer, _last(config), threads, say)
        removed += trainer.floaters
    report = AppearanceReport(
        gaussians=len(trainer.gaussians),
        photos=len(trainer.photos),
        views=views,
        floaters=removed,
        sky=share,
        learnt_after=is_repeated,
    )
    with atomic_path(out / SPLAT) as temporary:
        write_splat(temporary, trainer.marked())
    with atomic_path(out / REPORT) as temporary:
        facts = {"options": asdict(options), **asdict(report)}
        figures = {"psnr": report.psnr, "ssim": report.ssim}
        temporary.write_text(json.dumps(facts | figures, indent=1), encoding="utf-8")
    seen = ""
    if views:
        kept = (
            "kept from it"
            if not is_repeated
            else f"before it learnt from {'it' if len(views) == 1 else 'them'}"
        )
        seen = f", {report.psnr:.1f} dB on {plural(len(views), 'photograph')} {kept}"
    if removed:
        say(f"splat: {removed:,} Gaussians hung in the air near cameras and were removed")
    say(f"splat: {report.gaussians:,} Gaussians of {report.photos} photographs{seen}")
    return report


def _with_sky(
    capture: Capture,
    mesh: Path,
    photos: tuple[Photo, ...],
    options: AppearanceOptions,
    say: Callable[[str], None],
) -> tuple[tuple[Photo, ...], Gaussians | None, float]:
    """Return what `with_sky` does, and the share of the pixels that are sky."""
    try:
        up = find_gravity(capture, None, (), np.random.default_rng(options.seed), lambda _: None).up
    except SceneError:  # Too few points to tell up by.
        return photos, None, 0.0
    vertices, faces, *_ = _read_mesh(mesh)
    kinds = np.full(len(faces), FACE_KINDS.index("ground"), np.uint8)
    rays = RayScene(TriangleMesh(vertices=vertices, faces=faces.astype(np.int32), kinds=kinds))
    free: list[NDArray[np.bool_]] = []
    for photo in photos:
        ways = photo.rays().reshape(-1, 3)
        eye = photo.camera.T_world_camera[:3, 3]
        _, face = rays.cast(np.broadcast_to(eye, ways.shape), ways)
        past = (face < 0).reshape(photo.rgb.shape[:2])
        free.append(past if photo.inverse_depth is None else past & (photo.inverse_depth == 0.0))
    most = min(_SKY, int(options.most * _SKY_SHARE))
    photos, sky, share = with_sky(photos, free, up, most=most)
    if sky is not None:
        say(f"splat: {share:.0%} of the photographs is sky, {len(sky):,} Gaussians to begin with")
    return photos, sky, share


def _last(config: TrainConfig) -> TrainConfig:
    """Return the config of the steps with all photographs, which goes on where another ended."""
    rates = config.rates
    return replace(
        config,
        iterations=max(1, config.iterations // _LAST),
        strategy="fixed",
        sh_every=1,
        coarse=0.0,
        depth_weight=config.depth_weight_last,
        rates=replace(rates, means=rates.means_last),
    )


def _trained(
    state: Path,
    photos: tuple[Photo, ...],
    begin: Gaussians | Trainer,
    config: TrainConfig,
    threads: int,
    say: Callable[[str], None],
) -> Trainer:
    """Return a training with all its steps done, from its beginning or as it was left.

    One that goes on from another takes over the exposures of the photographs that both have.
    """
    trainer, start = None, begin.gaussians if isinstance(begin, Trainer) else begin
    if state.is_file():
        try:
            trainer = resume_training(state, photos, start, config, threads=threads)
        except StoreError as error:
            say(f"splat: {error}: from the beginning")
        else:
            say(f"splat: resumes after step {trainer.iteration:,} of {config.iterations:,}")
    if trainer is None:
        say(f"splat: {len(photos)} photographs, begins with {len(start):,} Gaussians")
        trainer = Trainer(photos, start, config, threads=threads)
        if isinstance(begin, Trainer):
            trainer.exposures.maps[: len(begin.photos)] = begin.exposures.maps
    _train(trainer, state, say)
    return trainer


def _on_mesh(
    capture: Capture, mesh: Path, options: AppearanceOptions, sky: Gaussians | None
) -> tuple[Gaussians, float]:
    """Return flat Gaussians on the mesh, the sky's, round ones at other points, and `widest`."""
    count = min(options.begin, options.most * 3 // 4)  # The rest is for what the mesh lacks.
    on = points_on(mesh, count, capture.centres, seed=options.seed)
    start = gaussians_at(*on, opacity=_SURFACE)
    sizes = np.exp(start.log_scales[:, 0]) / distances(on[0], capture.centres)
    widest = min(0.5, _WIDEST * float(np.median(sizes)))
    start = start if sky is None else concatenate(start, sky)
    points, colours = points_of(capture, off=on[0])
    room = max(0, options.most - len(start))
    kept = np.unique(np.linspace(0, len(points) - 1, min(room, len(points))).astype(np.int64))
    if len(kept) <= NEIGHBOURS:
        return start, widest
    return concatenate(start, gaussians_at(points[kept], colours[kept])), widest


def _train(trainer: Trainer, state: Path, say: Callable[[str], None]) -> None:
    """Take all steps that are left, keep the state now and then, and say how far it is."""
    kept = told_last = monotonic()
    told = trainer.iteration
    while not trainer.is_done:
        step = trainer.step()
        now = monotonic()
        if now - told_last >= _SAY_EVERY:
            rate = (trainer.iteration - told) / (now - told_last)  # Of late: steps grow slower.
            told, told_last = trainer.iteration, now
            coarse, whole = trainer.steps_left
            left = (coarse + whole * (_WHOLE if coarse else 1.0)) / rate / 60.0
            say(
                f"splat: step {trainer.iteration:,} of {trainer.config.iterations:,} · "
                f"{step.count:,} Gaussians · loss {step.loss:.3f} · {rate:.1f} steps/s · "
                f"{left:.0f} min left"
            )
        if now - kept >= _KEEP_EVERY or trainer.is_done:
            kept = now
            save_training(state, trainer)


def photos_of(
    capture: Capture, folder: Path, depths: Path | None, *, longest: int
) -> tuple[Photo, ...]:
    """Return a photograph of each shot, in the capture's frame.

    Args:
        capture: read from the folder.
        folder: of the capture, with its pictures.
        depths: folder of `<shot>.npz` with `depth` and `confidence`; None = nothing is known.
        longest: side that no picture exceeds, pixels.

    Raises:
        SceneError: a picture, mask or depth is missing or damaged.
    """
    return tuple(_photo(shot, folder, depths, longest) for shot in capture.shots)


def check_held_out(pattern: str, names: Sequence[str]) -> None:
    """Check that a pattern of names holds some photographs out, and not all; empty = no pattern.

    Raises:
        UsageError: it holds out none, or all.
    """
    held = sum(fnmatchcase(name, pattern) for name in names)
    if pattern and names and held in {0, len(names)}:
        raise UsageError(
            f"--held-out {pattern!r} holds out {held} of {plural(len(names), 'photograph')}",
            fix=f"name some of them, such as {names[0]}",
        )


def split_photos(
    photos: tuple[Photo, ...], options: AppearanceOptions
) -> tuple[tuple[Photo, ...], tuple[Photo, ...]]:
    """Return what is learnt from, and what is held out: by name, or every 8th as the field does it.

    Of few photographs about an eighth is held out too, at least one of four.

    Raises:
        UsageError: no photograph has such a name, or all have.
    """
    if options.held_out:
        check_held_out(options.held_out, [photo.name for photo in photos])
        held = tuple(photo for photo in photos if fnmatchcase(photo.name, options.held_out))
        names = {photo.name for photo in held}
        return tuple(photo for photo in photos if photo.name not in names), held
    every = options.held_out_every
    if not every or len(photos) < _FEWEST:
        return photos, ()
    chosen = set(range(every // 2, len(photos), every))
    if _are_few(photos, options):
        count = max(1, round(len(photos) / every))
        chosen = {(2 * n + 1) * len(photos) // (2 * count) for n in range(count)}
    held = tuple(photo for n, photo in enumerate(photos) if n in chosen)
    return tuple(photo for n, photo in enumerate(photos) if n not in chosen), held


def _are_few(photos: tuple[Photo, ...], options: AppearanceOptions) -> bool:
    return len(photos) < 2 * options.held_out_every


def _photo(shot: PlacedShot, folder: Path, depths: Path | None, longest: int) -> Photo:
    picture = read_picture(shot, folder)
    camera = shot.camera
    scale = min(1.0, longest / max(camera.width, camera.height))
    size = (round(camera.height * scale), round(camera.width * scale))
    down, right = size[0] / camera.height, size[1] / camera.width
    small = replace(
        camera,
        width=size[1],
        height=size[0],
        fx=camera.fx * right,
        cx=camera.cx * right,
        fy=camera.fy * down,
        cy=camera.cy * down,
    )
    if scale < 1.0:
        image = Image.fromarray(picture).resize((size[1], size[0]), Image.Resampling.BOX)
        picture = np.asarray(image)
    inverse, confidence = _depth(shot, depths, size)
    return Photo(
        name=shot.name,
        camera=small,
        rgb=np.ascontiguousarray(picture),
        inverse_depth=inverse,
        confidence=confidence,
        mask=_mask(shot, folder, size),
    )


def _mask(shot: PlacedShot, folder: Path, size: tuple[int, int]) -> NDArray[np.bool_] | None:
    if shot.mask is None:
        return None
    path = inside(folder, shot.mask)
    try:
        with open_picture(path) as image:
            return nearest_pixels(np.asarray(image.convert("L")) > 0, size)
    except _DAMAGE as error:
        raise SceneError(f"{path} cannot be read: {error}", fix="calibrate again") from None


def _depth(
    shot: PlacedShot, depths: Path | None, size: tuple[int, int]
) -> tuple[NDArray[np.float32] | None, NDArray[np.float32] | None]:
    """Return inverse depth and confidence, 0 where nothing is known."""
    if depths is None:
        return None, None
    depth, confidence = (nearest_pixels(array, size) for array in read_depth(depths, shot.name))
    return np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0.0), confidence


def nearest_pixels(array: NDArray[_T], size: tuple[int, int]) -> NDArray[_T]:
    """Return an array (H, W) with another number of rows and columns: the nearest pixel's.

    Depth is not averaged: between two surfaces there is none.
    """
    if array.ndim != 2:
        raise ValueError(f"an array of shape {array.shape}")
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(np.int64)
        for new, old in zip(size, array.shape, strict=True)
    )
    return np.ascontiguousarray(array[np.ix_(rows, columns)])


def points_on(path: Path, count: int, eyes: Rows, *, seed: int) -> tuple[Rows, Rows, Rows]:
    """Return points on a mesh, about as many for each pixel of the nearest photograph.

    Args:
        path: a PLY file with colours of vertices.
        count: how many.
        eyes: (M, 3) where photographs were taken from, in the mesh's frame.
        seed: of where they lie.

    Returns:
        (count, 3) in the mesh's frame, (count, 3) colours from the mesh's corners, from 0 to 1, and
        (count, 3) unit normals of the faces that they lie on.

    Raises:
        SceneError: the mesh cannot be read, or has no faces.
    """
    _, _, corners, tints = _read_mesh(path)
    sides = corners[:, 1:] - corners[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    if not (np.isfinite(areas).all() and areas.sum() > 0.0):
        raise SceneError(f"{path} has no faces, or some are not finite", fix=_FIX)
    draw = np.random.default_rng(seed)
    # Sorted places along the summed area: each face gets its share, and no more by chance.
    shares = areas * _nearness(corners.mean(axis=1), eyes)
    along = (np.arange(count) + draw.random(count)) / count * shares.sum()
    chosen = np.searchsorted(np.cumsum(shares), along).clip(max=len(areas) - 1)
    root, other = np.sqrt(draw.random(count)), draw.random(count)
    weights = np.stack([1.0 - root, root * (1.0 - other), root * other], axis=1)[..., None]
    points, colours = (weights * corners[chosen]).sum(1), (weights * tints[chosen]).sum(1)
    return points, colours, normals[chosen] / (2.0 * areas[chosen, None])


def _read_mesh(path: Path) -> tuple[Rows, NDArray[np.int64], Rows, Rows]:
    """Return vertices (V, 3), faces (F, 3), their corners (F, 3, 3), and the corners' colours."""
    import trimesh

    try:
        mesh = trimesh.load_mesh(path, process=False)
        faces = np.asarray(mesh.faces, np.int64)
        tints = np.asarray(getattr(mesh.visual, "vertex_colors"), np.float64)[:, :3] / 255.0  # noqa: B009 - of one of the two kinds.
        vertices = np.asarray(mesh.vertices, np.float64)
        return vertices, faces, vertices[faces], tints[faces]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise SceneError(f"{path} is not a mesh with colours: {error}", fix=_FIX) from None


def _nearness(places: Rows, eyes: Rows) -> Rows:
    """Return (N,) about how large a surface at (N, 3) is in the nearest photograph."""
    away = distances(places, eyes)
    # What a camera all but touches gets no more than the rest of what is near.
    return 1.0 / np.maximum(away, np.quantile(away, _NEAREST)) ** 2


def points_of(capture: Capture, *, off: Rows | None = None) -> tuple[Rows, Rows]:
    """Return the points that calibration found, (N, 3), and their colours from 0 to 1.

    Args:
        capture: with the points.
        off: (M, 3) points of a surface: only those count that clearly lie off it, as what is too
            far away for a mesh does.
    """
    points, colours = capture.points, capture.colours / 255.0
    if off is None or not len(points):
        return points, colours
    clear = distances(points, off) > _CLEAR * distances(points, capture.centres)
    return points[clear], colours[clear]
