"""Posts the comments that nw-eval wrote on the pull request of an event; Python's library alone.

The job that wrote them may have been a fork's, so nothing of them is believed: a text is posted
only if it is one that `nw-eval run --comment` may have written, and on the pull request that
GitHub's own event leads to. Whatever fails is a warning in the log: no comment is worth a red
check.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import Request, urlopen

MOST_COMMENTS, MOST_BYTES, MOST_PAGES = 10, 62_000, 30

MARK = re.compile(r"<!-- nw-eval: [A-Za-z0-9][A-Za-z0-9_.-]{0,63} -->")
"""The first line of a comment: by it the suite's comment is found again."""

OWN = ("<details><summary>The rest of the report</summary>", "</details>")
"""The HTML that nw-eval writes."""

INERT = re.compile(r"\\.|`[^`\n]*`")
"""What GitHub shows as it stands: a sign behind a backslash, and code."""

ACTS = re.compile(r"<|\]\(|\]:|@\w|#\d|\bgh-\d|://|\bwww\.|&#?\w+;|mailto:", re.IGNORECASE)
"""What makes HTML, a link, a picture, a mention or a reference; nw-eval writes none of them."""


class Refused(Exception):  # noqa: N818 - it is no error of this program.
    """There is nothing to post, or nobody to post it to; the message says why."""


def main(folder: Path, environment: dict[str, str]) -> None:
    """Post every comment of a folder."""
    event = json.loads(Path(environment["GITHUB_EVENT_PATH"]).read_text(encoding="utf-8"))
    github = GitHub(environment)
    number, link = pull_request_of(event, github)
    files = sorted(folder.rglob("comment.md"))[:MOST_COMMENTS]
    if not files:
        raise Refused(f"no comment.md below {folder}")
    for file in files:
        try:
            mark, text = checked(file)
            github.post(number, mark, f"{mark}\n{text}\n\n[This run]({link})\n")
        except Refused as error:
            warn(f"{file.parent.name}: {error}")


def checked(file: Path) -> tuple[str, str]:
    """Return the mark and the text of a comment that nw-eval may have written."""
    if file.is_symlink() or not file.is_file() or file.stat().st_size > MOST_BYTES:
        raise Refused(f"no file of at most {MOST_BYTES} bytes")
    try:
        mark, _, text = file.read_text(encoding="utf-8").partition("\n")
    except UnicodeDecodeError:
        raise Refused("no UTF-8") from None
    if not MARK.fullmatch(mark):
        raise Refused("its first line is no mark of nw-eval's")
    if not all(character.isprintable() for character in text.replace("\n", "")):
        raise Refused("it has invisible characters")
    plain = "\n".join("" if line in OWN else line for line in text.split("\n"))
    if found := ACTS.search(INERT.sub("", plain)):
        raise Refused(f"nw-eval would not write {found[0]!r}")
    return mark, text.rstrip()


def pull_request_of(event: dict[str, Any], github: GitHub) -> tuple[int, str]:
    """Return the number of the pull request of an event, and the address of the run to link to."""
    if "pull_request" in event:
        return int(event["pull_request"]["number"]), github.run_link
    run = event.get("workflow_run")
    if run is None:
        raise Refused("the event is of no pull request")
    # A fork's run names no pull request: it is the open one that this very commit heads.
    owner, branch = run["head_repository"]["owner"]["login"], run["head_branch"]
    for pull in github.pulls(owner, branch):
        if pull["head"]["sha"] == run["head_sha"]:
            return int(pull["number"]), str(run["html_url"])
    raise Refused(f"no open pull request is at commit {run['head_sha']}")


class GitHub:
    """The few things that are asked of GitHub's API for one repository."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._token = environment.get("GITHUB_TOKEN", "")
        if not self._token:
            raise Refused("there is no GITHUB_TOKEN")
        self._base = f"{environment['GITHUB_API_URL']}/repos/{environment['GITHUB_REPOSITORY']}"
        server, repository = environment["GITHUB_SERVER_URL"], environment["GITHUB_REPOSITORY"]
        self.run_link = f"{server}/{repository}/actions/runs/{environment['GITHUB_RUN_ID']}"

    def pulls(self, owner: str, branch: str) -> list[dict[str, Any]]:
        """Return the open pull requests of a branch."""
        from urllib.parse import urlencode

        query = urlencode({"head": f"{owner}:{branch}", "state": "open", "per_page": 100})
        return self._call("GET", f"/pulls?{query}")

    def post(self, number: int, mark: str, body: str) -> None:
        """Write a comment: over the bot's own of the same mark, or a new one."""
        path = f"/issues/{number}/comments"
        for page in range(1, MOST_PAGES + 1):
            comments = self._call("GET", f"{path}?per_page=100&page={page}")
            for comment in comments:
                # A token may change anybody's comment; a person's stays what it is.
                by_bot = comment["user"] is not None and comment["user"]["type"] == "Bot"
                if by_bot and comment["body"].startswith(f"{mark}\n"):
                    self._call("PATCH", f"/issues/comments/{int(comment['id'])}", {"body": body})
                    return
            if len(comments) < 100:
                break
        self._call("POST", path, {"body": body})

    def _call(self, method: str, path: str, content: dict[str, str] | None = None) -> Any:
        request = Request(  # noqa: S310 - the address is the runner's own.
            f"{self._base}{path}",
            data=None if content is None else json.dumps(content).encode(),
            method=method,
            headers={
                "Accept": "application/vnd.github+json",
                "Authorization": f"Bearer {self._token}",
                "Content-Type": "application/json",
                "X-GitHub-Api-Version": "2022-11-28",
            },
        )
        try:
            with urlopen(request, timeout=30) as response:  # noqa: S310 - as above.
                return json.load(response)
        except URLError as error:
            raise Refused(f"{method} {path.partition('?')[0]}: {error}") from None


def warn(text: object) -> None:
    """Say something as a warning in the job's log."""
    line = str(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
    print(f"::warning title=nw-eval comment::{line}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]), dict(os.environ))
    except Exception as error:  # noqa: BLE001 - a comment that fails is a warning.
        warn(error if isinstance(error, Refused) else f"{type(error).__name__}: {error}")
