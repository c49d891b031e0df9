"""Training the splat of a capture, resumable, with what it came to in words and numbers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic

import numpy as np

from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path
from nw_eval.splat.files import write_splat
from nw_eval.splat.gaussians import Gaussians, concatenate
from nw_eval.twin.appearance.options import AppearanceOptions
from nw_eval.twin.appearance.photos import photos_of, split_photos
from nw_eval.twin.appearance.points import points_of, points_on
from nw_eval.twin.capture import Capture, read_capture
from nw_eval.twin.gaussians.checkpoint import resume_training, save_training
from nw_eval.twin.gaussians.config import TrainConfig
from nw_eval.twin.gaussians.evaluate import ViewFigures, view_figures
from nw_eval.twin.gaussians.initial import gaussians_at
from nw_eval.twin.gaussians.kernels.nearby import NEIGHBOURS
from nw_eval.twin.gaussians.nearest import distances
from nw_eval.twin.gaussians.photo import Photo
from nw_eval.twin.gaussians.raster.rasteriser import Rasteriser
from nw_eval.twin.gaussians.trainer import Trainer

SPLAT, REPORT = "splat.ply", "report.json"
_STATE = "training.state"
_WIDEST = 1.2
"""Of a Gaussian near the cameras, as a share of what they have between them on the mesh. Large ones
show plain ground as well to photographs, but a robot is nearer, and sees them stand out of it."""
_SURFACE = 0.7
"""Opacity of Gaussians that begin on a mesh: it is where something was seen."""
_KEEP_EVERY, _SAY_EVERY = 60.0, 15.0
"""Seconds between two states on disk, and between two lines; the result depends on neither."""


@dataclass(frozen=True, kw_only=True)
class AppearanceReport:
    """What the training came to.

    Attributes:
        gaussians: how many there are.
        photos: learnt from.
        views: figures of the photographs that were held out.
    """

    gaussians: int
    photos: int
    views: tuple[ViewFigures, ...]

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
        options: what is asked.
        say: takes a line for people.
        threads: that share each step; the result does not depend on them.

    Raises:
        SceneError: something of the capture or the mesh is missing or damaged.
        UsageError: no photograph is held out by that name, or all of them are.
        StoreError: nothing can be written.
    """
    capture = read_capture(capture_folder)
    depths = None if mesh_folder is None or not options.depth else mesh_folder / "depth"
    photos = photos_of(capture, capture_folder, depths, longest=options.longest)
    learnt, held = split_photos(photos, options)
    trainer = _trainer(capture, mesh_folder, learnt, out, options, threads, say)
    _train(trainer, out, say)
    gaussians = trainer.gaussians
    rasteriser = Rasteriser(
        preset=trainer.config.preset,
        antialiased=trainer.config.antialiased,
        background=trainer.config.background,
    )
    views = tuple(view_figures(gaussians, photo, rasteriser) for photo in held)
    report = AppearanceReport(gaussians=len(gaussians), photos=len(learnt), views=views)
    with atomic_path(out / SPLAT) as temporary:
        write_splat(temporary, gaussians)
    with atomic_path(out / REPORT) as temporary:
        facts = {"options": asdict(options), **asdict(report)}
        figures = {"psnr": report.psnr, "ssim": report.ssim}
        temporary.write_text(json.dumps(facts | figures, indent=1), encoding="utf-8")
    seen = "" if not views else f", {report.psnr:.1f} dB on {len(views)} photographs kept from it"
    say(f"splat: {len(gaussians):,} Gaussians of {len(learnt)} photographs{seen}")
    return report


def _trainer(
    capture: Capture,
    mesh_folder: Path | None,
    photos: tuple[Photo, ...],
    out: Path,
    options: AppearanceOptions,
    threads: int,
    say: Callable[[str], None],
) -> Trainer:
    """Return the training as it was left, or at its beginning."""
    config = TrainConfig.short(options.iterations, seed=options.seed, strategy=options.strategy)
    config = replace(config, most=options.most)
    if options.mesh and mesh_folder is not None:
        start, widest = _on_mesh(capture, mesh_folder / "mesh.ply", options)
        config = replace(config, widest=widest)
    else:
        start = gaussians_at(*points_of(capture))
    state = out / _STATE
    if state.is_file():
        try:
            trainer = resume_training(state, photos, start, config, threads=threads)
        except StoreError as error:
            say(f"splat: {error}: from the beginning")
        else:
            say(f"splat: goes on after step {trainer.iteration:,} of {config.iterations:,}")
            return trainer
    say(f"splat: {len(photos)} photographs, begins with {len(start):,} Gaussians")
    return Trainer(photos, start, config, threads=threads)


def _on_mesh(capture: Capture, mesh: Path, options: AppearanceOptions) -> tuple[Gaussians, float]:
    """Return flat Gaussians on the mesh with round ones at points that it lacks, and `widest`."""
    count = min(options.begin, options.most * 3 // 4)  # The rest is for what the mesh lacks.
    on = points_on(mesh, count, capture.centres, seed=options.seed)
    start = gaussians_at(*on, opacity=_SURFACE)
    sizes = np.exp(start.log_scales[:, 0]) / distances(on[0], capture.centres)
    widest = min(0.5, _WIDEST * float(np.median(sizes)))
    points, colours = points_of(capture, off=on[0])
    room = max(0, options.most - len(start))
    kept = np.unique(np.linspace(0, len(points) - 1, min(room, len(points))).astype(np.int64))
    if len(kept) <= NEIGHBOURS:
        return start, widest
    return concatenate(start, gaussians_at(points[kept], colours[kept])), widest


def _train(trainer: Trainer, out: Path, say: Callable[[str], None]) -> None:
    """Take all steps that are left, keep the state now and then, and say how far it is."""
    first, began = trainer.iteration, monotonic()
    kept = told_last = began
    while not trainer.is_done:
        step = trainer.step()
        now = monotonic()
        if now - told_last >= _SAY_EVERY:
            told_last = now
            rate = (trainer.iteration - first) / (now - began)
            left = (trainer.config.iterations - trainer.iteration) / rate / 60.0
            say(
                f"splat: step {trainer.iteration:,} of {trainer.config.iterations:,} · "
                f"{step.count:,} Gaussians · loss {step.loss:.3f} · {rate:.1f} steps/s · "
                f"{left:.0f} min left"
            )
        if now - kept >= _KEEP_EVERY or trainer.is_done:
            kept = now
            save_training(out / _STATE, trainer)
