"""Comments on a pull request: sticky, checked as a stranger's, and never worth a failure."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

POST = Path(__file__).parents[2] / ".github" / "actions" / "nw-eval-comment" / "post.py"
MARK = "<!-- nw-eval: hurdles -->"
PAGE = f"""{MARK}
# REGRESSED: hurdles, go1-parkour

* 1 scene below the bar: hurdles/a_b \\<b\\> \\*c\\*

| scene | replay                               |
| ----- | ------------------------------------ |
| a     | `nw-eval replay 'reports/@x\\|#1.mcap'` |

<details><summary>The rest of the report</summary>

## Outcomes

</details>
"""


@dataclass
class Repository:
    """What the API says of a repository, and what it was asked to write."""

    comments: list[dict[str, Any]] = field(default_factory=list)
    pulls: list[dict[str, Any]] = field(default_factory=list)
    asked: list[tuple[str, str]] = field(default_factory=list)
    token: str = "t0ken"
    address: str = ""

    def add(self, body: str, kind: str = "Bot") -> None:
        number = len(self.comments) + 1
        self.comments.append({"id": number, "body": body, "user": {"type": kind}})

    def answer(self, method: str, path: str, content: Any) -> Any:
        self.asked.append((method, path))
        if path.startswith("/repos/o/r/pulls?"):
            return self.pulls
        if method == "GET":
            page = int(path.rpartition("page=")[2])
            return self.comments[100 * (page - 1) : 100 * page]
        if method == "POST":
            self.add(content["body"])
            return self.comments[-1]
        comment = self.comments[int(path.rpartition("/")[2]) - 1]
        comment["body"] = content["body"]
        return comment


@pytest.fixture
def repository() -> Iterator[Repository]:
    """GitHub's API of one repository, on this machine."""
    state = Repository()

    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            length = int(self.headers.get("Content-Length") or 0)
            content = json.loads(self.rfile.read(length) or "null")
            allowed = self.headers["Authorization"] == f"Bearer {state.token}"
            answer = state.answer(self.command, self.path, content) if allowed else {}
            data = json.dumps(answer).encode()
            self.send_response(200 if allowed else 403)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        do_GET = do_POST = do_PATCH = answer  # noqa: N815 - the library calls these names.

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        state.address = f"http://127.0.0.1:{server.server_port}"
        yield state
        server.shutdown()


@pytest.fixture
def post(repository: Repository, tmp_path: Path) -> Any:
    """Post what is in a folder, in a job of an event; return what the job logged."""

    def run(page: str | bytes, event: dict[str, Any] | None = None, token: str = "t0ken") -> str:
        folder = tmp_path / "comments" / "nw-eval-comment"
        folder.mkdir(parents=True, exist_ok=True)
        data = page.encode() if isinstance(page, str) else page
        (folder / "comment.md").write_bytes(data)
        (tmp_path / "event.json").write_text(
            json.dumps(event or {"pull_request": {"number": 7}}), encoding="utf-8"
        )
        environment = {
            "GITHUB_API_URL": repository.address,
            "GITHUB_SERVER_URL": "https://github.example",
            "GITHUB_REPOSITORY": "o/r",
            "GITHUB_RUN_ID": "12",
            "GITHUB_EVENT_PATH": str(tmp_path / "event.json"),
            "GITHUB_TOKEN": token,
        }
        done = subprocess.run(
            [sys.executable, "-I", POST, tmp_path / "comments"],
            env={name: value for name, value in environment.items() if value},
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    return run


def test_a_comment_is_written_once_and_then_written_over(post: Any, repository: Repository) -> None:
    repository.add("an earlier comment", kind="User")
    assert post(PAGE) == ""
    assert post(PAGE.replace("REGRESSED", "PASS")) == ""
    assert [method for method, _ in repository.asked] == ["GET", "POST", "GET", "PATCH"]
    _, own = repository.comments
    link = "[this run](https://github.example/o/r/actions/runs/12)"
    told = f"**nw-eval**: what {link} of the pull request's own code reports."
    assert own["body"].startswith(f"{MARK}\n{told}\n\n# PASS: hurdles, go1-parkour\n")
    assert own["body"].endswith("\n</details>\n")


def test_a_persons_comment_and_another_suites_are_left_alone(
    post: Any, repository: Repository
) -> None:
    for k in range(120):
        repository.add(f"talk {k}", kind="User")
    repository.add(f"{MARK}\nquoted", kind="User")
    repository.add("<!-- nw-eval: gaps -->\n# gaps")
    assert post(PAGE) == ""
    assert len(repository.comments) == 123
    assert repository.comments[120]["body"] == f"{MARK}\nquoted"
    assert repository.comments[121]["body"].endswith("# gaps")


def test_a_forks_run_comments_on_the_open_pull_request_at_its_commit(
    post: Any, repository: Repository
) -> None:
    run = {
        "head_sha": "c" * 40,
        "head_branch": "a&b",
        "head_repository": {"owner": {"login": "stranger"}},
        "html_url": "https://github.example/o/r/actions/runs/11",
    }
    repository.pulls = [
        {"number": 8, "head": {"sha": "d" * 40}},
        {"number": 9, "head": {"sha": "c" * 40}},
    ]
    assert post(PAGE, {"workflow_run": run}) == ""
    assert repository.asked[0] == (
        "GET",
        "/repos/o/r/pulls?head=stranger%3Aa%26b&state=open&per_page=100",
    )
    assert repository.asked[-1] == ("POST", "/repos/o/r/issues/9/comments")
    assert "actions/runs/11" in repository.comments[0]["body"]
    repository.pulls.pop()
    said = post(PAGE, {"workflow_run": run})
    assert (
        said == f"::warning title=nw-eval comment::no open pull request is at commit {'c' * 40}\n"
    )


@pytest.mark.parametrize(
    ("page", "why"),
    [
        (f"{MARK}\n<img src=x>", "hurdles -->: nw-eval would not write '<img src=x>'"),
        (f"{MARK}\nfixes #1", "hurdles -->: nw-eval would not write 'fixes #1'"),
        (f"{MARK}\nturned \u202e round", "hurdles -->: it has invisible characters"),
        (f"{MARK}\n\x1b[2J", "hurdles -->: it has invisible characters"),
        ("# no mark", "<!-- nw-eval -->: its first line is no mark of nw-eval"),
        (f"{MARK} <b>\nx", "<!-- nw-eval -->: its first line is no mark of nw-eval"),
        (f"{MARK}\n" + "x" * 62_000, "nw-eval-comment: no file of at most 62000 bytes"),
        (f"{MARK}\n".encode() + b"\xff", "<!-- nw-eval -->: it is no UTF-8"),
    ],
)
def test_in_the_place_of_what_nw_eval_would_not_write_stands_a_sentence_with_the_runs_link(
    post: Any, repository: Repository, page: str, why: str
) -> None:
    said = post(page)
    assert said.startswith("::warning title=nw-eval comment::")
    assert why in said
    (posted,) = repository.comments
    mark, told, *text = posted["body"].splitlines()
    assert mark == (MARK if "hurdles" in why else "<!-- nw-eval -->")
    assert "[this run](https://github.example/o/r/actions/runs/12)" in told
    refused = "The text of this run's comment is not shown: nw-eval would not have written it."
    assert text == ["", f"{refused} The run has the report."]


def test_a_link_or_a_pipe_in_the_place_of_a_comment_is_not_read(
    post: Any, repository: Repository, tmp_path: Path
) -> None:
    secret = tmp_path / "secret"
    secret.write_text(PAGE.replace("hurdles, go1-parkour", "secret"))
    for name in ("aa", "bb"):
        (tmp_path / "comments" / name).mkdir(parents=True)
    (tmp_path / "comments" / "aa" / "comment.md").symlink_to(secret)
    os.mkfifo(tmp_path / "comments" / "bb" / "comment.md")
    said = post(PAGE)
    assert "aa: no file of at most" in said
    assert "bb: no file of at most" in said
    bodies = [comment["body"] for comment in repository.comments]
    assert len(bodies) == 2
    assert bodies[0].startswith("<!-- nw-eval -->\n")
    assert bodies[1].startswith(MARK)
    assert not any("secret" in body for body in bodies)


def test_a_token_that_may_not_write_or_is_missing_is_a_warning(
    post: Any, repository: Repository
) -> None:
    said = post(PAGE, token="another")
    assert said.endswith("GET /issues/7/comments: HTTP Error 403: Forbidden\n")
    assert post(PAGE, token="").endswith("::there is no GITHUB_TOKEN\n")
    assert post(PAGE, {"schedule": "0"}).endswith("::the event is of no pull request\n")
    assert repository.comments == []
