"""What is asked of a run is one value: from the door to run.json, and back from there on a resume.

Runs are stopped where the first trial would start, so nothing here costs physics.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import trimesh

from nw_base.errors import IncomparableError, UsageError
from nw_eval import api
from nw_eval.cli.verbs import parse
from nw_eval.engine import local
from nw_eval.engine.rounds import Attempts
from nw_gate.results.provenance import read_run_info
from nw_gate.results.request import Request
from nw_gate.results.seal import seal
from nw_policies import load_bundle
from nw_sim import catalogue

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: stand
trials: 3
seed: 5
episode: {duration: 0.2}
scenes: [SCENES]
record: none
"""
PLACE = """\
nw-scene: 1
name: NAME
task: hurdles
licence: MIT
trail: [[1.7, 0.0, 0.15], [3.0, 0.0, 0.0]]
collision: mesh.obj
"""


class Stopped(BaseException):
    """A run has come to its first trial."""


@pytest.fixture
def jobs(monkeypatch):
    """The jobs of every run that came to its first trial; there it ends."""
    kept = []

    def stop(attempts, _enough):
        kept.append(attempts.jobs)
        raise Stopped

    monkeypatch.setattr(Attempts, "run", stop)
    return kept


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Return the working folder, with a writer of suites and two scanned places in it."""
    folder = tmp_path / "project"
    floor = trimesh.creation.box((12, 8, 1))
    floor.apply_translation((3, 0, -0.5))
    bar = trimesh.creation.box((0.2, 1.6, 0.15))
    bar.apply_translation((1.7, 0, 0.075))
    mesh = trimesh.util.concatenate([floor, bar])
    for name in ("one", "two"):
        (folder / name).mkdir(parents=True)
        mesh.export(folder / name / "mesh.obj")
        (folder / name / "scene.yaml").write_text(PLACE.replace("NAME", name))
    monkeypatch.chdir(folder)
    return folder


def suite(scenes="flat/carpet_room"):
    """Write the suite into the working folder and return its name."""
    path = Path("quick.yaml")
    path.write_text(SUITE.replace("SCENES", scenes))
    return path


def begin(**options):
    """Begin a run up to its first trial."""
    with pytest.raises(Stopped):
        api.run(**options)


def saved(folder):
    return json.loads((folder / "run.json").read_text())


@pytest.mark.nightly
def test_another_collision_than_the_runs_is_not_overruled_by_the_folder(project, jobs):
    begin(suite=suite("./one"), out=project / "run")
    with pytest.raises(IncomparableError, match=r"scene one \(.*, now .*\) changed"):
        api.run(None, resume=project / "run", collision="triangles")
    begin(suite=None, resume=project / "run", collision="terrain")
    assert len(jobs) == 2


def test_a_runs_own_collision_is_kept(project, jobs):
    begin(suite=suite("./one"), out=project / "run", collision="triangles")
    begin(suite=None, resume=project / "run")
    assert [job.collision for job in jobs[1]] == ["triangles"] * 3
    with pytest.raises(IncomparableError, match="scene one"):
        api.run(None, resume=project / "run", collision="terrain")


def test_places_that_collide_each_in_its_own_way_still_do_after_a_resume(project, jobs):
    begin(suite=suite("./one, 'triangles:./two'"), out=project / "run")
    begin(suite=None, resume=project / "run")
    ways = [{job.trial.scene: job.collision for job in planned} for planned in jobs]
    assert ways == [{"one": "terrain", "two": "triangles"}] * 2


def test_places_beside_the_suite_are_found_from_anywhere(project, jobs, tmp_path, monkeypatch):
    begin(suite=suite("./one"), out=project / "run")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    begin(suite=None, resume=project / "run")
    assert jobs[0] == jobs[1]


def test_no_trials_are_refused_on_a_resume_too(project, jobs):
    begin(suite=suite(), out=project / "run")
    with pytest.raises(UsageError, match="--trials 0"):
        api.run(None, resume=project / "run", trials=0)
    assert len(jobs) == 1


def test_a_run_goes_on_with_its_own_renderer_and_limit(project, jobs):
    begin(suite=suite(), out=project / "run", render="cuda", time_limit=7.0)
    begin(suite=None, resume=project / "run")
    begin(suite=None, resume=project / "run", time_limit=8.0)
    assert [(job.render, job.time_limit) for (job, *_) in jobs] == [
        ("cuda", 7.0),
        ("cuda", 7.0),
        ("cuda", 8.0),
    ]
    with pytest.raises(IncomparableError, match="renderer"):
        api.run(None, resume=project / "run", render="cpu")


@pytest.mark.usefixtures("jobs")
def test_workers_get_the_memory_limit_that_was_given_last(project, monkeypatch):
    limits = []
    start_workers = local.LocalProcesses

    def started(*words, memory_limit, builders):
        limits.append(memory_limit)
        return start_workers(*words, memory_limit=memory_limit, builders=builders)

    monkeypatch.setattr(local, "LocalProcesses", started)
    begin(suite=suite(), out=project / "run", memory_limit="3GB")
    begin(suite=None, resume=project / "run")
    begin(suite=None, resume=project / "run", memory_limit="1.5 GiB")
    begin(suite=None, resume=project / "run")
    assert limits == [3 * 10**9, 3 * 10**9, 3 * 2**29, 3 * 2**29]


def test_run_json_keeps_what_was_asked_for_and_is_read_back_as_it_was_written(project, jobs):
    wanted = Request(
        suite=str(suite()), policy="stand", trials=2, scenes=("flat/*",), seed=6, time_limit=7.0
    )
    with pytest.raises(Stopped):
        api.run(wanted, out=project / "run")
    assert read_run_info(project / "run" / "run.json").request == wanted
    begin(suite=None, resume=project / "run", trials=1)
    resumed = read_run_info(project / "run" / "run.json").request
    assert resumed == replace(wanted, trials=1)
    assert [len(planned) for planned in jobs] == [2, 1]


def test_weights_are_found_from_anywhere(project, jobs, tmp_path, monkeypatch):
    vetting = "nw_sim.rollout.confined.vetting.vet_bundle"
    monkeypatch.setattr(vetting, lambda bundle, *_, **__: bundle)  # It takes a process.
    bundle = load_bundle("go1-parkour")
    shutil.copyfile(bundle.checkpoint, project / "weights.onnx")
    weights = Path("weights.onnx")
    begin(suite=suite(), policy="go1-parkour", checkpoint=weights, out=project / "run")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    begin(suite=None, resume=project / "run")
    assert [planned[0].checkpoint for planned in jobs] == [project / "weights.onnx"] * 2


def test_no_folder_gives_leave_to_run_code(project, jobs):
    begin(suite=suite(), out=project / "run", allow_code=True)
    assert saved(project / "run")["request"]["allow_code"] is True
    begin(suite=None, resume=project / "run")
    assert [planned[0].allow_code for planned in jobs] == [True, False]


def test_places_that_came_later_are_none_of_the_run(project, jobs):
    begin(suite=suite("./*"), out=project / "run")
    shutil.copytree(project / "two", project / "three")
    text = (project / "three" / "scene.yaml").read_text()
    (project / "three" / "scene.yaml").write_text(text.replace("two", "three"))
    begin(suite=None, resume=project / "run")
    begin(suite="quick.yaml", resume=project / "run")
    scenes = [sorted({job.trial.scene for job in planned}) for planned in jobs]
    assert scenes == [["one", "two"], ["one", "two"], ["one", "three", "two"]]


@pytest.mark.usefixtures("jobs")
def test_a_run_of_an_older_nw_eval_is_judged_and_its_resume_refused_in_one_line(project):
    begin(suite=suite(), out=project / "run")
    info = read_run_info(project / "run" / "run.json")
    older = {**saved(project / "run"), "collision": "terrain"}
    del older["request"], older["sum"]
    (project / "run" / "run.json").write_text(seal(json.dumps(older))[0])
    judged = api.report(project / "run")
    assert judged.verdict.verdict == "INFRASTRUCTURE"  # Nothing has run.
    assert judged.info == info.model_copy(update={"request": None})
    with pytest.raises(IncomparableError, match=r"^cannot resume .* holds no request; start a new"):
        api.run(None, resume=project / "run")


@pytest.mark.usefixtures("jobs")
@pytest.mark.parametrize("door", ["run", "check"])
def test_every_scan_is_opened_once(project, monkeypatch, door):
    opened = []
    load_folder = catalogue.load_folder

    def counted(folder, **options):
        opened.append(folder.name)
        return load_folder(folder, **options)

    monkeypatch.setattr(catalogue, "load_folder", counted)
    path = suite("./one, ./*")
    if door == "run":
        begin(suite=path, out=project / "run")
    else:
        assert [scene.name for scene in api.check(path).scenes] == ["one", "two"]
    assert opened == ["one", "two"]


@pytest.mark.usefixtures("project")
def test_no_globs_are_not_all_scenes():
    with pytest.raises(UsageError, match="--scenes"):
        api.check(suite(), scenes=[])


@pytest.mark.usefixtures("project")
def test_a_split_chooses_among_the_scenes_of_the_suite():
    path = suite("hurdles/one*, ./one")
    names = [scene.name for scene in api.check(path).scenes]
    kept = [scene.name for scene in api.check(path, scenes=["split:eval", "one"]).scenes]
    assert kept == ["hurdles/one_high_stone_plaza", "one"]
    assert set(kept) < set(names)


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize(
    ("changes", "option"),
    [
        ({"render": "gpu"}, "--render 'gpu'"),
        ({"collision": "mesh"}, "--collision 'mesh'"),
        ({"scenes": "flat/*"}, r"--scenes 'flat/\*'"),
        ({"time_limit": 0.0}, r"--time-limit 0\.0"),
        ({"memory_limit": "2"}, r"--memory-limit '2': give a number and its unit"),
        ({"memory_limit": 2}, "--memory-limit 2"),
    ],
)
def test_what_no_field_takes_is_refused_by_its_option(changes, option):
    with pytest.raises(UsageError, match=option):
        api.check(suite(), **changes)
    with pytest.raises(TypeError, match="polcy"):
        api.check(suite(), polcy="stand")


def test_the_same_words_after_run_and_check_are_the_same_request():
    words = "hurdles --robot go2 -p stand --checkpoint w.onnx -n 3 --seed 6 --record none"
    words += " --baseline shipped --baseline-policy stand --panel pinned --shard 1/2 --recheck 2"
    words += " --time-limit 7 --memory-limit 2GB --render cuda --collision triangles --allow-code"
    arguments = [*words.split(), "--scenes", "gaps/*", "flat/*"]
    run, check = (parse([verb, *arguments], description="") for verb in ("run", "check"))
    assert run.request == check.request
    assert None not in vars(run.request).values()
    assert run.request.scenes == ("gaps/*", "flat/*")
    published = {"junit", "github", "no_github", "comment", "track", "reporter"}
    own = {"out", "resume", "in_process", "ledger", "no_cache", "all_rounds"}
    own |= {"engine", "address", "label"}
    assert set(vars(run)) - set(vars(check)) == own | published
    nothing = parse(["run"], description="").request
    assert nothing == Request()
