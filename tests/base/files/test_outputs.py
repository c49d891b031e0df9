"""Outputs: whole or not at all, into devices and pipes as they are, nothing replaced by another."""

from __future__ import annotations

import ast
import errno
import os
import resource
import signal
import socket
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import nw_eval
from nw_base.errors import StoreError, UsageError
from nw_base.files.cache import atomic_path, followed, is_stream, open_own

HARNESS = Path(nw_eval.__file__).parents[1]

ELSEWHERE = {
    "nw_base/confinement/rights.py": "tells the kernel, in /proc",
    "nw_eval/engine/cache.py": "fills a folder of the cache that appears by one rename",
    "nw_eval/engine/known.py": "marks an entry of the cache as used",
    "nw_eval/engine/machine.py": "tells the kernel, in /proc; appends to what `open_own` opened",
    "nw_eval/engine/ray_connection.py": "turns the output of a library away",
    "nw_eval/engine/ray_file_bundles.py": "fills a folder of the cache that appears by one rename",
    "nw_base/files/cache.py": "is the one that writes",
    "nw_base/files/traceback_file.py": "writes what nobody foresaw, perhaps in the one that writes",
    "nw_gate/ledger.py": "appends, under a lock, to what `open_own` opened",
    "nw_scenes/hub/fetch.py": "appends to a partial download, and fills a folder of the cache",
    "nw_scenes/hub/contents.py": "fills a folder of the cache that appears by one rename",
    "nw_scenes/hub/reference.py": "fills a folder of the cache that appears by one rename",
    "nw_learn/curve.py": "appends events as a training goes on",
    "nw_learn/student/trajectory.py": "writes a part file in its own data folder and renames it",
    "nw_base/machine_code/__init__.py": "marks a folder of the cache",
    "nw_policies/folding.py": "runs confined, in a scratch folder, and may not set rights",
    "nw_eval/pytest_plugin/runs.py": "holds a lock, and writes nothing",
    "nw_eval/reporting/github.py": "appends to a file of GitHub's runner",
    "nw_eval/reporting/trackers/mlflow.py": "writes into a temporary folder",
    "nw_gate/results/journal.py": "appends, under a lock, to what `open_own` opened",
    "nw_gate/results/merge.py": "fills a temporary folder that appears by one rename",
    "nw_gate/results/tables.py": "closes a pipe",
    "nw_sim/rollout/mcap/file.py": "writes a partial log as a trial goes on, and renames it",
    "nw_sim/rollout/replaying/film.py": "runs confined, in a scratch folder",
    "nw_sim/rollout/replaying/log_container.py": "runs confined, in a scratch folder",
    "nw_eval/api/robots.py": "fills the folder of `new_folder`",
    "nw_eval/api/cause.py": "writes into a temporary folder",
    "nw_eval/api/surfaces.py": "is given the temporary path by `_writer`",
    "nw_eval/api/evidence.py": "marks a file of the cache as used",
    "nw_eval/cli/process.py": "opens the null device in place of a closed stream",
    "nw_base/confinement/family.py": "opens the null device",
    "nw_scenes/real.py": "fills a folder of the cache that appears by one rename",
    "nw_splat/files/spz.py": "is given the temporary path by `write_splat`",
    "nw_splat/files/gsplat_pt.py": "is given the temporary path by `write_splat`",
    "nw_splat/files/ply.py": "is given the temporary path by `write_splat`",
    "nw_twin/calibrate/calibrate.py": "works in a temporary folder",
    "nw_twin/calibrate/develop.py": "works in a temporary folder",
    "nw_twin/calibrate/photographs.py": "works in a temporary folder",
    "nw_twin/calibrate/exports.py": "works in a temporary folder",
    "nw_twin/calibrate/video.py": "works in a temporary folder",
    "nw_twin/label/published.py": "fills a temporary folder that appears by one rename",
    "nw_twin/label/files.py": "fills a temporary folder, whose files are moved when all fits",
    "nw_twin/scans/converted.py": "runs confined, in a scratch folder",
    "nw_twin/scans/looks.py": "is given the temporary folder by `import_scan`",
    "nw_twin/reconstruct/reconstruct.py": "keeps what a program says, in a working folder",
    "nw_eval/view/live_page.py": "calls `save_played`, which uses `atomic_path`",
    "nw_eval/viewing/recording/track.py": "is given the temporary path by `content.py`",
}
"""Who else opens a file for writing or moves one into place, and why it is not `atomic_path`."""

WRITES = {
    *("write_text", "write_bytes", "savefig", "savez", "savez_compressed", "touch"),
    *("rename", "symlink_to", "hardlink_to", "copyfile", "copytree", "copy2", "move", "link"),
}

GIVES = {"atomic_path", "sealed_path", "new_folder", "BytesIO"}


@pytest.fixture
def device(tmp_path):
    path = tmp_path / "nd"
    try:
        os.mknod(path, 0o666 | 0o020000, os.makedev(1, 3))
        path.write_bytes(b"")
    except OSError:
        pytest.skip("this system lets nobody here make or open a device")
    return path


class Reader(threading.Thread):
    """Reads a pipe to its end."""

    def __init__(self, path):
        super().__init__(daemon=True)
        self.path, self.read = path, b""
        os.mkfifo(path)
        self.start()

    def run(self):
        self.read = self.path.read_bytes()


def write(path, content=b"new"):
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def test_a_device_gets_what_is_written_and_stays_a_device(device):
    before = device.lstat()
    write(followed(device))
    after = device.lstat()
    assert (after.st_ino, after.st_mode, after.st_rdev) == (
        before.st_ino,
        before.st_mode,
        before.st_rdev,
    )


def test_a_device_that_is_full_is_named(tmp_path):
    full = tmp_path / "full"
    try:
        os.mknod(full, 0o666 | 0o020000, os.makedev(1, 7))
        full.open("wb").close()
    except OSError:
        pytest.skip("this system lets nobody here make or open a device")
    with pytest.raises(StoreError, match=r"cannot write .*/full: No space left on device"):
        write(full)


def test_a_pipe_gets_all_of_it_and_stays_a_pipe(tmp_path):
    content = os.urandom(300_000)  # More than a pipe holds.
    reader = Reader(tmp_path / "pipe")
    write(reader.path, content)
    reader.join()
    assert reader.read == content
    assert reader.path.is_fifo()


def test_a_pipe_that_nobody_reads_is_said_and_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr("nw_base.files.cache._READER_COMES", 0.2)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StoreError, match=r"cannot write .*/pipe: no program reads this pipe"):
        write(tmp_path / "pipe")


def test_a_reader_that_leaves_is_said(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)

    def reads_a_little():
        with pipe.open("rb", buffering=0) as stream:
            stream.read(1)

    reader = threading.Thread(target=reads_a_little)
    reader.start()
    with pytest.raises(StoreError, match="Broken pipe"):
        write(pipe, bytes(300_000))  # More than a pipe holds.
    reader.join()


@pytest.mark.parametrize("to", ["/dev/fd/{}", "/proc/self/fd/{}"])
def test_an_open_file_of_the_process_is_written_on(tmp_path, to):
    with (tmp_path / "file").open("wb", buffering=0) as file:
        file.write(b"before ")
        path = Path(to.format(file.fileno()))
        assert is_stream(path)
        write(followed(path))
        file.write(b" after")
    assert (tmp_path / "file").read_bytes() == b"before new after"


def test_standard_output_that_goes_into_a_file_keeps_what_was_printed(tmp_path):
    with (tmp_path / "said").open("wb") as said:
        code = "from nw_eval import cli; print('before'); cli.main(['schema', 'suite', '--out', "
        subprocess.run([sys.executable, "-c", f"{code}'/dev/stdout'])"], stdout=said, check=True)
    said = (tmp_path / "said").read_text()
    assert said.startswith("before\n{")
    assert '"nw-eval"' in said


@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_stays_and_its_target_is_written(tmp_path, is_there):
    (tmp_path / "far").mkdir()
    target, link, second = tmp_path / "far" / "file", tmp_path / "link", tmp_path / "second"
    if is_there:
        target.write_bytes(b"old")
        target.chmod(0o640)
    second.symlink_to("far/file")
    link.symlink_to(second)
    write(followed(link))
    assert link.is_symlink()
    assert second.readlink() == Path("far/file")
    assert target.read_bytes() == b"new"
    assert not target.is_symlink()
    if is_there:
        assert target.stat().st_mode & 0o777 == 0o640


def test_links_of_a_folder_that_may_be_a_strangers_are_not_followed(tmp_path):
    (tmp_path / "mine").write_bytes(b"mine")
    (tmp_path / "report.md").symlink_to(tmp_path / "mine")
    with pytest.raises(StoreError, match="it is a link"):
        write(tmp_path / "report.md")
    with pytest.raises(OSError, match="symbolic links"):
        open_own(tmp_path / "report.md", os.O_RDWR)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="not a regular file"):
        open_own(tmp_path / "pipe", os.O_RDWR)
    assert (tmp_path / "mine").read_bytes() == b"mine"


def unread(path):
    """Return what `lstat` says of `path` but for the time at which it was last read."""
    return [each for at, each in enumerate(path.lstat()) if at != stat.ST_ATIME]


def test_what_cannot_be_a_file_is_refused_by_name_and_stays(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    listening = socket.socket(socket.AF_UNIX)
    here = os.open(tmp_path, os.O_RDONLY)
    listening.bind(f"/proc/self/fd/{here}/socket")  # Paths of sockets must be short.
    for name, kind in (("folder", "a folder"), ("socket", "a socket"), ("a", "a circle")):
        before = unread(tmp_path / name)
        with pytest.raises(UsageError, match=rf"cannot write .*/{name}: .*{kind}"):
            followed(tmp_path / name)
        with pytest.raises(StoreError, match=rf"cannot write .*/{name}: "):
            write(tmp_path / name)
        assert unread(tmp_path / name) == before
    listening.close()
    os.close(here)


def test_a_new_file_has_the_rights_of_the_umask_and_an_old_one_keeps_its_own(tmp_path):
    code = (
        "import os, sys; os.umask(0o027); from pathlib import Path; "
        "from nw_base.files.cache import atomic_path\n"
        "for path in sys.argv[1:]:\n    with atomic_path(Path(path)) as t: t.write_text('new')"
    )
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_text("old")
    old.chmod(0o604)
    subprocess.run([sys.executable, "-c", code, old, new], check=True)
    assert old.stat().st_mode & 0o777 == 0o604
    assert new.stat().st_mode & 0o777 == 0o640
    assert old.read_text() == new.read_text() == "new"


def test_where_there_is_no_room_the_old_file_stays_whole_and_the_path_is_said(tmp_path):
    path = tmp_path / "report.md"
    path.write_bytes(b"old")
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
    try:
        with pytest.raises(StoreError, match=r"cannot write .*/report\.md: File too large"):
            write(path, bytes(20_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.read_bytes() == b"old"
    assert [one.name for one in tmp_path.iterdir()] == ["report.md"]


def mode_of(call):
    """Return the mode that an `open` is given, and whether its flags are for writing."""
    words = [*call.args, *(word.value for word in call.keywords)]
    texts = [word.value for word in words if isinstance(word, ast.Constant)]
    modes = [text for text in texts if isinstance(text, str) and set(text) <= set("rwaxbt+")]
    flags = {
        node.attr for word in words for node in ast.walk(word) if isinstance(node, ast.Attribute)
    }
    writes = {"O_WRONLY", "O_RDWR", "O_CREAT", "O_APPEND", "O_TRUNC"}
    return any(set(mode) & set("wax+") for mode in modes) or bool(flags & writes)


def is_writer(call):
    function = call.func
    name = getattr(function, "attr", getattr(function, "id", ""))
    if name in {"open", "fdopen"}:
        return mode_of(call)
    if name == "replace":  # Of a path: of a text it has two arguments.
        return isinstance(function, ast.Attribute) and len(call.args) == 1 and not call.keywords
    if name == "save":  # Of a picture, a network, a recording.
        return isinstance(function, ast.Attribute) and bool(call.args)
    if name == "move":
        return named(function) == {"shutil"}
    return name in WRITES and isinstance(function, ast.Attribute)


def given(node):
    """Return the names of temporary paths, and of what is in memory, that a module's code has."""
    names = set()
    for each in ast.walk(node):
        if isinstance(each, ast.With):
            for item in each.items:
                value, target = item.context_expr, item.optional_vars
                of_temporary = called(value) == {"open"} and bool(named(value) & names)
                if target is not None and (called(value) & GIVES or of_temporary):
                    names |= named(target)
        elif isinstance(each, ast.Assign) and called(each.value) & GIVES:
            names |= {name for target in each.targets for name in named(target)}
    return names


def named(node):
    return {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}


def called(node):
    return {
        getattr(each.func, "attr", getattr(each.func, "id", ""))
        for each in ast.walk(node)
        if isinstance(each, ast.Call)
    }


def writers_of(path):
    """Return the lines in which a module writes a file that `atomic_path` did not give it."""
    found = []
    for function in ast.walk(ast.parse(path.read_text())):
        if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)):
            names = given(function)
            calls = [call for call in ast.walk(function) if isinstance(call, ast.Call)]
            others = (call for call in calls if is_writer(call) and not named(call) & names)
            found += [f"{call.lineno}: {ast.unparse(call)[:80]}" for call in others]
    return found


@pytest.mark.parametrize(
    ("number", "fix"),
    [
        (errno.ENOSPC, "free disk space or choose another folder with --out"),
        (errno.EACCES, "choose another folder with --out"),
    ],
)
def test_only_a_full_disk_is_answered_by_freeing_it(tmp_path, monkeypatch, number, fix):
    def fails(*_, **__):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("nw_base.files.cache.NamedTemporaryFile", fails)
    monkeypatch.setattr("nw_base.files.cache.TemporaryDirectory", fails)
    with pytest.raises(StoreError) as caught, atomic_path(tmp_path / "report.md"):
        pass
    assert caught.value.fix == fix


def test_nobody_else_opens_a_file_for_writing():
    found = {}
    for path in sorted(HARNESS.rglob("*.py")):
        if lines := writers_of(path):
            found[path.relative_to(HARNESS).as_posix()] = lines
    others = {name: lines for name, lines in found.items() if name not in ELSEWHERE}
    assert others == {}
    assert set(ELSEWHERE) == set(found), "an exception that is none any more"
