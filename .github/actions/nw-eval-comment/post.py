"""Posts the comments that nw-eval wrote on the pull request of an event; Python's library alone.

The job that wrote them may have been a fork's, so nothing of them is believed. A text is judged
whole: each of its lines is taken apart, escaped again by nw-eval's own rules, and must come out as
it was. What does not is replaced by a sentence. Every comment begins with lines of this script's,
which say whose words follow and link to the run. It goes to the pull request that GitHub's own
event leads to. Whatever fails is a warning in the log: no comment is worth a red check.
"""

from __future__ import annotations

import json
import os
import re
import stat
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

TELLING = (
    "The text of this run's comment is not shown: nw-eval would not have written it. "
    "The run has the report."
)
"""What stands in the place of a text that is refused."""

UNNAMED = "<!-- nw-eval -->"
"""The mark of a comment on a text whose own mark is none."""

# How nw-eval escapes words: a copy of `nw_eval/reporting/markdown.py`, which is not checked out
# where this script runs. A test holds the two together.
ACTS = re.compile(
    r"[@$]|#\d|gh-\d|://|mailto:|xmpp:|www\.|:(?:[+-]1|100|1234|[\w-]*[a-z][\w-]*):"
    r"|(?<![^\W_])[0-9a-f]{7,}(?![^\W_])",
    re.IGNORECASE,
)
MARKS = re.compile(r"[\\`*\[\]<>|~&]|(?<![^\W_])_|_(?![^\W_])")
BEGINS = re.compile(r"(?:[-+=]+|#+|\d+[.)])(?= |$)")
CODE = re.compile(r"`[^`\n]+`")


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
            mark, text = text_of(content_of(file))
        except Refused as error:
            warn(f"{file.parent.name}: {error}")
            mark, text = UNNAMED, TELLING
        github.post(number, mark, body_of(mark, text, link))


def body_of(mark: str, text: str, link: str) -> str:
    """Return all that is posted: lines of this script's own, and then a text."""
    told = f"**nw-eval**: what [this run]({link}) of the pull request's own code reports."
    return f"{mark}\n{told}\n\n{text}\n"


def content_of(file: Path) -> bytes:
    """Return what is in a file that may be anything."""
    facts = file.lstat()
    if not stat.S_ISREG(facts.st_mode) or facts.st_size > MOST_BYTES:
        raise Refused(f"no file of at most {MOST_BYTES} bytes")
    return file.read_bytes()


def text_of(content: bytes) -> tuple[str, str]:
    """Return the mark and the text of a comment, whatever the content of its file is."""
    mark = UNNAMED
    try:
        first, _, text = content.decode("utf-8").partition("\n")
        mark = first if MARK.fullmatch(first) else UNNAMED
        check(mark, text)
    except (Refused, UnicodeDecodeError) as error:
        warn(f"{mark}: {error if isinstance(error, Refused) else 'it is no UTF-8'}")
        return mark, TELLING
    return mark, text.strip("\n")


def check(mark: str, text: str) -> None:
    """Refuse a text that nw-eval does not write.

    It writes headings, lists of one level, tables and sentences, with an empty line between two of
    them, and folds the last ones at most once.
    """
    if mark == UNNAMED:
        raise Refused("its first line is no mark of nw-eval's")
    if not all(character.isprintable() for character in text.replace("\n", "")):
        raise Refused("it has invisible characters")
    begins, ends = OWN
    blocks = [block for block in re.split(r"\n\n+", text.strip("\n")) if block]
    folds = [block for block in blocks if block in OWN]
    if folds not in ([], [begins, ends]) or (folds and blocks[-1] != ends):
        raise Refused("its details do not begin once and end with it")
    for block in blocks:
        for piece in () if block in OWN else pieces_of(block):
            if not is_ours(piece):
                raise Refused(f"nw-eval would not write {piece[:100]!r}")


def pieces_of(block: str) -> list[str]:
    """Return the words of a list, a table, a heading or a sentence, without what makes it one."""
    lines = block.split("\n")
    if all(line.startswith("* ") for line in lines):
        return [line[2:] for line in lines]
    if lines[0].startswith("|"):
        return cells_of(lines)
    if len(lines) > 1:
        raise Refused(f"nw-eval would not write {block[:100]!r}")
    return [re.sub(r"^#{1,2} ", "", block)]


def cells_of(lines: list[str]) -> list[str]:
    """Return the cells of a table, without the line that rules it."""
    rows = []
    for line in lines:
        if not (line.startswith("| ") and line.endswith(" |") and len(line) > 3):
            raise Refused(f"nw-eval would not write {line[:100]!r}")
        rows.append([cell.strip(" ") for cell in re.split(r"(?<!\\)\|", line[1:-1])])
    ruled = len(rows) > 1 and all(re.fullmatch(r"-{2,}[-:]", cell) for cell in rows[1])
    if not ruled or len({len(row) for row in rows}) != 1:
        raise Refused("a table of it is none of nw-eval's")
    return [cell for row in (rows[0], *rows[2:]) for cell in row]


def is_ours(piece: str) -> bool:
    """Whether words in Markdown are as nw-eval escapes them: as text, or all of them as code."""
    if CODE.fullmatch(piece):
        return code(plain_of(piece)) == piece
    return escaped(" ".join(plain_of(word) for word in piece.split(" "))) == piece


def plain_of(word: str) -> str:
    """Return what a word, or a code span, was before it was escaped."""
    if CODE.fullmatch(word):
        return word[1:-1].replace("\\|", "|")
    return re.sub(r"\\(.)", r"\1", word)


def escaped(line: str) -> str:
    """Return one line of words as nw-eval writes them in Markdown."""
    line = " ".join(
        code(word) if ACTS.search(word) else MARKS.sub(r"\\\g<0>", word) for word in line.split(" ")
    )
    begins = BEGINS.match(line)
    return line if begins is None else f"{line[: begins.end() - 1]}\\{line[begins.end() - 1 :]}"


def code(words: str) -> str:
    """Return words as nw-eval writes code."""
    line = re.sub(r"[`]|\\+(?=\|)", "'", words).replace("|", "\\|")
    return f"`{line}`" if line else ""


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
