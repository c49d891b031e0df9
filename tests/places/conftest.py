from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from nw_scenes import Scene
from nw_sim.catalogue import get_scene


@dataclass(frozen=True)
class Built:
    scene: Scene
    cache: Path
    store: Path
    reports: list[tuple[str, float]]


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """One whole built-in scene, made once in a cache of its own."""
    cache, reports = tmp_path_factory.mktemp("cache"), list[tuple[str, float]]()
    with pytest.MonkeyPatch.context() as monkeypatch:  # Other tests have the user's cache.
        monkeypatch.setenv("NW_EVAL_CACHE", str(cache))
        scene = get_scene("hurdles/one_low_carpet")
        store = scene.splat_store(lambda stage, share: reports.append((stage, share)))
    return Built(scene=scene, cache=cache, store=store, reports=reports)
