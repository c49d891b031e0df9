"""The smoke suite with the splat engine and with the plain torch renderer, in one run.

What the engine is worth end to end: the same trials, logs and images, one process, one thread.

    python tests/bench/bench_smoke.py
"""

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).parents[1] / "splat"))

import splat_reference
import torch

from nw_eval.suite import expand, load_suite, override
from nw_gate.results.request import Request
from nw_places.bake.generate import generate
from nw_policies import load_bundle
from nw_sim.catalogue import match_scenes
from nw_sim.rollout import opening
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial
from nw_splat.image import Image

WANTED = 20.0  # times as many trials a minute


class PlainRenderer:
    """The reference behind the renderer's contract."""

    def __init__(self, gaussians):
        self._gaussians = gaussians

    def render(self, camera, _pixels=None):
        rgb, depth, alpha = splat_reference.render(self._gaussians, camera)
        return Image(rgb=rgb, depth=depth, alpha=alpha)


def trials_per_minute(jobs, library):
    """Return trials a minute, and how many control steps they took."""
    began, steps = time.perf_counter(), 0
    for job in jobs:
        result = run_trial(job, library=library)
        assert result.status == "ok", result.error_text
        steps += result.steps
    return 60.0 * len(jobs) / (time.perf_counter() - began), steps


def main():
    torch.set_num_threads(1)
    suite = override(load_suite("smoke"), Request(trials=1))
    scenes = match_scenes(suite.scenes, suite.base)
    bundle = load_bundle(suite.policy)
    library = Library()
    gaussians = {scene.name: generate(scene.splat.place) for scene in scenes}
    with TemporaryDirectory() as folder:
        jobs = [
            TrialJob(
                trial=trial,
                robot=suite.robot,
                duration=suite.episode.duration,
                scene=trial.scene,
                policy=str(bundle.card_path),
                checkpoint_digest=bundle.checkpoint_sha256,
                record="all",
                mcap=Path(folder, f"{trial.id}.mcap"),
            )
            for trial in expand(suite, scenes)
        ]
        trials_per_minute(jobs, library)  # Loads and compiles.
        engine, steps = trials_per_minute(jobs, library)

        def plain(scene, *_how):
            return PlainRenderer(gaussians[scene.name])

        with patch.object(opening, "_open_renderer", plain):
            reference, same = trials_per_minute(jobs, library)
    assert same == steps, "the renderer changed the trials of a policy that sees none of it"
    print("\nsmoke suite, one process, every image kept: trials a minute")
    print(f"  plain torch renderer {reference:8.1f}")
    print(f"  splat engine         {engine:8.1f}   {engine / reference:.0f} times as many")
    return engine / reference


if __name__ == "__main__":
    sys.exit(0 if main() >= WANTED else 1)
