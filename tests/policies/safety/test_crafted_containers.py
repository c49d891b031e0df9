"""No door opens a checkpoint whose container or numbers are crafted: one line, in time, no file."""

import sys
from pathlib import Path

import pytest

from nw_eval.cli import main

sys.path.insert(0, str(Path(__file__).parents[2] / "hostile"))

from containers import CRAFTED, bundle

# What is odd and does no harm: a policy acts, and is checked as any other.
HARMLESS = {
    ("onnx", "branches in branches, 2^12 nodes"),
    ("onnx", "an action of 64 bits"),
    ("torch-export", "numbers of 64 bits"),
}
DAILY = {"a member twice", "entries that overlap", "numbers above it", "a graph with a cycle"}
CASES = [
    pytest.param(
        adapter, name, id=f"{adapter}: {name}", marks=() if name in DAILY else pytest.mark.nightly
    )
    for adapter, made in CRAFTED.items()
    for name in made
]


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("adapter", "name"), CASES)
def test_a_crafted_checkpoint_is_refused_in_words_and_leaves_no_file(
    adapter, name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    folder = bundle(tmp_path / "policy", adapter, CRAFTED[adapter][name]())
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(SystemExit) as left:
        main(["policies", "check", str(folder)])
    said = capsys.readouterr()
    assert "Traceback" not in said.out + said.err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    if (adapter, name) in HARMLESS:
        assert left.value.code in {0, None}
        return
    assert left.value.code == 2
    assert len(said.err.strip().splitlines()) == 1
    assert said.err.startswith("error: ")


def test_ten_of_each_kind_are_tried():
    assert all(len(made) >= 10 for made in CRAFTED.values())
