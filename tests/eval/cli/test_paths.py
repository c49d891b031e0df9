"""Every path that a verb takes: what is written stays of its kind, what is read is a file.

The verbs and their options are those of the command line's own definition: one that is new fails
here until it is in the tables below.
"""

import os
import re
import shutil
import threading
import typing
from dataclasses import fields
from pathlib import Path

import pytest
from command_line import ends

from nw_eval.cli.verbs import forms

FILES = {
    "run junit": "run {suite} --policy {missing} --junit {out}",
    "run reporter": "run {suite} --policy {missing} --reporter junit={out}",
    "run comment": "run {suite} --out {new} --workers 1 --comment {out}",
    "gate junit": "gate {run} --junit {out}",
    "gate reporter": "gate {run} --reporter junit={out}",
    "gate comment": "gate {run} --comment {out}",
    "gate out": "gate {run} --out {out}",
    "merge junit": "merge {part} --out {new} --junit {out}",
    "merge reporter": "merge {part} --out {new} --reporter junit={out}",
    "merge comment": "merge {part} --out {new} --comment {out}",
    "report junit": "report {run} --junit {out}",
    "report reporter": "report {run} --reporter junit={out}",
    "report comment": "report {run} --comment {out}",
    "report out": "report {run} --out {out}",
    "plan out": "plan {suite} --run {run} --detect 0.9 --out {out}",
    "compare out": "compare {run} {again} --out {out}",
    "compare picture": "compare {run} {again} --picture {out}",
    "replay picture": "replay {log} --picture {out}",
    "replay video": "replay {log} --video {out}.mp4",
    "replay out": "replay {log} --from 0.1 --policy stand --out {out}",
    "attribute out": "attribute {run} --baseline stand --trials 1 --workers 1 --out {out}.md",
    "policies init out": "policies init {onnx} --robot go1 --out {out}",
    "policies fold out": "policies fold {onnx} --out {out}",
    "robots check out": "robots check go1 --out {out}",
    "scenes show out": "scenes show flat/carpet_room --out {out}",
    "scenes check out": "scenes check flat/carpet_room --out {out}",
    "scenes render out": "scenes render flat/carpet_room --width 64 --out {out}",
    "sensors out": "sensors go1-parkour --scene flat/carpet_room --out {out}",
    "splat convert out": "splat convert {splat} --out {out}.ply",
    "splat render out": "splat render {splat} --width 32 --height 18 --out {out}.png",
    "schema out": "schema suite --out {out}",
}
"""What writes a file, by verb and option."""

APPENDED = {
    "run ledger": "run {suite} --out {new} --workers 1 --ledger {out}",
    "gate ledger": "gate {run} --ledger {out}",
    "merge ledger": "merge {part} --out {new} --ledger {out}",
}
"""What adds lines to a file, which must be one that can be read."""

FOLDERS = {
    "run out": "run {suite} --out {out}",
    "merge out": "merge {part} --out {out}",
    "robots init out": "robots init {model} --out {out}",
    "report site": "report {run} --site {out}",
    "sweep out": "sweep {suite} --axis friction=0.5,1 --out {out}",
    "limits out": "limits stairs/up --policy stand --trials 1 --out {out}",
    "bisect out": "bisect {suite} {onnx} --good {onnx} --bad {onnx} -p go1-parkour --out {out}",
    "watch out": "watch {folder} --suite {suite} --policy go1-parkour --once --out {out}",
    "attribute out": "attribute {run} --baseline stand --cause --out {out}",
    "train teacher out": "train teacher teacher --out {out}",
    "train student out": "train student student-rgb-small --out {out}",
    "train export out": "train export {folder} --out {out}",
    "study single-scene out": "study single-scene --out {out}",
    "study multi-scene out": "study multi-scene --out {out}",
    "study observations out": "study observations --out {out}",
    "twin build out": "twin build {folder} --out {out}",
    "twin calibrate out": "twin calibrate {folder} --out {out}",
    "twin label out": "twin label flat/carpet_room --out {out}",
    "scenes import out": "scenes import {scan} --out {out}",
    "scenes level out": "scenes level {mesh} --flip --out {out}",
}
"""What writes a folder."""

UNTRIED = {
    "plan write_suite": "needs limits: tests/eval/api/test_trial_plans.py; it uses `atomic_path`",
    "limits write_suite": "needs limits: tests/eval/api/test_limits.py; it uses `atomic_path`",
    "replay rrd": "needs the extra `rerun`; viewing/recording/content.py uses `atomic_path`",
}

READ = {
    "run suite": "run {in}.yaml",
    "run policy": "run {suite} --policy {in}.yaml",
    "run checkpoint": "run {suite} --policy go1-parkour --checkpoint {in}",
    "run baseline": "run {suite} --baseline {in}.parquet",
    "run baseline_policy": "run {suite} --baseline {in}.parquet --baseline-policy {in}.yaml",
    "run resume": "run --resume {in}",
    "check suite": "check {in}.yaml",
    "check policy": "check {suite} --policy {in}.yaml",
    "check checkpoint": "check {suite} --policy go1-parkour --checkpoint {in}",
    "check baseline": "check {suite} --baseline {in}.parquet",
    "check baseline_policy": "check {suite} --baseline {in}.parquet --baseline-policy {in}.yaml",
    "plan suite": "plan {in}.yaml",
    "plan run": "plan {suite} --run {in}",
    "plan baseline": "plan {suite} --baseline {in}.parquet",
    "plan limits": "plan {suite} --run {run} --detect 0.9 --limits {in}",
    "plan policy": "plan {suite} --shards 2 --policy {in}.yaml",
    "baseline save suite": "baseline save {in}.yaml",
    "baseline save policy": "baseline save {suite} --policy {in}.yaml",
    "baseline save checkpoint": "baseline save {suite} --policy go1-parkour --checkpoint {in}",
    "baseline save run": "baseline save {suite} --run {in}",
    "baseline show baseline": "baseline show {in}.parquet",
    "baseline check baseline": "baseline check {in}.parquet",
    "baseline check policy": "baseline check {baseline} --policy {in}.yaml",
    "baseline check checkpoint": "baseline check {baseline} --checkpoint {in}",
    "baseline verify baseline": "baseline verify {in}.parquet",
    "baseline verify policy": "baseline verify {baseline} --policy {in}.yaml",
    "baseline verify checkpoint": "baseline verify {baseline} --checkpoint {in}",
    "baseline diff then": "baseline diff {in}.parquet {baseline}",
    "baseline diff now": "baseline diff {baseline} {in}.parquet",
    "gate run": "gate {in}",
    "gate baseline": "gate {run} --baseline {in}.parquet",
    "merge runs": "merge {in} {part} --out {new}",
    "merge baseline": "merge {part} --out {new} --baseline {in}.parquet",
    "ledger file": "ledger {in}",
    "bisect suite": "bisect {in}.yaml {onnx} --good {onnx} --bad {onnx} --policy go1-parkour",
    "bisect checkpoints": "bisect {suite} {in} --good {onnx} --bad {onnx} --policy go1-parkour",
    "bisect good": "bisect {suite} {onnx} --good {in} --bad {onnx} --policy go1-parkour",
    "bisect bad": "bisect {suite} {onnx} --good {onnx} --bad {in} --policy go1-parkour",
    "bisect policy": "bisect {suite} {onnx} --good {onnx} --bad {onnx} --policy {in}.yaml",
    "watch folder": "watch {in} --suite {suite} --policy go1-parkour --once",
    "watch suite": "watch {folder} --suite {in}.yaml --once",
    "watch policy": "watch {folder} --suite {suite} --policy {in}.yaml --once",
    "report runs": "report {in}",
    "compare runs": "compare {run} {in}",
    "sweep suite": "sweep {in}.yaml --axis friction=0.5,1",
    "sweep policy": "sweep {suite} --axis friction=0.5,1 --policy {in}.yaml",
    "sweep baseline": "sweep {suite} --axis friction=0.5,1 --baseline {in}.yaml",
    "limits ladders": "limits {place} --policy stand",
    "limits policy": "limits stairs/up --policy {in}.yaml",
    "limits baseline": "limits stairs/up --policy stand --baseline {in}.yaml",
    "limits checkpoint": "limits stairs/up --policy go1-parkour --checkpoint {in}",
    "sim2real real": "sim2real {in} {run}",
    "sim2real runs": "sim2real {in} {in}",
    "replay log": "replay {in}.mcap",
    "scores log": "scores {in}.mcap",
    "replay policy": "replay {log} --policy {in}.yaml",
    "replay checkpoint": "replay {log} --policy go1-parkour --checkpoint {in}",
    "view source": "view {in}",
    "view baseline": "view {run} --baseline {in}",
    "view policy": "view {log} --policy {in}.yaml",
    "view scene": "view go1-parkour --scene {place}",
    "view checkpoint": "view go1-parkour --checkpoint {in}",
    "verify run": "verify {in}",
    "verify policy": "verify {run} --policy {in}.yaml",
    "verify checkpoint": "verify {run} --checkpoint {in}",
    "attribute run": "attribute {in} --baseline stand",
    "attribute baseline": "attribute {run} --baseline {in}.yaml",
    "attribute policy": "attribute {run} --baseline stand --policy {in}.yaml",
    "attribute checkpoint": "attribute {run} --baseline go1-parkour --checkpoint {in}",
    "train teacher config": "train teacher {in}.yaml",
    "train teacher resume": "train teacher --resume {in}",
    "train student config": "train student {in}.yaml",
    "train student resume": "train student --resume {in}",
    "train export folder": "train export {in} --out {new}",
    "study single-scene config": "study single-scene {in}.yaml",
    "study multi-scene config": "study multi-scene {in}.yaml",
    "study observations config": "study observations {in}.yaml",
    "study single-scene resume": "study single-scene --resume {in}",
    "study multi-scene resume": "study multi-scene --resume {in}",
    "study observations resume": "study observations --resume {in}",
    "twin build photographs": "twin build {in}.mp4 --out {new}",
    "twin calibrate photographs": "twin calibrate {in}.mp4 --out {new}",
    "twin reconstruct scene": "twin reconstruct {place}",
    "twin align scene": "twin align {place}",
    "twin splat scene": "twin splat {place}",
    "twin place scene": "twin place {place}",
    "twin ablate scene": "twin ablate {place}",
    "twin label scene": "twin label {place}",
    "policies show policy": "policies show {in}.yaml",
    "policies show checkpoint": "policies show go1-parkour --checkpoint {in}",
    "policies check policy": "policies check {in}.yaml",
    "policies check checkpoint": "policies check go1-parkour --checkpoint {in}",
    "policies check scene": "policies check go1-parkour --scene {place}",
    "policies init checkpoint": "policies init {in}.onnx --robot go1",
    "policies fold checkpoint": "policies fold {in}.onnx --out {new}",
    "policies serve policy": "policies serve {in}.yaml",
    "policies serve checkpoint": "policies serve go1-parkour --checkpoint {in}",
    "robots show robot": "robots show {robot}",
    "robots check robot": "robots check {robot} --out {new}",
    "robots init model": "robots init {in}.xml",
    "scenes list patterns": "scenes list {place}",
    "scenes ladders ladders": "scenes ladders {place}",
    "scenes show scene": "scenes show {place}",
    "scenes check scenes": "scenes check {place}",
    "scenes check policy": "scenes check flat/carpet_room --out {new}.yaml --policy {in}.yaml",
    "scenes render patterns": "scenes render {place} --out {new}",
    "scenes fetch file": "scenes fetch real:stairs --file {in}",
    "scenes import scan": "scenes import {in}.ply --out {new}",
    "scenes import splat": "scenes import {scan} --out {new} --splat {in}.ply",
    "scenes import splat_transform": (
        "scenes import {scan} --out {new} --splat {splat} --splat-transform {in}"
    ),
    "scenes level scene": "scenes level {place} --flip",
    "scenes push scene": "scenes push {place} hub:some/place",
    "sensors policy": "sensors {in}.yaml --out {new}",
    "sensors scene": "sensors go1-parkour --scene {place} --out {new}",
    "splat info source": "splat info {in}.ply",
    "splat convert source": "splat convert {in}.ply --out {new}.ply",
    "splat render source": "splat render {in}.ply --out {new}.png",
    "warmup scenes": "warmup {place}",
}
"""What reads a path, by verb and option; `place` is a folder whose scene.yaml is a pipe."""

WORDS = {
    "ledger head",
    *("scenes", "robot", "memory_limit", "shard", "address", "track", "json", "name", "note"),
    *("axis", "trial", "trials", "root", "layout", "host", "to", "takeover", "suite"),
    *("score", "topic", "length", "label", "title"),
    *("licence", "held_out", "pattern", "floor", "trail"),
    *("policies fetch policy", "robots fetch robot", "scenes fetch scenes"),
}
"""Options, or verbs and options, that are words and no paths."""


def paths():
    """Yield each verb's options that are text or a path."""
    for name, form in forms():
        hints = typing.get_type_hints(form, include_extras=True)
        for field in fields(form):
            if "Literal" not in str(hints[field.name]) and any(
                kind in parts(hints[field.name]) for kind in (str, Path)
            ):
                yield f"{name} {field.name}"


def parts(hint):
    inner = [one for arm in typing.get_args(hint) for one in parts(arm)]
    return [hint, *inner] if isinstance(hint, type) else inner


def test_every_path_of_every_verb_is_in_a_table():
    known = {*FILES, *APPENDED, *FOLDERS, *UNTRIED, *READ}
    found = set(paths())
    new = {one for one in found - known - WORDS if one.rpartition(" ")[2] not in WORDS}
    assert new == set(), "put what is new into a table"
    assert known - found == set(), "these are no options any more"


ONCE = {"policies init out", "policies fold out", "scenes check out"}
"""What writes no file that is there already."""
SLOW = {
    *("plan out", "replay picture", "replay video", "replay out", "attribute out", "run comment"),
    *("scenes render out", "sensors out", "scenes check out", "merge comment", "compare picture"),
    *(
        "robots check out",
        "train teacher out",
        "train student out",
        "bisect out",
        "twin label out",
        "attribute out",
    ),
}
"""Verbs of some seconds, which are tried at night."""
OFTEN = {
    *("schema out", "report out", "gate junit", "splat convert out", "policies init out"),
    *("twin calibrate photographs", "twin label scene", "policies init checkpoint"),
    *("policies fold checkpoint", "scenes show scene", "scenes check scenes", "sensors scene"),
    *("splat info source", "check suite", "run policy", "report runs", "replay log"),
}
"""What is tried each time; of the others a device, and the rest at night."""
KINDS = ("device", "pipe", "link", "dangling", "folder")


def when(option, *, is_first):
    is_daily = option in OFTEN or (is_first and option not in SLOW)
    return () if is_daily else pytest.mark.nightly


def each(table, *, is_first):
    return [pytest.param(one, marks=when(one, is_first=is_first)) for one in table]


@pytest.fixture(scope="module")
def things(regressed_run, tmp_path_factory):
    """Return what commands name: runs, a part of one, a log, a network, Gaussians."""
    import numpy as np

    from nw_splat.files import write_splat
    from nw_splat.gaussians import Gaussians

    folder = tmp_path_factory.mktemp("things")
    suite, part = regressed_run.parent / "suite.yaml", folder / "part"
    ends("run", suite, "--shard", "1/1", "--out", part, "--workers", "1")
    shutil.copytree(regressed_run, folder / "again")
    onnx = shutil.copy(Path("policies/go1-parkour/policy.onnx").resolve(), folder / "net.onnx")
    rng = np.random.default_rng(0)
    gaussians = Gaussians(
        means=rng.normal(size=(50, 3)).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (50, 1)),
        log_scales=np.full((50, 3), -3, np.float32),
        opacity_logits=np.zeros(50, np.float32),
        sh=np.zeros((50, 1, 3), np.float32),
    )
    write_splat(folder / "some.ply", gaussians)
    (folder / "place").mkdir()
    os.mkfifo(folder / "place" / "scene.yaml")
    (folder / "folder").mkdir()
    _a_scene_of_a_mesh(folder / "mesh")
    (folder / "robot").mkdir()
    os.mkfifo(folder / "robot" / "robot.yaml")
    (folder / "table.xml").write_text("<mujoco><worldbody/></mujoco>")
    [log, *_] = sorted((regressed_run / "mcap").rglob("*.mcap"))
    return {
        "suite": suite,
        "run": regressed_run,
        "part": part,
        "again": folder / "again",
        "log": log,
        "onnx": onnx,
        "splat": folder / "some.ply",
        "place": folder / "place",
        "mesh": folder / "mesh",
        "scan": folder / "mesh" / "collision.ply",
        "robot": f"{folder / 'robot'}/",
        "model": folder / "table.xml",
        "folder": folder / "folder",
        "baseline": "hurdles/go1-act-rgb",
        "missing": "missing.yaml",
    }


def _a_scene_of_a_mesh(folder):
    import trimesh

    folder.mkdir()
    trimesh.creation.box((6.0, 3.0, 0.2)).export(folder / "collision.ply")
    (folder / "scene.yaml").write_text(
        "nw-scene: 1\nname: mesh\ntask: open\nlicence: MIT\ncollision: collision.ply\n"
        "trail: [[1.5, 0, 0.1]]\n"
    )


def typed(command, things, folder, **paths):
    return [
        word.format(**things, new=folder / "new", **paths) if "{" in word else word
        for word in command.split()
    ]


def node(kind, path):
    """Make what a kind is at a path, and return what reads it."""
    if kind == "device":
        try:
            os.mknod(path, 0o666 | 0o020000, os.makedev(1, 3))
            path.open("wb").close()
        except OSError:
            pytest.skip("this system lets nobody here make or open a device")
    elif kind == "pipe":
        os.mkfifo(path)
        read = []
        reader = threading.Thread(target=lambda: read.append(path.read_bytes()), daemon=True)
        reader.start()
        return lambda: (reader.join(), read[0])[1]
    elif kind == "folder":
        path.mkdir()
    else:
        target = path.parent / "far" / "target"
        target.parent.mkdir()
        if kind == "link":
            target.write_bytes(b"old")
        path.symlink_to(target)
    return lambda: b""


@pytest.mark.parametrize(
    ("option", "kind"),
    [
        pytest.param(option, kind, marks=when(option, is_first=kind == "device"))
        for option in FILES
        for kind in KINDS
    ],
)
def test_an_output_stays_what_it_is_and_gets_what_is_written(
    option, kind, things, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (place := tmp_path / "place").mkdir()
    [word] = [word for word in FILES[option].split() if "{out}" in word]
    path = Path(word.format(out=place / "out"))
    reads = node(kind, path)
    before = path.lstat()
    code = ends(*typed(FILES[option], things, tmp_path, out=place / "out"))
    said = capsys.readouterr().err
    after = path.lstat()
    assert (after.st_mode, after.st_ino, after.st_rdev) == (
        before.st_mode,
        before.st_ino,
        before.st_rdev,
    ), said
    target = place / "far" / "target"
    if kind == "folder":
        assert (code, list(path.iterdir())) == (2, [])
        assert f"cannot write {path}: it is a folder" in said
    elif kind == "link" and option in ONCE:
        assert (code, target.read_bytes()) == (2, b"old")
    else:
        assert "cannot write" not in said
        assert "warning: no" not in said
        beside = {one.name for one in place.iterdir()} - {path.name, "far"}
        assert not beside or (kind in {"link", "dangling"} and option in {"report out", "gate out"})
        if kind == "pipe":
            assert len(reads()) > 10
        elif kind in {"link", "dangling"}:
            assert target.stat().st_size > 10
            assert not target.is_symlink()


@pytest.mark.parametrize("option", APPENDED)
def test_a_ledger_is_a_file_and_nothing_else_becomes_one(
    option, things, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "ledger"
    os.mkfifo(path)
    ends(*typed(APPENDED[option], things, tmp_path, out=path))
    found = capsys.readouterr().err
    assert re.search(f"cannot write {path}: it is (no|not a) regular file", found)
    assert path.is_fifo()


@pytest.mark.parametrize("option", each(FOLDERS, is_first=True))
def test_no_folder_takes_the_place_of_anything_else(option, things, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "out"
    os.mkfifo(path)
    assert ends(*typed(FOLDERS[option], things, tmp_path, out=path)) in {2, 4}
    assert path.is_fifo()
    [*_, said] = capsys.readouterr().err.splitlines()
    assert said.startswith("error: ")


@pytest.mark.timeout(60)
@pytest.mark.parametrize("option", each(READ, is_first=False))
def test_nothing_waits_for_a_pipe_that_is_named_as_a_file(
    option, things, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for suffix in ("", ".yaml", ".parquet", ".mcap", ".onnx", ".ply", ".mp4", ".xml"):
        os.mkfifo(tmp_path / f"in{suffix}")
    code = ends(*typed(READ[option], things, tmp_path, **{"in": tmp_path / "in"}))
    assert code in {2, 4}
    assert "unforeseen" not in capsys.readouterr().err
