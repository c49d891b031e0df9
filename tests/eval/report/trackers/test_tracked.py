"""What trackers get of a run is the verdict's, under keys that every tracker takes."""

import re
from pathlib import PurePosixPath

from hypothesis import given
from hypothesis import strategies as st

from nw_eval.reporting.trackers.tracked import key_of, keys_of

KEY = re.compile(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*")
NAMES = st.text(st.sampled_from("ab/._- \n<ü\u202e'`"), max_size=6) | st.text(max_size=300)


def test_names_of_built_in_places_stay_as_they_are():
    assert key_of("hurdles/three_low") == "hurdles/three_low"


@given(st.sets(NAMES, max_size=12))
def test_names_become_keys_of_plain_characters_each_its_own_and_none_a_folder_of_another(names):
    keys = keys_of(names)
    assert set(keys) == names
    assert len(set(keys.values())) == len(names)
    folders = {str(folder) for key in keys.values() for folder in PurePosixPath(key).parents}
    for key in keys.values():
        assert KEY.fullmatch(key)
        assert len(key) <= 113
        assert ".." not in key.split("/")
        assert key not in folders


def test_a_name_that_imitates_another_ones_key_does_not_get_it():
    key = key_of("a b")
    assert key_of(key) != key


def test_the_same_run_has_one_id_and_a_folder_that_is_used_again_is_another_run(tracked):
    gate = tracked(id="gate")
    assert gate.id == tracked(id="gate").id
    assert gate.id != tracked(id="gate", started="2026-11-22T11:00:05Z").id
    assert gate.id.startswith("gate-")
    assert gate.title == "gate"


def test_numbers_are_those_of_the_verdict(tracked):
    numbers = tracked(reached=3).numbers
    assert numbers["nw-eval/hurdles/all/success"] == 0.75
    assert numbers["nw-eval/hurdles/success/hurdles/three_low"] == 0.75
    assert numbers["nw-eval/hurdles/all/trials"] == 4
    assert "nw-eval/hurdles/all/drop" not in numbers


def test_a_run_without_results_has_no_success_rather_than_none(tracked):
    numbers = tracked(reached=None).numbers
    assert not [key for key in numbers if "success" in key]
    assert numbers["nw-eval/hurdles/all/errors"] == 4


def test_ids_and_keys_of_strangers_are_plain(hostile):
    assert re.fullmatch(r"[A-Za-z0-9_.-]{1,64}", hostile.id)
    assert "\n" not in hostile.title
    assert len([key for key in hostile.numbers if "/success/" in key]) == 14
    assert all(KEY.fullmatch(key) and len(key) <= 250 for key in hostile.numbers)
