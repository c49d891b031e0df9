"""The command line's manners: light, honest about its verbs, and never a traceback."""

import re
import subprocess
import sys

from command_line import ends

from nw_base.errors import SceneError
from nw_eval.cli.verbs import resolve

HEAVY = ("mujoco", "torch", "numba", "onnxruntime", "pyarrow", "pandas", "matplotlib", "numpy")


def test_the_command_line_loads_no_heavy_library():
    loaded = f"print([m for m in {HEAVY!r} if m in sys.modules])"
    code = f"import sys, nw_eval.cli.process, nw_eval.cli.verbs; {loaded}"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert shown.strip() == "[]"


def test_help_names_every_verb_and_every_exit_code(capsys):
    assert ends("--help") == 0
    shown = capsys.readouterr().out
    for word in ("run", "check", "report", "replay", "scenes", "schema", "warmup"):
        assert word in shown
    for word in ("0 PASS", "1 REGRESSED", "3 INCONCLUSIVE", "5 invalid comparison"):
        assert word in " ".join(shown.replace("│", " ").split())


def test_a_known_error_is_one_line_and_its_own_exit_code(capsys, monkeypatch):
    def fail(*_, **__):
        raise SceneError("scene 'x' has no floor", fix="add one")

    resolve("scenes", "list")  # A verb is made of the function that it finds when it is imported.
    monkeypatch.setattr("nw_eval.api.list_scenes", fail)
    assert ends("scenes", "list") == 2
    assert capsys.readouterr().err == "error: scene 'x' has no floor; add one\n"


def test_the_package_is_a_program_too():
    run = [sys.executable, "-m", "nw_eval", "suites"]
    assert "hurdles " in subprocess.run(run, capture_output=True, text=True, check=True).stdout


def test_checking_no_scene_is_no_pass(capsys):
    assert ends("scenes", "check") == 2
    assert capsys.readouterr().err == "error: no scene to check; name one, or its folder\n"


def test_no_metavar_shows_how_a_type_is_written(capsys):
    for words in (["splat", "render"], ["run"], ["check"], ["policies", "init"], ["replay"]):
        assert ends(*words, "--help") == 0
        shown = capsys.readouterr().out
        # Braces hold words to choose from.
        chosen = re.findall(r"\{(.*?)\}", shown, re.DOTALL)
        assert not [found for found in chosen if "None" in found or "FLOAT" in found], words
        assert "|STR" not in shown


def test_scenes_are_listed_with_their_split(capsys):
    assert ends("scenes", "list", "hurdles/three_low", "hurdles/one_low_carpet", "flat/*") == 0
    shown = [line.split()[:4] for line in capsys.readouterr().out.splitlines()]
    assert shown == [
        ["hurdles/three_low", "4", "waypoints", "eval"],
        ["hurdles/one_low_carpet", "2", "waypoints", "train"],
        ["flat/carpet_room", "1", "waypoint", "-"],
    ]
