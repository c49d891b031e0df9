"""The pages on GitLab and Jenkins: what they tell these to run is run, as far as that goes."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import pytest
from ruamel.yaml import YAML

from nw_eval.cli.verbs import parse
from nw_eval.reporting.junit import _KINDS
from nw_gate.verdict import EXIT_CODES

PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "ci.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"^```\w+ (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
JOB = YAML(typ="safe", pure=True).load(BLOCKS[".gitlab-ci.yml"])["gate"]


def test_both_servers_run_what_nw_eval_takes_and_read_the_file_that_it_writes() -> None:
    _, gitlab = JOB["script"]
    (jenkins,) = re.findall(r"sh '(.+)'", BLOCKS["Jenkinsfile"])
    for line in (gitlab, jenkins):
        verb = parse(shlex.split(line)[1:], description="")
        assert str(verb.junit) == "junit.xml"
    assert JOB["artifacts"]["reports"]["junit"] == "junit.xml"
    assert "testResults: 'junit.xml'" in BLOCKS["Jenkinsfile"]


def test_the_table_says_which_verdict_is_a_failure_and_which_an_error() -> None:
    told = {
        word: re.findall(r"`<(\w+) type=\"(\w+)\">`", line.split("|")[2])
        for line in PAGE.splitlines()
        for word in re.findall(r"[A-Z]{3,}", line.split("|")[1] if line.startswith("|") else "")
    }
    for word in EXIT_CODES:
        kind = _KINDS.get(word)
        wanted = [] if kind is None else [(kind.__name__.lower(), word.lower())]
        assert told[word] == wanted


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
def test_the_note_is_sent_as_the_text_is_and_only_with_a_token(tmp_path: Path) -> None:
    seen: list[tuple[str, str, bytes]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            seen.append((self.path, self.headers["PRIVATE-TOKEN"], body))
            self.send_response(201)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    text = "<!-- nw-eval: hurdles -->\n# PASS: hurdles; `a` & ü @x\n"
    (tmp_path / "comment.md").write_text(text, encoding="utf-8")
    (command,) = JOB["after_script"]
    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        environment = {
            "PATH": "/usr/bin:/bin",
            "CI_API_V4_URL": f"http://127.0.0.1:{server.server_port}/api/v4",
            "CI_PROJECT_ID": "5",
            "CI_MERGE_REQUEST_IID": "7",
        }
        for token in ({}, {"NOTE_TOKEN": "t0ken"}):
            subprocess.run(
                ["bash", "-c", command], env=environment | token, cwd=tmp_path, check=True
            )
        server.shutdown()
    ((path, token, body),) = seen
    assert (path, token) == ("/api/v4/projects/5/merge_requests/7/notes", "t0ken")
    assert text.encode() in body
