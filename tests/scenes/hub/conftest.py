"""A real server that speaks the hub's protocol, what lies on it, and a cache of one's own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

# The client looks once, when it is imported. The other protocol for large files has a storage of
# its own, which is not to be had on the loopback address.
os.environ["HF_HUB_DISABLE_XET"] = "1"
os.environ["HF_HUB_DISABLE_TELEMETRY"] = "1"
sys.path.insert(0, str(Path(__file__).parent))

from hub_content import BOXES, CARD, LARGE_FILE, SCENE
from hub_server import Hub


@pytest.fixture(autouse=True)
def hub(tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub", reason="needs the extra hub")
    server = Hub()
    monkeypatch.setenv("HF_ENDPOINT", server.url)
    monkeypatch.setenv("HF_HOME", str(tmp_path / "nobody"))
    monkeypatch.delenv("HF_TOKEN", raising=False)
    monkeypatch.delenv("HF_HUB_OFFLINE", raising=False)
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("nw_scenes.hub.fetch._PAUSES", (0.01, 0.01))
    yield server
    server.close()


@pytest.fixture
def place(hub):
    """A scene on the hub, with something large beside it."""
    files = {"scene.yaml": SCENE, "collision.yaml": BOXES, ".gitattributes": b"* text\n"}
    return hub.add("datasets", "lab/corridor", files | {"notes/large.bin": LARGE_FILE})


@pytest.fixture
def policy(hub):
    return hub.add("models", "lab/still", {"policy.yaml": CARD})


class Ears:
    """Hears how far fetching is."""

    def __init__(self):
        self.messages = []
        self.heard = []

    def message(self, text):
        self.messages.append(text)

    def fetching(self, name, done, total):
        self.heard.append((name, done, total))


@pytest.fixture
def ears():
    return Ears()
