"""A policy on a server scores what it scores here, row for row, through the whole runner."""

import subprocess
import sys
from pathlib import Path

import pytest

from nw_eval import api
from nw_eval.policies import load_bundle
from nw_eval.policies.serve import serving

SUITE = """\
nw-eval: 1
name: remote
robot: go1
policy: go1-parkour
trials: 2
seed: 5
episode: {duration: 4.0}
scenes: [hurdles/three_low]
record: none
"""
SAME = (
    "trial_id",
    "outcome",
    "fraction",
    "waypoints_reached",
    "steps",
    "state_digest",
    "action_digest",
)


def remote_card(local: Path, url: str, folder: Path, port_digest: str = "") -> Path:
    """Return the card of a local bundle with its checkpoint on a server."""
    lines = local.read_text().splitlines()
    start = lines.index("checkpoint:")
    text = "\n".join([*lines[:start], *lines[start + 3 :]])
    text = text.replace("adapter: onnx", f"adapter: remote\noptions: {{url: {url}{port_digest}}}")
    path = folder / "policy.yaml"
    path.write_text(text + "\n")
    return path


def test_a_remote_policy_gives_the_rows_of_the_local_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "remote.yaml").write_text(SUITE)
    local = load_bundle("go1-parkour")
    with serving(local) as address:
        card = remote_card(local.card_path, address.url, tmp_path)
        there = api.run("remote.yaml", policy=str(card), workers=1, out=tmp_path / "there")
    here = api.run("remote.yaml", workers=1, out=tmp_path / "here")
    assert [r.status for r in here.rows] == ["ok", "ok"]
    for ours, theirs in zip(here.rows, there.rows, strict=True):
        assert {k: getattr(ours, k) for k in SAME} == {k: getattr(theirs, k) for k in SAME}


def test_where_a_policy_is_served_is_no_part_of_its_digest(tmp_path):
    local = load_bundle("go1-parkour").card_path
    digests = set()
    for index, (url, more) in enumerate(
        [("ws://a:1", ""), ("ws://b:2", ", timeout: 9"), ("ws://a:1", f", digest: {'0' * 64}")]
    ):
        folder = tmp_path / str(index)
        folder.mkdir()
        digests.add(load_bundle(remote_card(local, url, folder, more)).digest)
    assert len(digests) == 2


@pytest.mark.parametrize("missing", ["msgpack", "websockets"])
def test_without_the_extra_the_error_says_what_to_install(missing):
    code = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "from nw_eval.errors import PrerequisiteError\n"
        "try:\n    import nw_eval.policies.adapters.remote\n"
        "except PrerequisiteError as error:\n    print(error)\n"
    )
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert "pip install 'nw-eval[remote]'" in shown
