"""What must be there before a recorded trial runs in a confined process, and what comes back."""

from __future__ import annotations

import shutil
import stat
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from nw_eval.errors import StoreError, UsageError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.rollout.confined.access import policy_rules, running_rules

if TYPE_CHECKING:
    from collections.abc import Generator

    from nw_eval.confinement import Rules
    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.library import Library

TIME_LIMIT = 3600.0
"""Seconds; a trial of 12 s takes 5 to 30, its video some minutes."""


@dataclass(frozen=True, kw_only=True)
class Readied:
    """How the processes of a recorded trial are confined."""

    rules: Rules
    policy: Rules
    renders: bool


def readied(
    job: TrialJob,
    log: Path,
    library: Library,
    *,
    draws: bool,
    folder: Path | None = None,
) -> Readied:
    """Make the scene of a trial, whose cache is out of the other process's reach.

    Args:
        job: the trial, with the policy that is run, and its caller's leave to run code.
        log: the recorded trial's, which is read.
        library: scenes and bundles that are loaded already.
        draws: whether pictures are made that no policy sees.
        folder: in which the process may write; None = nowhere.

    Raises:
        NwEvalError: scene or policy are not there.
        UsageError: CUDA must draw what is seen, and the caller does not allow code.
    """
    bundle = library.bundle(job.policy, job.checkpoint)
    scene = library.scene(job.scene, job.collision)
    renders = (bool(bundle.card.splat_images) or draws) and scene.splat is not None
    if renders and job.render == "cuda" and not job.allow_code:
        # A log's word may not take the fence away, and the driver needs more than it lets through.
        raise UsageError(
            f"{log}: its pictures were drawn with CUDA, which cannot be confined",
            fix="add --allow-code if you trust the log and the policy",
        )
    if renders:
        scene.splat_store()
    rules = running_rules(
        bundle, scenes=[job.scene], logs=folder, allow_code=job.allow_code, also=[log]
    )
    return Readied(rules=rules, policy=policy_rules(bundle), renders=renders)


@contextmanager
def scratch_folder() -> Generator[Path]:
    """Give a folder of our own that a confined process may write into, and remove it."""
    with TemporaryDirectory(prefix="nw-eval-") as folder:
        yield Path(folder)


def fetch(written: Path, destination: Path) -> Path:
    """Copy a file that a confined process has written to where it belongs; return that.

    Raises:
        StoreError: there is no such file, or it cannot be copied.
    """
    try:
        if not stat.S_ISREG(written.lstat().st_mode):  # A link may lead anywhere.
            raise FileNotFoundError
    except OSError:
        raise StoreError(
            f"{destination} was not written by the process that was to", fix="try again"
        ) from None
    with atomic_path(followed(destination)) as temporary:
        shutil.copyfile(written, temporary, follow_symlinks=False)
    return destination
