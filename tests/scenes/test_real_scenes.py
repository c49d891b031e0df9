"""`real:NAME`: a file of a public repository, compared with its SHA-256, becomes a scene."""

import hashlib
import http.server
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nw_base.errors import FetchError, SceneError
from nw_eval import cli
from nw_scenes.folder import load_folder
from nw_scenes.real import REAL_SCANS, fetched_scan
from nw_sim.catalogue import get_scene

STAIRS = Path(__file__).parents[3] / "shared/assets/photographs/stairs/real_stairs_125cm.png"


@pytest.fixture
def published(tmp_path, monkeypatch):
    """A map of one step on a server of this machine: its address, and what is known of it."""
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    grey = np.zeros((71, 122), np.uint8)
    grey[:, :50] = 30
    Image.fromarray(grey).save(tmp_path / "map.png")
    content = (tmp_path / "map.png").read_bytes()
    answers = {"/map.png": content, "/other.png": content[:-1] + b"!"}

    class Answering(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            found = answers.get(self.path)
            self.send_response(404 if found is None else 200)
            self.end_headers()
            self.wfile.write(found or b"")

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    scan = replace(
        REAL_SCANS["stairs"],
        sha256=hashlib.sha256(content).hexdigest(),
        bytes=len(content),
        black=0.0,
        white=1.25,
    )
    yield f"http://127.0.0.1:{server.server_port}", scan
    server.shutdown()
    server.server_close()


def test_it_is_fetched_once_and_is_a_scene_that_says_where_it_is_from(published, tmp_path):
    address, scan = published
    fetched = fetched_scan("real:one", scan, address=f"{address}/map.png")
    again = fetched_scan("real:one", scan, address=f"{address}/gone")
    assert again.folder == fetched.folder
    gone, other = tmp_path / "gone.png", tmp_path / "other.png"
    with pytest.raises(SceneError, match=r"gone\.png: No such file"):
        fetched_scan("real:one", scan, file=gone)
    other.write_bytes(b"x")
    with pytest.raises(SceneError, match=r"other\.png is not the file that is known"):
        fetched_scan("real:one", scan, file=other)
    assert fetched_scan("real:one", scan, file=fetched.folder / "map.png").folder == fetched.folder
    scene = load_folder(fetched.folder)
    assert scene.name == "real/one"
    assert scene.licence == "MIT, ETH Zurich, Takahiro Miki"
    assert scan.commit in (fetched.folder / "scene.yaml").read_text()
    assert np.allclose(np.ptp(scene.static_mesh.vertices, axis=0), (4.84, 2.8, 30 / 255 * 1.25))


def test_another_file_is_not_taken_and_nothing_is_kept_of_it(published):
    address, scan = published
    with pytest.raises(SceneError, match=r"other\.png is not the file that is known: its SHA-256"):
        fetched_scan("real:one", scan, address=f"{address}/other.png")
    with pytest.raises(FetchError, match=r"cannot fetch .*gone: .*404|Not Found"):
        fetched_scan("real:one", scan, address=f"{address}/gone")
    fetched_scan("real:one", scan, address=f"{address}/map.png")


def test_a_name_that_is_none_and_a_file_of_another_place_are_usage(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    with pytest.raises(SceneError, match=r"no real scene is called 'stars'; did you mean.*stairs"):
        get_scene("real:stars")
    (tmp_path / "other.png").write_bytes(b"x")
    for words in (
        ["real:stairs", "--file", str(tmp_path / "gone.png")],
        ["hub:org/place", "--file", str(tmp_path / "other.png")],
    ):
        with pytest.raises(SystemExit) as end:
            cli.main(["scenes", "fetch", *words])
        assert end.value.code == 2
    assert "--file is of real:NAME" in capsys.readouterr().err


@pytest.mark.assets
@pytest.mark.skipif(not STAIRS.exists(), reason="the assets are not here")
def test_the_file_itself_makes_the_stairs(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    fetched = fetched_scan("real:stairs", REAL_SCANS["stairs"], file=STAIRS)
    scene = load_folder(fetched.folder)
    field = scene.static_mesh.vertices
    assert np.allclose(np.ptp(field, axis=0), (4.84, 2.8, 194 / 255 * 1.25), atol=1e-4)
    at = np.abs(field[:, :2] - (4.4, 1.28)).sum(axis=1).argmin()
    assert abs(field[at, 2]) < 1e-6


def test_nothing_but_scenes_fetch_goes_to_the_network(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path))
    for words in (["check", "real"], ["scenes", "show", "real:stairs"]):
        with pytest.raises(SystemExit) as left:
            cli.main(words)
        printed = capsys.readouterr()
        assert left.value.code == 2
        assert "real:stairs is not here; nw-eval scenes fetch real:stairs" in (
            printed.out + printed.err
        )
        assert "fetching" not in printed.err
