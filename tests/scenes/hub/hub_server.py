"""A hub on the loopback address: the endpoints of huggingface.co that its client calls here.

What they take and give follows the client's own source (`hf_api.py`, `_commit_api.py`, `lfs.py` and
`utils/_http.py` of huggingface_hub 2.4). Large files are redirected to another origin, as the hub
redirects to its CDN. Connections can be made to break.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

WRITER, READER = "hf_writer", "hf_reader"
LARGE = 50_000
"""Bytes from which on a file is kept as LFS keeps them."""


@dataclass
class Repository:
    private: bool = False
    gated: bool = False
    commits: dict[str, dict[str, bytes]] = field(default_factory=dict)
    revisions: dict[str, str] = field(default_factory=dict)

    def commit(self, files: dict[str, bytes]) -> str:
        """Add a commit that has these files on top of those of the last one; return it."""
        whole = self.commits.get(self.revisions.get("main", ""), {}) | files
        words = json.dumps([len(self.commits), sorted((k, sha256(v)) for k, v in whole.items())])
        commit = hashlib.sha1(words.encode()).hexdigest()
        self.commits[commit] = whole
        self.revisions["main"] = commit
        return commit


@dataclass(frozen=True)
class Call:
    """What was asked of the server."""

    origin: str
    method: str
    path: str
    range: str | None
    token: str | None


class Hub:
    """A hub, and all that it was asked."""

    def __init__(self) -> None:
        self.repositories: dict[tuple[str, str], Repository] = {}
        self.uploads: dict[str, bytes] = {}
        self.calls: list[Call] = []
        self.breaks: list[int] = []
        """After how many bytes the next transfers of large files break off, one each."""
        self.announced: dict[str, dict[str, Any]] = {}
        """What the listing says otherwise than is so, by path."""
        self.sent: dict[str, bytes] = {}
        """What is sent in place of a file's content, by path."""
        self.stalls_after: int | None = None
        """After how many bytes of file content a transfer stops, and its connection stays."""
        self.padding = 0
        """Spaces behind every answer in JSON."""
        self.drips: str | None = None
        """What comes byte by byte and does not end: `headers`, `json` or `files`."""
        self.says_commit: str | None = None
        """Of which commit it says that files are."""
        self.raw: dict[str, list[bytes]] = {}
        """Bytes that are sent in place of answers, by a part of the path, one each time."""
        self.knows_ranges = True
        self.is_gone = False
        self.page = 1000
        self.status: int | None = None
        """What everything is answered with, if something is wrong with the hub."""
        self._servers = [self._serve("hub"), self._serve("cdn")]
        self.url, self.cdn = (f"http://127.0.0.1:{one.server_port}" for one in self._servers)

    def add(self, kind: str, name: str, files: dict[str, bytes], **facts: bool) -> Repository:
        """Make a repository of one commit."""
        repository = self.repositories[kind, name] = Repository(**facts)
        repository.commit(files)
        return repository

    def transfers(self) -> list[Call]:
        """Return the calls for content of files, in order; redirects are none."""
        return [call for call in self.calls if "/resolve/" in call.path or call.origin == "cdn"]

    def close(self) -> None:
        """Be gone: connections end, and are refused from now on."""
        self.is_gone = True
        for server in self._servers:
            server.shutdown()
            server.server_close()

    def _serve(self, origin: str) -> ThreadingHTTPServer:
        handler = type("Handler", (_Handler,), {"hub": self, "origin": origin})
        server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        server.daemon_threads = True
        Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        return server


class _Refusal(Exception):  # noqa: N818 - it is an answer.
    def __init__(self, status: int, code: str = "", message: str = "") -> None:
        self.status, self.code, self.message = status, code, message


class _Handler(BaseHTTPRequestHandler):
    hub: Hub
    origin: str
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: Any) -> None:
        """Print nothing."""

    def do_GET(self) -> None:
        self._answer()

    do_POST = do_PUT = do_GET  # noqa: N815 - the names that http.server calls.

    def _answer(self) -> None:
        if self.hub.is_gone:  # A connection of before.
            self.close_connection = True
            return
        self.token = (self.headers.get("Authorization") or "").removeprefix("Bearer ") or None
        self.body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        url = urlsplit(self.path)
        self.query = parse_qs(url.query)
        self.hub.calls.append(
            Call(self.origin, self.command, url.path, self.headers.get("Range"), self.token)
        )
        for part, answers in self.hub.raw.items():
            if part in url.path and answers:
                self._raw(answers.pop(0))
                return
        try:
            self._route(url.path)()
        except ConnectionError:  # The client has gone.
            self.close_connection = True
        except _Refusal as refusal:
            headers = {"X-Error-Code": refusal.code, "X-Error-Message": refusal.message}
            self._send(refusal.status, b"{}", {k: v for k, v in headers.items() if v})

    def _raw(self, answer: bytes) -> None:
        self.close_connection = True
        with suppress(ConnectionError):
            self.wfile.write(answer)
            self.wfile.flush()

    def _route(self, path: str) -> Callable[[], None]:
        if self.hub.status is not None:
            raise _Refusal(self.hub.status)
        if self.token not in {None, WRITER, READER}:
            raise _Refusal(401, message="Invalid credentials in Authorization header")
        for methods, pattern, name in _ROUTES:
            found = re.fullmatch(pattern, path)
            if found and self.command in methods:
                self.words = {k: unquote(v) for k, v in found.groupdict().items() if v is not None}
                return getattr(self, name)
        raise _Refusal(404)

    def info(self) -> None:
        repository, commit = self._at()
        siblings = [{"rfilename": path} for path in repository.commits[commit]]
        self._json({"_id": "1", "id": self.words["name"], "sha": commit, "siblings": siblings})

    def tree(self) -> None:
        repository, commit = self._at()
        below = self.words.get("below", "")
        files = {
            path: content
            for path, content in sorted(repository.commits[commit].items())
            if not below or path.startswith(f"{below}/")
        }
        entries = [self._entry(path, content) for path, content in files.items()]
        folders = sorted({path.partition("/")[0] for path in files if "/" in path and not below})
        entries += [{"type": "directory", "path": one, "oid": "0" * 40} for one in folders]
        start = int(self.query.get("cursor", ["0"])[0])
        end = start + self.hub.page
        headers = {}
        if end < len(entries):
            address = f"{self.hub.url}{self.path.partition('?')[0]}?recursive=true&cursor={end}"
            headers["Link"] = f'<{address}>; rel="next"'
        self._json(entries[start:end], headers)

    def _entry(self, path: str, content: bytes) -> dict[str, Any]:
        entry = {"type": "file", "path": path, "size": len(content), "oid": git_sha(content)}
        if len(content) >= LARGE:
            lfs = {"oid": sha256(content), "size": len(content), "pointerSize": 130}
            entry |= {"lfs": lfs}
        return entry | self.hub.announced.get(path, {})

    def resolve(self) -> None:
        repository, commit = self._at()
        path = self.words["path"]
        if repository.gated and self.token is None:
            raise _Refusal(403, "GatedRepo")
        content = repository.commits[commit].get(path)
        if content is None:
            raise _Refusal(404, "EntryNotFound")
        content = self.hub.sent.get(path, content)
        facts = {"X-Repo-Commit": self.hub.says_commit or commit, "ETag": f'"{git_sha(content)}"'}
        if len(content) < LARGE:
            self._content(content, facts)
            return
        oid = sha256(content)
        self.hub.uploads[oid] = content
        facts |= {"X-Linked-Etag": f'"{oid}"', "X-Linked-Size": str(len(content))}
        self._send(302, b"", facts | {"Location": f"{self.hub.cdn}/{oid}"})

    def stored(self) -> None:
        if self.origin != "cdn":
            raise _Refusal(404)
        self._content(self.hub.uploads[self.words["oid"]], {"ETag": f'"{self.words["oid"]}"'})

    def create(self) -> None:
        self._check_writer()
        wish = json.loads(self.body)
        key = f"{wish['type']}s", f"{wish['organization']}/{wish['name']}"
        url = json.dumps({"url": f"{self.hub.url}/{key[0]}/{key[1]}"}).encode()
        if key in self.hub.repositories:
            self._send(409, url, {})
            return
        self.hub.repositories[key] = Repository(private=wish.get("visibility") == "private")
        self._send(200, url, {})

    def preupload(self) -> None:
        self._check_writer()
        modes = {
            one["path"]: "lfs" if one["size"] >= LARGE else "regular"
            for one in json.loads(self.body)["files"]
        }
        files = [
            {"path": path, "shouldIgnore": False, "uploadMode": mode}
            for path, mode in modes.items()
        ]
        self._json({"files": files})

    def batch(self) -> None:
        self._check_writer()
        verify = {"href": f"{self.hub.url}/verify"}
        objects = [
            one
            | {
                "actions": {
                    "upload": {"href": f"{self.hub.url}/upload/{one['oid']}"},
                    "verify": verify,
                }
            }
            for one in json.loads(self.body)["objects"]
        ]
        self._json({"transfer": "basic", "objects": objects})

    def upload(self) -> None:
        if sha256(self.body) != self.words["oid"]:
            raise _Refusal(400)
        self.hub.uploads[self.words["oid"]] = self.body
        self._json({})

    def verify(self) -> None:
        if json.loads(self.body)["oid"] not in self.hub.uploads:
            raise _Refusal(404)
        self._json({})

    def commit(self) -> None:
        self._check_writer()
        files: dict[str, bytes] = {}
        for line in self.body.splitlines():
            item = json.loads(line)
            value = item["value"]
            if item["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif item["key"] == "lfsFile":
                files[value["path"]] = self.hub.uploads[value["oid"]]
        kind, name = self.words["kind"], self.words["name"]
        commit = self.hub.repositories[kind, name].commit(files)
        url = f"{self.hub.url}/{kind}/{name}/commit/{commit}"
        self._json({"commitUrl": url, "commitOid": commit})

    def _check_writer(self) -> None:
        if self.token != WRITER:
            raise _Refusal(401 if self.token is None else 403)

    def _at(self) -> tuple[Repository, str]:
        key = self.words.get("kind", "models"), self.words["name"]
        revision = self.words.get("revision", "main")
        repository = self.hub.repositories.get(key)
        if repository is None or (repository.private and self.token is None):
            status = 401 if self.token is None else 404
            raise _Refusal(status, "RepoNotFound", "Repository not found")
        commit = repository.revisions.get(revision, revision)
        if commit not in repository.commits:
            raise _Refusal(404, "RevisionNotFound")
        return repository, commit

    def _content(self, content: bytes, facts: dict[str, str]) -> None:
        span = self.hub.knows_ranges and re.fullmatch(
            r"bytes=(\d+)-", self.headers.get("Range") or ""
        )
        start = int(span[1]) if span else 0
        if span:
            facts = facts | {"Content-Range": f"bytes {start}-{len(content) - 1}/{len(content)}"}
        if self.hub.drips == "files" and len(content) >= LARGE:
            self._drip(content[:3])
        breaks = len(content) >= LARGE and bool(self.hub.breaks)
        after = self.hub.breaks.pop(0) if breaks else None
        self._send(206 if span else 200, content[start:], facts, after=after)

    def _json(self, value: Any, headers: dict[str, str] | None = None) -> None:
        if self.hub.drips in {"headers", "json"}:
            self._drip(b"[", whole=self.hub.drips == "json")
        content = json.dumps(value).encode() + b" " * self.hub.padding
        self._send(200, content, headers or {})

    def _drip(self, content: bytes, *, whole: bool = True) -> None:
        """Send something and then a byte now and then, until nobody listens."""
        self.wfile.write(b"HTTP/1.1 200 OK\r\n" + (b"\r\n" + content if whole else b"X-Drip: "))
        self.close_connection = True
        while True:
            self.wfile.write(b" " if whole else b"x")
            time.sleep(0.02)

    def _send(
        self, status: int, content: bytes, headers: dict[str, str], *, after: int | None = None
    ) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        stall = self.hub.stalls_after if self.origin == "cdn" else None
        self.wfile.write(content[: after if stall is None else stall])
        if stall is not None:
            self.wfile.flush()
            while self.hub.stalls_after is not None:
                time.sleep(0.02)
            self.close_connection = True
        if after is not None:
            self.close_connection = True


_REPO = r"(?P<name>[^/]+/[^/]+?)"
_KIND = r"(?P<kind>models|datasets)"
_DATA = r"(?P<kind>datasets)"
_ROUTES = (
    ("GET", rf"/api/{_KIND}/{_REPO}(?:/revision/(?P<revision>[^/]+))?", "info"),
    ("GET", rf"/api/{_KIND}/{_REPO}/tree/(?P<revision>[^/]+)(?:/(?P<below>.+))?", "tree"),
    ("GET", rf"/(?:{_DATA}/)?{_REPO}/resolve/(?P<revision>[^/]+)/(?P<path>.+)", "resolve"),
    ("GET", "/(?P<oid>[0-9a-f]{64})", "stored"),
    ("POST", "/api/repos/create", "create"),
    ("POST", rf"/api/{_KIND}/{_REPO}/preupload/(?P<revision>[^/]+)", "preupload"),
    ("POST", rf"/api/{_KIND}/{_REPO}/commit/(?P<revision>[^/]+)", "commit"),
    ("POST", rf"/(?:{_DATA}/)?{_REPO}\.git/info/lfs/objects/batch", "batch"),
    ("PUT", "/upload/(?P<oid>[0-9a-f]+)", "upload"),
    ("POST", "/verify", "verify"),
)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def git_sha(content: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
