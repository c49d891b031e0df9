from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from nw_eval.catalogue import get_scene
from nw_eval.scenes import Scene


@dataclass(frozen=True)
class Built:
    scene: Scene
    store: Path
    reports: list[tuple[str, float]]


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Built]:
    """One whole built-in scene, made once in a cache of its own."""
    before = os.environ.get("NW_EVAL_CACHE")
    os.environ["NW_EVAL_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    reports: list[tuple[str, float]] = []
    try:
        scene = get_scene("hurdles/one_low_carpet")
        store = scene.splat_store(lambda stage, share: reports.append((stage, share)))
        yield Built(scene=scene, store=store, reports=reports)
    finally:
        if before is None:
            del os.environ["NW_EVAL_CACHE"]
        else:
            os.environ["NW_EVAL_CACHE"] = before
