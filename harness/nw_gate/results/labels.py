"""What a user calls a run: labels from CI's variables, and their own.

A label names; nothing that a trial computes depends on one, and no digest has them.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path
from urllib.parse import quote

from nw_base.clean import clean
from nw_base.errors import UsageError
from nw_base.files.inside import bounded_bytes

MOST = 32
"""Labels of a run."""
LONGEST = 200
"""Characters of a value."""

KNOWN = {
    "repository": "repository",
    "commit": "commit",
    "branch": "branch",
    "pull_request": "pull request",
    "job": "job",
    "job_url": "job's page",
    "training_run": "training run",
    "step": "training step",
}
"""Labels that CI's variables set, in the order of pages, with what pages call them."""

_KEY = re.compile(r"[a-z][a-z0-9_]{0,31}")
_HOST = re.compile(r"https://[A-Za-z0-9](?:[A-Za-z0-9.-]{0,251}[A-Za-z0-9])?(?::[0-9]{1,5})?")
_PATH = re.compile(r"(?:/[A-Za-z0-9._~%+-]+)*/?(?:#[A-Za-z0-9._~-]+)?")
_COMMIT = re.compile(r"[0-9a-fA-F]{7,64}")
_EVENT = 4 * 2**20  # Bytes of GitHub's description of an event.

_ELSEWHERE = {
    "repository": ("BUILDKITE_REPO", "CIRCLE_REPOSITORY_URL", "BUILD_REPOSITORY_NAME", "GIT_URL"),
    "commit": ("BUILDKITE_COMMIT", "CIRCLE_SHA1", "BUILD_SOURCEVERSION", "GIT_COMMIT"),
    "branch": ("BUILDKITE_BRANCH", "CIRCLE_BRANCH", "BUILD_SOURCEBRANCHNAME", "GIT_BRANCH"),
    "pull_request": (
        *("BUILDKITE_PULL_REQUEST", "CIRCLE_PR_NUMBER"),
        *("SYSTEM_PULLREQUEST_PULLREQUESTNUMBER", "CHANGE_ID"),
    ),
    "job": ("BUILDKITE_LABEL", "CIRCLE_JOB", "SYSTEM_JOBNAME", "JOB_NAME"),
    "job_url": ("BUILDKITE_BUILD_URL", "CIRCLE_BUILD_URL", "BUILD_URL"),
}
"""Variables of Buildkite, CircleCI, Azure Pipelines and Jenkins, the first that is set counts."""
_SERVERS = ("BUILDKITE", "CIRCLECI", "TF_BUILD", "JENKINS_URL")
_TRAINING = ("WANDB_RUN_ID", "MLFLOW_RUN_ID")


def check_labels(labels: Mapping[str, str]) -> dict[str, str]:
    """Return labels, the known ones first, the others by name.

    Raises:
        ValueError: there are too many, or one has a key or a value that none can have.
    """
    if len(labels) > MOST:
        raise ValueError(f"{len(labels)} labels; a run has at most {MOST}")
    for key, value in labels.items():
        if fault := _fault(key, value):
            raise ValueError(f"label {clean(key, at_most=40)!r}: {fault}")
    return {key: labels[key] for key in (*KNOWN, *sorted(labels.keys() - KNOWN)) if key in labels}


def typed_labels(pairs: Iterable[str]) -> dict[str, str]:
    """Return the labels that `key=value` say; of two of one key the later.

    Raises:
        UsageError: one says none.
    """
    labels: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise UsageError(
                f"--label {clean(pair, at_most=80)!r}", fix="give key=value, such as team=legs"
            )
        labels[key.strip()] = value.strip()
    return usable(labels)


def usable(labels: Mapping[str, str]) -> dict[str, str]:
    """Return labels that somebody asks for, as `check_labels`.

    Raises:
        UsageError: there are too many, or one has a key or a value that none can have.
    """
    try:
        return check_labels(labels)
    except ValueError as error:
        raise UsageError(
            str(error),
            fix=f"a key is [a-z][a-z0-9_]*, at most 32 long; a value has 1 to {LONGEST} "
            "printable characters, and job_url begins with https://",
        ) from None


def ci_labels(environment: Mapping[str, str]) -> dict[str, str]:
    """Return what CI's variables say of the job that this is; nothing outside CI.

    GitHub Actions (docs.github.com, "Variables reference") and GitLab CI (docs.gitlab.com,
    "Predefined CI/CD variables reference") are told by their own; of Buildkite, CircleCI, Azure
    Pipelines and Jenkins the common ones are read. A value that no label can have is left out.

    Args:
        environment: variables by name.
    """
    if environment.get("GITHUB_ACTIONS") == "true":
        labels = _github(environment)
    elif environment.get("GITLAB_CI") == "true":
        labels = _gitlab(environment)
    elif any(environment.get(name) for name in _SERVERS):
        labels = {key: _first(environment, names) for key, names in _ELSEWHERE.items()}
        if labels["pull_request"] == "false":  # Buildkite's word for none.
            del labels["pull_request"]
    else:
        labels = {}
    labels["training_run"] = _first(environment, _TRAINING)
    return fitting(labels)


def fitting(labels: Mapping[str, str]) -> dict[str, str]:
    """Return those of known labels that a run can have."""
    return check_labels({key: text for key, text in labels.items() if not _fault(key, text)})


def links_of(labels: Mapping[str, str]) -> dict[str, str]:
    """Return addresses by label that a page may link: of the job's own server, and nowhere else.

    They are made of the parts of `job_url` and of the values that they are of. Of a server that is
    neither GitHub's kind nor GitLab's only the job's page is known.

    Args:
        labels: of `check_labels`.
    """
    url, repository = labels.get("job_url", ""), labels.get("repository", "")
    if not url:
        return {}
    links = {"job_url": url}
    server = _HOST.match(url)
    assert server is not None, "a label needs a server"
    if not repository or not _PATH.fullmatch(f"/{repository}"):
        return links
    base = f"{server[0]}/{repository}"
    if url.startswith(f"{base}/actions/"):
        ways = {"commit": "commit", "branch": "tree", "pull_request": "pull"}
    elif url.startswith(f"{base}/-/"):
        ways = {"commit": "-/commit", "branch": "-/tree", "pull_request": "-/merge_requests"}
    else:
        return links
    links["repository"] = base
    for key, way in ways.items():
        value = labels.get(key, "")
        is_known = _COMMIT.fullmatch(value) if key == "commit" else value
        if is_known and (key != "pull_request" or value.isdecimal()):
            links[key] = f"{base}/{way}/{quote(value)}"
    return links


def _fault(key: str, value: str) -> str:
    """Return what a label is not; empty if it may be one."""
    if not _KEY.fullmatch(key):
        return "no key of a label"
    if not value or len(value) > LONGEST:
        return f"{len(value)} characters"
    if any(unicodedata.category(each)[0] in "CZ" and each != " " for each in value):
        return "a character that does not print"
    if key == "job_url" and not _is_address(value):
        return "no https:// address of plain characters"
    return ""


def _is_address(url: str) -> bool:
    server = _HOST.match(url)
    return server is not None and _PATH.fullmatch(url[server.end() :]) is not None


def _github(environment: Mapping[str, str]) -> dict[str, str]:
    get = environment.get
    ref, repository, run = (get(f"GITHUB_{word}", "") for word in ("REF", "REPOSITORY", "RUN_ID"))
    pull = re.fullmatch(r"refs/pull/([0-9]+)/\w+", ref)
    named = get("GITHUB_REF_NAME", "") if ref.startswith("refs/heads/") else ""
    attempt = get("GITHUB_RUN_ATTEMPT", "1")
    path = f"{repository}/actions/runs/{run}" + (f"/attempts/{attempt}" if attempt != "1" else "")
    return {
        "repository": repository,
        # Of a pull request GITHUB_SHA is a merge that exists for this job alone.
        "commit": (_head_of(get("GITHUB_EVENT_PATH", "")) if pull else "") or get("GITHUB_SHA", ""),
        "branch": get("GITHUB_HEAD_REF", "") or named,
        "pull_request": pull[1] if pull else "",
        "job": get("GITHUB_JOB", ""),
        "job_url": f"{get('GITHUB_SERVER_URL', '')}/{path}" if repository and run else "",
    }


def _head_of(event: str) -> str:
    """Return the commit that a pull request ends in, as GitHub's file on its event says it."""
    try:
        head = json.loads(bounded_bytes(Path(event), _EVENT))["pull_request"]["head"]["sha"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""
    return head if isinstance(head, str) and _COMMIT.fullmatch(head) else ""


def _gitlab(environment: Mapping[str, str]) -> dict[str, str]:
    get = environment.get
    server, repository, job = (
        get(f"CI_{word}", "") for word in ("SERVER_URL", "PROJECT_PATH", "JOB_ID")
    )
    branches = ("CI_MERGE_REQUEST_SOURCE_BRANCH_NAME", "CI_COMMIT_BRANCH")
    return {
        "repository": repository,
        "commit": get("CI_COMMIT_SHA", ""),
        "branch": _first(environment, branches),
        "pull_request": get("CI_MERGE_REQUEST_IID", ""),
        "job": get("CI_JOB_NAME", ""),
        "job_url": f"{server}/{repository}/-/jobs/{job}" if repository and job else "",
    }


def _first(environment: Mapping[str, str], names: Iterable[str]) -> str:
    return next(filter(None, (environment.get(name, "") for name in names)), "")
