"""`nw-eval baseline`: baselines of a robot that stands for a fifth of a second."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ends

from nw_base.errors import IncomparableError, StoreError, TrialError, UsageError
from nw_base.files.shipped import shipped
from nw_eval import api
from nw_eval.cli.verbs.baseline import saved_page
from nw_eval.engine.listener import NullListener
from nw_gate.results.baseline_file import read_baseline
from nw_gate.results.provenance import read_run_info, write_run_info

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: stand
trials: 2
seed: 5
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
gate: {max_drop: 0.2, baseline: stand}
"""


@pytest.fixture(scope="module")
def first_save(tmp_path_factory):
    """A project with a suite, its baseline of four starts, and the work folder of its trials."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "quick.yaml").write_text(SUITE)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        saved = api.save_baseline("quick.yaml", trials=4, note="the first", workers=2)
        assert saved.run == work()
        assert f"results and logs: {saved.run}; report: " in saved_page(saved)
    assert saved.action == "new"
    return folder


@pytest.fixture
def project(first_save, tmp_path, monkeypatch):
    """A copy of the project as the working directory."""
    folder = tmp_path / "project"
    shutil.copytree(first_save, folder)
    monkeypatch.chdir(folder)
    return folder


def work():
    (folder,) = Path("reports").glob("baseline-quick-*")
    return folder


def run_of(name, **engine):
    """A copy of the work folder whose run.json says that it was made with other versions."""
    folder = Path(shutil.copytree(work(), name))
    run = read_run_info(folder / "run.json")
    write_run_info(folder / "run.json", run.model_copy(update={"engine": {**run.engine, **engine}}))
    return folder


def printed(capsys, *arguments, code=0):
    assert ends("baseline", *arguments) == code
    shown = capsys.readouterr()
    return shown.out + shown.err


def test_a_baseline_lies_where_a_gate_looks_for_it_and_says_where_its_policy_is(project):
    baseline = read_baseline(Path("reports/baselines/quick/stand.parquet"))
    assert baseline.manifest.starts == 4
    assert baseline.manifest.note == "the first"
    assert baseline.manifest.policy.card == "stand"
    assert [start.seed_index for start in baseline.panels[0].starts] == [0, 1, 2, 3]
    assert str(project) not in baseline.manifest.model_dump_json()


def test_saving_again_runs_nothing_and_leaves_the_file_as_it_is(project):
    file = project / "reports/baselines/quick/stand.parquet"
    before = file.read_bytes()
    shutil.rmtree(work())
    saved = api.save_baseline("quick.yaml")
    assert (saved.action, file.read_bytes()) == ("unchanged", before)
    assert not list(Path("reports").glob("baseline-quick-*"))


@pytest.mark.usefixtures("project")
def test_a_save_that_was_interrupted_continues_where_it_was_and_saves_the_same_baseline():
    class Impatient(NullListener):
        def trial(self, row):  # noqa: ARG002  # The first one is enough.
            os.kill(os.getpid(), signal.SIGINT)

    file = Path("reports/baselines/quick/stand.parquet")
    before = read_baseline(file)
    file.unlink()
    journal = work() / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:2]))
    with pytest.raises(KeyboardInterrupt):
        api.save_baseline("quick.yaml", trials=4, workers=1, listener=Impatient())
    assert not file.exists()
    assert 3 <= len(journal.read_bytes().splitlines()) < 5
    saved = api.save_baseline("quick.yaml", trials=4, workers=1)
    assert saved.action == "new"
    assert saved.baseline.panels == before.panels
    assert len(journal.read_bytes().splitlines()) == 5


@pytest.mark.usefixtures("project")
def test_a_save_says_how_long_it_takes_and_after_ctrl_c_continues_with_the_same_command(
    capsys, monkeypatch
):
    file = Path("reports/baselines/quick/stand.parquet")
    file.unlink()
    saved = api.save_baseline("quick.yaml", trials=30, workers=2, note="the first", cache=False)
    whole = saved.baseline
    file.unlink()
    shutil.rmtree(work())
    command = ["save", "quick.yaml", "--trials=30", "--workers=1", "--no-cache", "--note=the first"]
    ended = []

    def press_ctrl_c(_, row):
        ended.append(row)
        if len(ended) == 2:
            os.kill(os.getpid(), signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr("nw_eval.cli.terminal.progress.RunProgress.trial", press_ctrl_c)
        said = printed(capsys, *command, code=130).splitlines()
    assert said[0].startswith("30 trials to run: about 0.1 minutes with --workers 1; Ctrl-C")
    assert "2 of 30 trials are kept; run the same command again to resume" in said
    assert not file.exists()
    assert "28 of 30 trials to run: about" in printed(capsys, *command)
    assert timeless(read_baseline(file)) == timeless(whole)


def timeless(baseline):
    """Return what a baseline's file holds but for when it was saved."""
    infos = tuple(info.model_copy(update={"saved": ""}) for info in baseline.manifest.panels)
    return baseline.manifest.model_copy(update={"panels": infos}).model_dump(), baseline.panels


@pytest.mark.usefixtures("project")
def test_a_save_that_is_interrupted_before_its_first_trial_says_that_it_begins_again():
    class Impatient(NullListener):
        said = ()

        def message(self, text):
            self.said = (*self.said, text)
            if text.startswith("run folder"):
                raise KeyboardInterrupt

    Path("reports/baselines/quick/stand.parquet").unlink()
    shutil.rmtree(work())
    listener = Impatient()
    with pytest.raises(KeyboardInterrupt):
        api.save_baseline("quick.yaml", trials=4, workers=1, listener=listener)
    assert listener.said[-1] == "no trial has ended yet; the same command begins again"


@pytest.mark.usefixtures("project")
def test_a_run_that_is_not_whole_leaves_no_file():
    run = run_of("half")
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (run / "journal.jsonl").write_bytes(b"".join(lines[:3]))
    write_run_info(
        run / "run.json", read_run_info(run / "run.json").model_copy(update={"rows_digest": ""})
    )
    with pytest.raises(TrialError, match="has 2 of its 4 trials"):
        api.save_baseline("quick.yaml", run=run, name="half")
    assert not Path("reports/baselines/quick/half.parquet").exists()


@pytest.mark.usefixtures("project")
def test_a_run_on_another_class_of_machine_is_a_second_panel(capsys):
    shown = printed(capsys, "save", "quick.yaml", "--run", str(run_of("there", cpu="haswell")))
    assert "which has this machine type now, too (2 types): cpu haswell" in shown
    file = Path("reports/baselines/quick/stand.parquet")
    assert [panel.machine.get("cpu") for panel in read_baseline(file).panels] == [None, "haswell"]
    assert "0 of 4 trials differ from machine 1" in printed(capsys, "show", "stand")


@pytest.mark.usefixtures("project")
def test_another_simulator_replaces_a_baseline_only_when_asked_and_after_what_moved_was_shown(
    capsys,
):
    run = str(run_of("newer", mujoco="4.9.9"))
    file = Path("reports/baselines/quick/stand.parquet")
    before = file.read_bytes()
    shown = printed(capsys, "save", "quick.yaml", "--run", run, code=5)
    assert "simulator mujoco  4.0.0 -> 4.9.9" in shown
    assert "--renew replaces it" in shown
    assert file.read_bytes() == before
    shown = printed(capsys, "save", "quick.yaml", "--run", run, "--renew", "--note", "new MuJoCo")
    assert "renewed reports/baselines/quick/stand.parquet" in shown
    assert read_baseline(file).manifest.key.simulator["mujoco"] == "4.9.9"
    assert read_baseline(file).manifest.note == "new MuJoCo"
    # Here it is MuJoCo 4.0.0 still.
    shown = printed(capsys, "check", "stand", "--suite", "quick.yaml", code=5)
    assert shown.splitlines()[:2] == [
        "INVALID: baseline stand is not compatible",
        "simulator mujoco  4.9.9 -> 4.0.0",
    ]
    assert "renew it with `nw-eval baseline save quick.yaml --policy stand --renew`" in shown


def test_a_check_names_what_the_suite_says_otherwise_and_whether_the_machine_is_known(
    project, capsys
):
    shown = printed(capsys, "check", "quick/stand", "--suite", "quick.yaml")
    assert "is compatible: suite, scenes, protocol, simulator, policy" in shown
    assert "it has results for this machine type" in shown
    (project / "quick.yaml").write_text(SUITE.replace("seed: 5", "seed: 6"))
    shown = printed(capsys, "check", "stand", "--suite", "quick.yaml", code=5)
    assert "suite seed    5 -> 6" in shown
    (project / "quick.yaml").write_text(SUITE.replace("max_drop: 0.2", "max_drop: 0.3"))
    printed(capsys, "check", "stand", "--suite", "quick.yaml")


def test_what_renews_a_baseline_of_a_policy_outside_the_project_asks_where_it_lies(
    project, tmp_path, capsys
):
    far = Path(shutil.copytree(shipped("policies") / "stand", tmp_path / "far away" / "still"))
    card = far / "policy.yaml"
    card.write_text(card.read_text().replace("name: stand", "name: still"))
    api.save_baseline("quick.yaml", policy=str(far), trials=2, workers=2)
    (project / "quick.yaml").write_text(SUITE.replace("seed: 5", "seed: 6"))
    shown = printed(capsys, "check", "still", "--suite", "quick.yaml", code=5)
    assert "renew it with `nw-eval baseline save quick.yaml --policy PATH --renew`" in shown
    with pytest.raises(IncomparableError) as caught:
        api.plan("quick.yaml", baseline="still", trials=3)
    assert caught.value.fix.endswith("`nw-eval baseline save quick.yaml --policy PATH --trials 3`")
    with pytest.raises(IncomparableError) as caught:
        api.plan("quick.yaml", baseline="still", trials=2)
    assert caught.value.fix.endswith("save quick.yaml --policy PATH --renew`")
    # Where it is named, the command is one that can be typed.
    shown = printed(capsys, "check", "still", "--suite", "quick.yaml", "-p", str(far), code=5)
    assert f"--policy '{far}' --renew`" in shown
    with pytest.raises(IncomparableError) as caught:
        api.plan("quick.yaml", baseline="still", baseline_policy=str(far), trials=2)
    assert caught.value.fix.endswith(f"--policy '{far}' --renew`")
    assert ends("baseline", "save", "quick.yaml", "--policy", far, "--renew") == 0


@pytest.mark.usefixtures("project")
def test_baselines_are_listed_with_what_is_wrong_with_one(capsys):
    folder = Path("reports/baselines/quick")
    shutil.copy(folder / "stand.parquet", folder / "copied.parquet")
    (folder / "torn.parquet").write_bytes((folder / "stand.parquet").read_bytes()[:-9])
    lines = printed(capsys, "list").splitlines()
    shown = {line.split()[0]: line for line in lines if line.startswith("quick/")}
    assert "1 scene x 4" in shown["quick/stand"]
    assert shown["quick/stand"].endswith("the first")
    assert "its manifest calls it stand, its file is copied.parquet" in shown["quick/copied"]
    assert "torn.parquet is damaged" in shown["quick/torn"]


@pytest.mark.usefixtures("project")
def test_two_baselines_are_compared_scene_by_scene(capsys):
    api.save_baseline("quick.yaml", run=run_of("newer", mujoco="4.9.9"), name="newer")
    shown = printed(capsys, "diff", "stand", "newer")
    assert "simulator mujoco  4.0.0 -> 4.9.9" in shown
    assert "flat/carpet_room  0.000  0.000  +0.000  0 of 4          none" in shown
    assert "No trial changed." in shown


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"run": "there", "trials": 3}, "--run and --trials: the run has decided that"),
        ({"name": "a/b"}, "a baseline's name: 'a/b' is not a name"),
        ({"trials": 0}, "--trials 0 is too low; give at least 1"),
        ({"run": "nowhere"}, "nowhere is not the folder of a run"),
    ],
)
@pytest.mark.usefixtures("project")
def test_what_cannot_be_saved_is_refused_before_anything_runs(options, sentence):
    with pytest.raises(UsageError, match=sentence):
        api.save_baseline("quick.yaml", **options)


def test_a_run_of_another_suite_is_refused(project):
    run = run_of("there")
    (project / "slow.yaml").write_text(SUITE.replace("name: quick", "name: slow"))
    with pytest.raises(UsageError, match="there is a run of suite 'quick', not 'slow'"):
        api.save_baseline("slow.yaml", run=run)


@pytest.mark.usefixtures("project")
def test_looking_at_baselines_loads_no_simulator_and_not_even_arrow():
    code = (
        "import sys\nfrom nw_eval import cli\n"
        "for words in (['list'], ['show', 'stand'], ['diff', 'stand', 'stand']):\n"
        "    try: cli.main(['baseline', *words])\n"
        "    except SystemExit as left: assert left.code == 0\n"
        "heavy = {'mujoco', 'torch', 'numba', 'onnxruntime', 'pyarrow'}\n"
        "print(sorted(heavy & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.usefixtures("project")
def test_a_baseline_that_is_damaged_is_written_over_only_when_asked():
    file = Path("reports/baselines/quick/stand.parquet")
    run = run_of("there")
    file.write_bytes(file.read_bytes()[:-9])
    with pytest.raises(StoreError, match=r"is damaged: .*, or replace it"):
        api.save_baseline("quick.yaml", run=run)
    assert api.save_baseline("quick.yaml", run=run, renew=True).action == "new"
    assert read_baseline(file).manifest.starts == 4
