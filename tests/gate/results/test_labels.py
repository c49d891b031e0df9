"""What a user calls a run, as CI's variables say it and as it is typed."""

import json

import pytest

from nw_base.errors import StoreError, UsageError
from nw_gate.results.labels import check_labels, ci_labels, links_of, typed_labels
from nw_gate.results.provenance import read_run_info, write_run_info

SHA, MERGE = "a1" * 20, "b2" * 20
GITHUB = {
    "GITHUB_ACTIONS": "true",
    "GITHUB_SERVER_URL": "https://github.example",
    "GITHUB_REPOSITORY": "legs/walker",
    "GITHUB_SHA": SHA,
    "GITHUB_REF": "refs/heads/faster-gait",
    "GITHUB_REF_NAME": "faster-gait",
    "GITHUB_JOB": "gate",
    "GITHUB_RUN_ID": "123",
    "GITHUB_RUN_ATTEMPT": "1",
}
"""As docs.github.com, "Variables reference", describes them."""
GITLAB = {
    "GITLAB_CI": "true",
    "CI_SERVER_URL": "https://gitlab.example:8443",
    "CI_PROJECT_PATH": "legs/robots/walker",
    "CI_COMMIT_SHA": SHA,
    "CI_MERGE_REQUEST_SOURCE_BRANCH_NAME": "faster-gait",
    "CI_MERGE_REQUEST_IID": "17",
    "CI_JOB_NAME": "gate",
    "CI_JOB_ID": "99",
}
"""As docs.gitlab.com, "Predefined CI/CD variables reference", describes them."""


def test_a_push_on_github_names_repository_commit_branch_and_job():
    assert ci_labels(GITHUB) == {
        "repository": "legs/walker",
        "commit": SHA,
        "branch": "faster-gait",
        "job": "gate",
        "job_url": "https://github.example/legs/walker/actions/runs/123",
    }
    again = ci_labels({**GITHUB, "GITHUB_RUN_ATTEMPT": "2"})
    assert again["job_url"].endswith("/runs/123/attempts/2")


def test_a_pull_request_on_github_names_the_commit_that_it_ends_in(tmp_path):
    event = tmp_path / "event.json"
    event.write_text(json.dumps({"pull_request": {"head": {"sha": SHA}}}))
    pulled = {
        **GITHUB,
        "GITHUB_SHA": MERGE,
        "GITHUB_REF": "refs/pull/17/merge",
        "GITHUB_REF_NAME": "17/merge",
        "GITHUB_HEAD_REF": "faster-gait",
        "GITHUB_EVENT_PATH": str(event),
    }
    found = ci_labels(pulled)
    assert (found["commit"], found["branch"], found["pull_request"]) == (SHA, "faster-gait", "17")
    event.write_text('{"pull_request": []}')
    assert ci_labels(pulled)["commit"] == MERGE


def test_gitlab_and_jenkins_are_read_too_and_a_desk_says_nothing():
    assert ci_labels(GITLAB) == {
        "repository": "legs/robots/walker",
        "commit": SHA,
        "branch": "faster-gait",
        "pull_request": "17",
        "job": "gate",
        "job_url": "https://gitlab.example:8443/legs/robots/walker/-/jobs/99",
    }
    jenkins = {"JENKINS_URL": "https://ci.example/", "GIT_COMMIT": SHA, "CHANGE_ID": "4"}
    assert ci_labels({**jenkins, "JOB_NAME": "gate"}) == {
        "commit": SHA,
        "pull_request": "4",
        "job": "gate",
    }
    assert ci_labels({"GIT_COMMIT": SHA, "BUILDKITE_PULL_REQUEST": "false"}) == {}
    assert ci_labels({"WANDB_RUN_ID": "8qz1"}) == {"training_run": "8qz1"}


@pytest.mark.parametrize(
    "server", ["http://github.example", "https://me:pw@github.example", "javascript:alert(1)", ""]
)
def test_a_variable_that_no_label_can_have_is_left_out(server):
    found = ci_labels({**GITHUB, "GITHUB_SERVER_URL": server, "GITHUB_JOB": "a\nb" * 2})
    assert set(found) == {"repository", "commit", "branch"}


def test_labels_are_typed_as_key_and_value():
    assert typed_labels(["team=legs", "step=1500", "note = a = b ", "team=arms"]) == {
        "step": "1500",
        "note": "a = b",
        "team": "arms",
    }


@pytest.mark.parametrize(
    ("typed", "fault"),
    [
        ("team", r"--label 'team'; give key=value"),
        ("Team=legs", "'Team': no key"),
        ("a" * 33 + "=x", "no key"),
        ("team=", "0 characters"),
        ("team=" + "x" * 201, "201 characters"),
        ("team=a\x1b[2J", "does not print"),
        ("team=a\u202eb", "does not print"),
        ("job_url=javascript:alert(1)", "no https:// address"),
        ('job_url=https://ci.example/"onclick=', "no https:// address"),
        ("job_url=https://ci.example@evil.example/", "no https:// address"),
    ],
)
def test_what_is_no_label_is_refused_with_what_is(typed, fault):
    with pytest.raises(UsageError, match=fault):
        typed_labels([typed])


def test_a_run_has_at_most_32_labels():
    assert len(check_labels({f"k{number}": "v" for number in range(32)})) == 32
    with pytest.raises(UsageError, match="33 labels"):
        typed_labels([f"k{number}=v" for number in range(33)])


def test_a_page_links_only_the_server_of_the_job():
    links = links_of(ci_labels(GITHUB) | {"pull_request": "17"})
    base = "https://github.example/legs/walker"
    assert links == {
        "job_url": f"{base}/actions/runs/123",
        "repository": base,
        "commit": f"{base}/commit/{SHA}",
        "branch": f"{base}/tree/faster-gait",
        "pull_request": f"{base}/pull/17",
    }
    merged = links_of(ci_labels(GITLAB))
    base = "https://gitlab.example:8443/legs/robots/walker/-"
    assert merged["pull_request"] == f"{base}/merge_requests/17"
    assert merged["commit"] == f"{base}/commit/{SHA}"


def test_a_value_that_is_no_part_of_an_address_is_not_linked():
    labels = ci_labels(GITHUB)
    assert set(links_of({**labels, "repository": "other/place"})) == {"job_url"}
    assert set(links_of({**labels, "commit": "x", "pull_request": "1/../2"})) == {
        *("job_url", "repository", "branch"),
    }
    odd = links_of({**labels, "branch": 'a"><script>'})["branch"]
    assert odd == "https://github.example/legs/walker/tree/a%22%3E%3Cscript%3E"
    assert links_of({"repository": "legs/walker", "commit": SHA}) == {}


def test_run_json_keeps_labels_and_refuses_what_is_none(run_json, tmp_path):
    path = tmp_path / "run.json"
    labels = {"commit": SHA, "team": "legs"}
    write_run_info(path, run_json.model_copy(update={"labels": labels}))
    assert read_run_info(path).labels == labels
    write_run_info(path, run_json.model_copy(update={"labels": {"job_url": "javascript:1"}}))
    with pytest.raises(StoreError, match=r"labels: .*job_url"):
        read_run_info(path)
