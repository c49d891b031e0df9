"""Scales, clips and histories that exporters write for each term, and what becomes of them.

The formats are mjlab's `list_to_csv_str` (entries joined by commas, entries of an entry by
semicolons, three decimals, bools as numbers) and Python's own, which forks of it write.
"""

from __future__ import annotations

import math

import pytest

from nw_policies.drafting.exporters import read_exporter_metadata

NAMES = "base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,command"
MJLAB = {
    "observation_names": NAMES,
    "observation_terms_scale": "1.000,0.250,1.000,1.000,0.050,1.000,2.000;2.000;0.250",
    "observation_terms_clip": ",".join(["-inf;inf"] * 4 + ["-100.000;100.000"] + ["-inf;inf"] * 2),
    "observation_terms_history_length": ",".join(["0.000"] * 7),
    "observation_terms_flatten_history_dim": ",".join(["1.000"] * 7),
}


def read(key: str, text: str, names: str = "a,b"):
    entries = {"observation_names": names, f"observation_terms_{key}": text}
    metadata = read_exporter_metadata(entries)
    assert metadata is not None
    return metadata.observation_terms


@pytest.mark.parametrize(
    "text",
    [
        "0.5;0.25,2.000",
        "[[0.5, 0.25], 2.0]",
        "[0.5, 0.25], 2",
        "([0.5,0.25], [2.0])",
        "[0.5;0.25,2]",
    ],
)
def test_a_scale_is_one_number_or_one_for_each_of_a_term(text):
    assert [term.scale for term in read("scale", text)] == [(0.5, 0.25), (2.0,)]


@pytest.mark.parametrize(
    "text",
    ["-inf;inf,-5.000;5.000", "[[-inf, inf], [-5.0, 5.0]]", "(-inf, inf), (-5, 5)", "None,-5;5"],
)
def test_a_clip_is_a_pair_and_infinite_where_there_is_none(text):
    assert [term.clip for term in read("clip", text)] == [(-math.inf, math.inf), (-5.0, 5.0)]


@pytest.mark.parametrize("text", ["5.000,0.000", "[5, 0]", "5,None"])
def test_a_history_counts_its_frames_and_none_is_one(text):
    assert [term.history for term in read("history_length", text)] == [5, 1]


@pytest.mark.parametrize("text", ["1.000,0.000", "[True, False]", "true,false", "1,0"])
def test_whether_a_history_is_one_row_is_a_flag(text):
    assert [term.flat_history for term in read("flatten_history_dim", text)] == [True, False]


def test_an_entry_that_cannot_be_read_says_nothing_and_others_count():
    assert [term.scale for term in read("scale", "nan,0.5")] == [None, (0.5,)]
    assert [term.clip for term in read("clip", "5;-5,-1;1")] == [None, (-1.0, 1.0)]
    assert [term.history for term in read("history_length", "2.5,-3")] == [None, None]
    assert [term.flat_history for term in read("flatten_history_dim", "maybe,")] == [None, None]


@pytest.mark.parametrize("text", ["", "1.0", "1,2,3", "[[1,2", "," * 20_000])
def test_a_list_of_another_length_than_the_terms_says_nothing(text):
    assert [term.scale for term in read("scale", text)] == [None, None]


def test_what_the_file_says_of_terms_is_in_the_draft_and_nothing_to_check(onnx_file, drafted):
    text, card, problems = drafted(onnx_file({"obs": [1, 48]}, MJLAB))
    assert problems == []
    terms = {term.term: term for term in card.observations["obs"].frame_terms}
    assert terms["ang_vel"].scale == 0.25
    assert terms["command"].scale == [2.0, 2.0, 0.25]
    assert (terms["joint_vel"].scale, terms["joint_vel"].clip) == (0.05, (-100.0, 100.0))
    assert terms["lin_vel"].clip is None
    assert "CHECK" not in text[text.index("observations:") :]


def test_only_what_is_absent_is_to_be_checked(onnx_file, drafted):
    broken = MJLAB | {"observation_terms_scale": "oops,0.25,1,1,0.05,1,2;2"}
    del broken["observation_terms_clip"]
    text, card, _ = drafted(onnx_file({"obs": [1, 48]}, broken))
    assert "CHECK: clips are not in the file" in text
    assert "CHECK: the scale of base_lin_vel cannot be read in the file" in text
    assert "# command  # CHECK: its scale cannot be read" in text
    assert card.observations["obs"].frame_terms[1].scale == 0.25


def test_terms_of_other_histories_are_observations_of_their_own(onnx_file, drafted):
    metadata = MJLAB | {
        "observation_names": "base_ang_vel,joint_pos,command",
        "observation_terms_scale": "1,1,1",
        "observation_terms_clip": "-inf;inf,-inf;3,-inf;inf",
        "observation_terms_history_length": "5.000,5.000,0.000",
        "observation_terms_flatten_history_dim": "1,1,1",
    }
    text, card, problems = drafted(onnx_file({"obs": [1, 5 * 15 + 3]}, metadata))
    assert problems == []
    assert card.inputs == {"obs": ["obs", "obs_2"]}
    history = card.observations["obs"].history
    assert (history.steps, history.order, history.by) == (5, "oldest_first", "term")
    assert card.observations["obs"].frame_terms[1].clip == (-1e6, 3.0)
    assert card.observations["obs_2"].history is None
    assert "CHECK" not in text[text.index("observations:") :]


def test_a_history_that_is_not_one_row_is_a_stack_of_frames(onnx_file, drafted):
    metadata = MJLAB | {
        "observation_names": "base_ang_vel,joint_pos",
        "observation_terms_scale": "1,1",
        "observation_terms_clip": "-inf;inf,-inf;inf",
        "observation_terms_history_length": "6,6",
        "observation_terms_flatten_history_dim": "0,0",
    }
    text, card, problems = drafted(onnx_file({"obs": [1, 6, 15]}, metadata))
    assert problems == []
    assert card.observations["obs"].history is None
    assert "wrap: [{wrapper: stack, steps: 6}]\n" in text


def test_a_free_size_is_that_of_the_terms(onnx_file, drafted):
    text, card, problems = drafted(onnx_file({"obs": [1, None]}, MJLAB))
    assert problems == []
    assert len(card.observations["obs"].frame_terms) == 7
    assert "CHECK" not in text[text.index("observations:") :]


def test_a_name_of_several_lines_adds_no_line_to_the_card(onnx_file, drafted):
    metadata = {"observation_names": "base_ang_vel,x\nrobot: go2,joint_pos"}
    text, card, _ = drafted(onnx_file({"obs\nrobot: go2": [1, 20]}, metadata))
    assert card.robot == "go1"
    assert "\nrobot: go2" not in text
