"""Logs lie below the run's folder, whatever a scene or a trial is called."""

import pytest

from nw_base.errors import StoreError
from nw_gate.results.run_folder import RunFolder


@pytest.mark.parametrize(
    ("scene", "trial"),
    [("../../x", "t"), ("/abs", "t"), ("a", "../../../t"), ("a/../../..", "t"), ("a", "x" * 300)],
)
def test_a_name_that_leads_out_of_the_run_is_refused(tmp_path, scene, trial):
    with pytest.raises(StoreError, match="is not allowed in"):
        RunFolder(path=tmp_path).mcap(scene, trial)


def test_a_link_out_of_the_run_is_refused(tmp_path):
    run = tmp_path / "run"
    (run / "mcap").mkdir(parents=True)
    (run / "mcap" / "hurdles").symlink_to(tmp_path)
    with pytest.raises(StoreError, match="a link on its way leads to"):
        RunFolder(path=run).mcap("hurdles/one", "t")


def test_a_scene_of_two_words_has_two_folders(tmp_path):
    log = RunFolder(path=tmp_path).mcap("hurdles/one", "hurdles-one-000")
    assert log == tmp_path / "mcap" / "hurdles" / "one" / "hurdles-one-000.mcap"
