"""A failure leads its reader to the line of the suite that names the scene."""

from nw_eval.reporting.scene_states import suite_lines


def test_a_scene_is_at_its_name_its_glob_or_its_folder(make_run, suite_file, of_suite):
    planned = {"hurdles/one": 4, "gaps/wide": 4, "kitchen": 4, "elsewhere": 4}
    lines = suite_lines(make_run(planned, **of_suite), suite_file.parents[1])
    assert lines is not None
    assert lines.file == "suites/hurdles.yaml"
    text = suite_file.read_text().splitlines()
    shown = {scene: text[line - 1].strip() for scene, line in lines.scenes.items()}
    assert shown == {
        "hurdles/one": "- hurdles/one",
        "gaps/wide": '- "gaps/*"',
        "kitchen": "- places/kitchen",
        "elsewhere": "scenes:",
    }
    assert text[lines.gate - 1] == "gate:"


def test_a_suite_that_is_gone_broken_or_elsewhere_has_no_lines(
    make_run, suite_file, of_suite, tmp_path
):
    run = make_run({"hurdles/one": 4}, **of_suite)
    assert suite_lines(run, tmp_path / "another") is None
    suite_file.write_text("a: [")
    assert suite_lines(run, suite_file.parents[1]) is None
    suite_file.unlink()
    assert suite_lines(run, suite_file.parents[1]) is None


def test_a_suite_without_a_gate_is_shown_at_its_first_line(make_run, suite_file, of_suite):
    suite_file.write_text("nw-eval: 1\nscenes: [hurdles/one]\n")
    lines = suite_lines(make_run({"hurdles/one": 4}, **of_suite), suite_file.parents[1])
    assert lines is not None
    assert lines.gate == 1
    assert lines.scenes == {"hurdles/one": 2}
