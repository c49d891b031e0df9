"""A hub that misbehaves: what is fetched is whole, or there is one line, in time, and no file."""

from __future__ import annotations

import gzip
import json
import time

import pytest
from hub_content import BOXES, LARGE_FILE, SCENE

from nw_base.errors import NwEvalError
from nw_eval import api
from nw_scenes.hub.reference import forget_checks

FILE, LISTING, REVISION = "/resolve/", "/tree/", "/revision/"
BOMB = gzip.compress(bytes(40 * 2**20))
TRIES = 12
"""More than a client makes."""


def answer(status="200 OK", body=b"", **headers):
    """Return the bytes of an answer; `Content_Length=None` leaves that header out."""
    headers = {"Content_Length": len(body), "Connection": "close", **headers}
    lines = [
        f"{name.replace('_', '-')}: {value}" for name, value in headers.items() if value is not None
    ]
    return "\r\n".join([f"HTTP/1.1 {status}", *lines, "", ""]).encode() + body


def moved(to):
    return answer("302 Found", Location=to)


def listing(*entries):
    return answer(body=json.dumps(entries).encode(), Content_Type="application/json")


def entry(path, size=3, oid="a" * 40, **more):
    return {"type": "file", "path": path, "size": size, "oid": oid, **more}


ANSWERS = {
    "nothing": (FILE, b""),
    "bytes that are no HTTP": (FILE, b"\x00\xff\x16\x03\x01" * 100),
    "a status line alone": (FILE, b"HTTP/1.1 200 OK\r\n"),
    "half a body": (FILE, answer(body=b"nw-scene: 1\n", Content_Length=500)),
    "more than its length": (FILE, answer(body=b"x" * 4000, Content_Length=10)),
    "a length below zero": (FILE, answer(body=b"abc", Content_Length=-5)),
    "two lengths": (FILE, answer(body=b"abc", Content_length=9)),
    "a length of 10^30": (FILE, answer(body=b"abc", Content_Length=10**30)),
    "chunks without sizes": (
        FILE,
        answer(body=b"zz\r\nabc\r\n", Content_Length=None, Transfer_Encoding="chunked"),
    ),
    "a chunk of 2^62 bytes": (
        FILE,
        answer(body=b"3fffffffffffffff\r\nabc", Content_Length=None, Transfer_Encoding="chunked"),
    ),
    "a bomb of gzip": (FILE, answer(body=BOMB, Content_Encoding="gzip")),
    "a listing that is a bomb of gzip": (LISTING, answer(body=BOMB, Content_Encoding="gzip")),
    "a header of 4 MB": (FILE, answer(X_Long="x" * 4_000_000)),
    "a thousand headers": (FILE, answer(**{f"X_{number}": "y" for number in range(1000)})),
    "other bytes": (FILE, answer(body=b"x" * len(SCENE))),
    "no content": (FILE, answer("204 No Content")),
    "not modified": (FILE, answer("304 Not Modified")),
    "a part that was not asked for": (
        FILE,
        answer("206 Partial Content", b"x" * 9, Content_Range="bytes 5-13/14"),
    ),
    "a redirect to a file": (FILE, moved("file:///etc/passwd")),
    "a redirect to nowhere": (FILE, moved("http://127.0.0.1:1/x")),
    "a redirect of no address": (FILE, moved("http://[::1")),
    "a redirect with a password": (FILE, moved("http://user:secret@127.0.0.1:1/")),
    "a listing of a number": (LISTING, answer(body=b"1e999")),
    "a listing that is deep": (LISTING, answer(body=b"[" * 100_000)),
    "a listing of NaN sizes": (LISTING, listing(entry("a", size=float("nan")))),
    "a path above": (LISTING, listing(entry("../../scene.yaml"))),
    "an absolute path": (LISTING, listing(entry("/tmp/scene.yaml"))),
    "a path with NUL": (LISTING, listing(entry("scene\0.yaml"))),
    "a path of a drive": (LISTING, listing(entry("C:\\scene.yaml"))),
    "a path with a lone surrogate": (LISTING, listing(entry("scene\ud800.yaml"))),
    "a path of 70,000 characters": (LISTING, listing(entry("s" * 70_000))),
    "a path twice": (LISTING, listing(entry("scene.yaml"), entry("scene.yaml", oid="b" * 40))),
    "a file that is a folder, too": (LISTING, listing(entry("scene.yaml"), entry("scene.yaml/x"))),
    "a size below zero": (LISTING, listing(entry("scene.yaml", size=-1))),
    "a size of 2^63": (LISTING, listing(entry("scene.yaml", size=2**63))),
    "a size that is a text": (LISTING, listing(entry("scene.yaml", size="3"))),
    "a name of our own list": (LISTING, listing(entry("scene.yaml"), entry(".lock"))),
    "no files": (LISTING, listing()),
    "a digest that leads away": (LISTING, listing(entry("scene.yaml", oid="../../../x"))),
    "large files without digest": (LISTING, listing(entry("scene.yaml", lfs={"size": 3}))),
    "a commit that is none": (REVISION, answer(body=b'{"sha": "../../x", "id": "lab/corridor"}')),
    "a revision that is a list": (REVISION, answer(body=b"[]")),
}  # fmt: skip
IN_PIECES = {"half a body", "more than its length", "a chunk of 2^62 bytes"}
PASSING = {
    "a lost connection": b"",
    "half a body": answer(body=BOXES[:12], Content_Length=500),
    "too many requests": answer("429 Too Many Requests", Retry_After="0"),
    "an error of the server": answer("500 Internal Server Error"),
    "unavailable": answer("503 Service Unavailable"),
}


@pytest.fixture
def corridor(hub):
    files = {"scene.yaml": SCENE, "collision.yaml": BOXES, "notes/large.bin": LARGE_FILE}
    return hub.add("datasets", "lab/corridor", files)


@pytest.mark.usefixtures("corridor")
@pytest.mark.parametrize("name", ANSWERS)
def test_a_hub_that_misbehaves_costs_one_line_and_leaves_no_folder(hub, tmp_path, name):
    place, data = ANSWERS[name]
    hub.raw[place] = [data] * TRIES
    began = time.monotonic()
    with pytest.raises(NwEvalError) as error:
        api.fetch_scene("hub:lab/corridor")
    assert time.monotonic() - began < 30.0
    text = str(error.value)
    assert "\n" not in text
    assert text.isprintable()
    assert len(text) < 2000
    assert "secret" not in text
    assert not list(tmp_path.rglob("scene.yaml"))
    hub.raw.clear()
    forget_checks()
    if name in IN_PIECES:  # The rest of the file is put behind what came of it, and compared.
        with pytest.raises(NwEvalError, match="fetch it again"):
            api.fetch_scene("hub:lab/corridor")
    assert api.fetch_scene("hub:lab/corridor").files.keys() >= {"scene.yaml", "notes/large.bin"}


@pytest.mark.usefixtures("corridor")
@pytest.mark.parametrize("place", [FILE, LISTING, REVISION])
def test_redirects_in_a_circle_end(hub, place):
    hub.raw[place] = [moved(f"{hub.url}/datasets/lab/corridor{place}main/scene.yaml")] * 100
    with pytest.raises(NwEvalError):
        api.fetch_scene("hub:lab/corridor")
    assert len(hub.raw[place]) > 40


@pytest.mark.usefixtures("corridor")
@pytest.mark.parametrize("name", PASSING)
def test_what_is_wrong_for_a_moment_is_asked_for_again(hub, name):
    hub.raw[FILE] = [PASSING[name]]
    assert api.fetch_scene("hub:lab/corridor").files.keys() >= {"scene.yaml", "notes/large.bin"}
