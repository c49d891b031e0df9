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
        self.knows_ranges = True
        self.is_gone = False
        self.page = 1000
        self.status: int | None = None
        """What everything is answered with, if something is wrong with the hub."""
        self._servers = [self._serve("hub"), self._serve("cdn")]
        self.url, self.cdn = (f"http://127.0.0.1:{one.server_port}" for one in self._servers)

    def add(self, kind: str, name: str, files: dict[str, bytes], **facts: bool) -> Repository:
        """Make a repository of one commit."""
        made = self.repositories[kind, name] = Repository(**facts)
        made.commit(files)
        return made

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

    do_HEAD = do_POST = do_PUT = do_GET

    def _answer(self) -> None:
        if self.hub.is_gone:  # A connection of before.
            self.close_connection = True
            return
        token = (self.headers.get("Authorization") or "").removeprefix("Bearer ") or None
        url = urlsplit(self.path)
        self.hub.calls.append(
            Call(self.origin, self.command, url.path, self.headers.get("Range"), token)
        )
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        try:
            if self.hub.status is not None:
                raise _Refusal(self.hub.status)
            if token not in {None, WRITER, READER}:
                raise _Refusal(401, message="Invalid credentials in Authorization header")
            for pattern, method in _ROUTES:
                found = re.fullmatch(pattern, url.path)
                if found and self.command in method[0]:
                    words = {k: unquote(v) for k, v in found.groupdict().items() if v is not None}
                    getattr(self, method[1])(
                        token, body, query=parse_qs(url.query), **words
                    )
                    return
            raise _Refusal(404)
        except _Refusal as refusal:
            headers = {"X-Error-Code": refusal.code, "X-Error-Message": refusal.message}
            self._send(refusal.status, b"{}", {k: v for k, v in headers.items() if v})

    def info(self, token, _body, query, kind, name, revision="main"):
        repository, commit = self._at(kind, name, revision, token)
        siblings = [{"rfilename": path} for path in repository.commits[commit]]
        self._json({"_id": "1", "id": name, "sha": commit, "siblings": siblings})

    def tree(self, token, _body, query, kind, name, revision, below=""):
        repository, commit = self._at(kind, name, revision, token)
        entries = []
        for path, content in sorted(repository.commits[commit].items()):
            if below and not path.startswith(f"{below}/"):
                continue
            entry: dict[str, Any] = {
                "type": "file", "path": path, "size": len(content), "oid": git_sha(content)
            }
            if len(content) >= LARGE:
                entry["lfs"] = {"oid": sha256(content), "size": len(content), "pointerSize": 130}
            entries.append(entry | self.hub.announced.get(path, {}))
        if query.get("recursive") == ["true"] or query.get("recursive") == ["True"]:
            folders = {path.partition("/")[0] for path in repository.commits[commit] if "/" in path}
            entries += [{"type": "directory", "path": one, "size": 0, "oid": "0" * 40}
                        for one in sorted(folders)]
        start = int(query.get("cursor", ["0"])[0])
        headers = {}
        if start + self.hub.page < len(entries):
            more = f"{self.hub.url}{self.path.partition('?')[0]}?recursive=true"
            headers["Link"] = f'<{more}&cursor={start + self.hub.page}>; rel="next"'
        self._json(entries[start : start + self.hub.page], headers)

    def resolve(self, token, _body, query, kind="models", *, name, revision, path):
        repository, commit = self._at(kind, name, revision, token)
        if repository.gated and token is None:
            raise _Refusal(403, "GatedRepo")
        content = repository.commits[commit].get(path)
        if content is None:
            raise _Refusal(404, "EntryNotFound")
        content = self.hub.sent.get(path, content)
        facts = {"X-Repo-Commit": commit, "ETag": f'"{git_sha(content)}"'}
        if len(content) < LARGE:
            self._content(content, facts)
            return
        oid = sha256(content)
        self.hub.uploads[oid] = content
        facts |= {"X-Linked-Etag": f'"{oid}"', "X-Linked-Size": str(len(content))}
        self._send(302, b"", facts | {"Location": f"{self.hub.cdn}/{oid}"})

    def stored(self, _token, _body, query, oid):
        if self.origin != "cdn":
            raise _Refusal(404)
        self._content(self.hub.uploads[oid], {"ETag": f'"{oid}"'})

    def create(self, token, body, query):
        asked = json.loads(body)
        if token != WRITER:
            raise _Refusal(401 if token is None else 403)
        key = f"{asked['type']}s", f"{asked['organization']}/{asked['name']}"
        url = json.dumps({"url": f"{self.hub.url}/{key[0]}/{key[1]}"}).encode()
        if key in self.hub.repositories:
            self._send(409, url, {})
            return
        private = asked.get("visibility") == "private" or asked.get("private") is True
        self.hub.repositories[key] = Repository(private=private)
        self._send(200, url, {})

    def preupload(self, token, body, query, kind, name, revision):
        files = json.loads(body)["files"]
        self._json({
            "files": [
                {"path": one["path"], "shouldIgnore": False,
                 "uploadMode": "lfs" if one["size"] >= LARGE else "regular"}
                for one in files
            ]
        })

    def batch(self, token, body, query, kind="models", *, name):
        objects = json.loads(body)["objects"]
        self._json({
            "transfer": "basic",
            "objects": [
                one | {"actions": {"upload": {"href": f"{self.hub.url}/upload/{one['oid']}"},
                                   "verify": {"href": f"{self.hub.url}/verify"}}}
                for one in objects
            ],
        })

    def upload(self, _token, body, query, oid):
        if sha256(body) != oid:
            raise _Refusal(400)
        self.hub.uploads[oid] = body
        self._json({})

    def verify(self, _token, body, query):
        if json.loads(body)["oid"] not in self.hub.uploads:
            raise _Refusal(404)
        self._json({})

    def commit(self, token, body, query, kind, name, revision):
        if token != WRITER:
            raise _Refusal(403)
        files: dict[str, bytes] = {}
        for line in body.splitlines():
            item = json.loads(line)
            value = item["value"]
            if item["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif item["key"] == "lfsFile":
                files[value["path"]] = self.hub.uploads[value["oid"]]
        commit = self.hub.repositories[kind, name].commit(files)
        self._json({"commitUrl": f"{self.hub.url}/{name}/commit/{commit}", "commitOid": commit})

    def yaml(self, _token, _body, query):
        self._json({"errors": [], "warnings": []})

    def _at(self, kind: str, name: str, revision: str, token: str | None) -> tuple[Repository, str]:
        repository = self.hub.repositories.get((kind, name))
        if repository is None or (repository.private and token is None):
            raise _Refusal(401 if token is None else 404, "RepoNotFound", "Repository not found")
        commit = repository.revisions.get(revision, revision)
        if commit not in repository.commits:
            raise _Refusal(404, "RevisionNotFound")
        return repository, commit

    def _content(self, content: bytes, facts: dict[str, str]) -> None:
        asked = self.hub.knows_ranges and re.fullmatch(
            r"bytes=(\d+)-", self.headers.get("Range") or ""
        )
        start = int(asked[1]) if asked else 0
        if asked:
            facts = facts | {"Content-Range": f"bytes {start}-{len(content) - 1}/{len(content)}"}
        breaks = self.command == "GET" and len(content) >= LARGE and bool(self.hub.breaks)
        after = self.hub.breaks.pop(0) if breaks else None
        self._send(206 if asked else 200, content[start:], facts, after=after)

    def _json(self, value: Any, headers: dict[str, str] | None = None) -> None:
        self._send(200, json.dumps(value).encode(), headers or {})

    def _send(
        self, status: int, content: bytes, headers: dict[str, str], *, after: int | None = None
    ) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        stall = self.hub.stalls_after if self.origin == "cdn" else None
        if self.command != "HEAD":
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
_ROUTES = (
    (rf"/api/{_KIND}/{_REPO}(?:/revision/(?P<revision>[^/]+))?", ("GET", "info")),
    (rf"/api/{_KIND}/{_REPO}/tree/(?P<revision>[^/]+)(?:/(?P<below>.+))?", ("GET", "tree")),
    (rf"/(?:(?P<kind>datasets)/)?{_REPO}/resolve/(?P<revision>[^/]+)/(?P<path>.+)",
     (("GET", "HEAD"), "resolve")),
    ("/api/repos/create", (("POST",), "create")),
    (rf"/api/{_KIND}/{_REPO}/preupload/(?P<revision>[^/]+)", (("POST",), "preupload")),
    (rf"/api/{_KIND}/{_REPO}/commit/(?P<revision>[^/]+)", (("POST",), "commit")),
    (rf"/(?:(?P<kind>datasets)/)?{_REPO}\.git/info/lfs/objects/batch", (("POST",), "batch")),
    ("/upload/(?P<oid>[0-9a-f]+)", (("PUT",), "upload")),
    ("/verify", (("POST",), "verify")),
    ("/api/validate-yaml", (("POST",), "yaml")),
    ("/(?P<oid>[0-9a-f]{64})", (("GET", "HEAD"), "stored")),
)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def git_sha(content: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
