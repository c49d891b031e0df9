"""The cache: sealed files, private folders, and disks that are full, read-only or gone."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import StoreError
from nw_base.files import cache
from nw_base.files.cache import (
    DamagedError,
    atomic_path,
    cache_dir,
    private_dir,
    read_sealed,
    sealed_path,
)

CONTENT = bytes(range(256)) * 20


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "own"))
    return tmp_path / "own"


@pytest.fixture
def sealed(own):
    path = own / "file"
    with sealed_path(path) as temporary:
        temporary.write_bytes(CONTENT)
    return path


def test_a_sealed_file_gives_what_was_written(sealed):
    assert read_sealed(sealed) == CONTENT
    assert read_sealed(sealed).readonly
    with sealed_path(sealed) as temporary:
        temporary.write_bytes(b"")
    assert read_sealed(sealed) == b""


def test_no_bit_of_it_may_change_and_no_end_be_missing(sealed):
    whole = sealed.read_bytes()
    rng = np.random.default_rng(0)
    for bit in rng.choice(8 * len(whole), size=300, replace=False):
        data = bytearray(whole)
        data[bit // 8] ^= 1 << (bit % 8)
        sealed.write_bytes(data)
        with pytest.raises(DamagedError):
            read_sealed(sealed)
    for size in [0, 1, 47, 48, 49, *rng.integers(len(whole), size=50)]:
        sealed.write_bytes(whole[:size])
        with pytest.raises(DamagedError):
            read_sealed(sealed)
    for data in (b"x" * 10_000, whole + b"x", whole + whole[-48:], CONTENT):
        sealed.write_bytes(data)
        with pytest.raises(DamagedError):
            read_sealed(sealed)
    sealed.write_bytes(whole)
    assert read_sealed(sealed) == CONTENT


def test_a_file_that_rots_between_two_processes_is_seen(sealed):
    code = (
        "import sys; from pathlib import Path; from nw_base.files.cache import read_sealed;"
        "print(len(read_sealed(Path(sys.argv[1]))))"
    )

    def read():
        return subprocess.run(
            [sys.executable, "-c", code, sealed], capture_output=True, text=True, check=False
        )

    assert read().stdout == f"{len(CONTENT)}\n"
    facts = sealed.stat()
    data = bytearray(sealed.read_bytes())
    data[77] ^= 4
    with sealed.open("r+b") as file:
        file.write(data)
    # A disk that rots tells nobody: size, times and inode are as before.
    os.utime(sealed, ns=(facts.st_atime_ns, facts.st_mtime_ns))
    assert "DamagedError" in read().stderr


def test_what_cannot_be_written_leaves_nothing_behind(own):
    with pytest.raises(StoreError, match=r"No space left.*NW_EVAL_CACHE"), atomic_path(own / "a"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def stop_halfway():
        with sealed_path(own / "a") as temporary:
            temporary.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_halfway()
    assert list(own.iterdir()) == []


def test_a_full_disk_is_an_error_that_names_the_folder_and_the_way_out(own, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(cache.os, "fsync", full)
    with pytest.raises(StoreError) as caught, sealed_path(own / "scenes" / "a.splat") as temporary:
        temporary.write_bytes(CONTENT)
    text = str(caught.value)
    assert text.startswith(f"cannot write {own / 'scenes' / 'a.splat'}: No space left on device; ")
    assert f"free space in {own}, or set NW_EVAL_CACHE" in text
    assert caught.value.exit_code == 4
    assert list((own / "scenes").iterdir()) == []


def test_results_outside_of_the_cache_are_told_about_out(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(StoreError, match=r"cannot write .*report\.md: File exists.*--out"),
        atomic_path(tmp_path / "file" / "report.md"),
    ):
        pass


def test_a_cache_that_cannot_be_made_is_an_error_of_ours(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "file"))
    for make in (cache_dir, private_dir):
        with pytest.raises(StoreError, match=r"file.*; free space in .*or set NW_EVAL_CACHE"):
            make("scenes", "terrain")


def test_a_cache_that_vanishes_comes_back(own):
    folder = cache_dir("scenes")
    folder.rmdir()
    own.rmdir()
    with sealed_path(folder / "a") as temporary:
        temporary.write_bytes(b"1")
    assert read_sealed(folder / "a") == b"1"


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch):
    def homeless():
        raise RuntimeError

    monkeypatch.delenv("NW_EVAL_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache.Path, "home", homeless)
    with pytest.raises(StoreError, match=r"no home folder .*; set NW_EVAL_CACHE"):
        cache_dir("scenes")


def test_a_private_folder_is_made_private_and_stays_so(own):
    folder = private_dir("kernels")
    assert folder == own / "kernels"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert private_dir("kernels") == folder


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777, 0o1777])
def test_a_folder_that_others_may_write_is_refused(mode):
    private_dir("kernels").chmod(mode)
    with pytest.raises(StoreError, match=r"kernels may be written by others; remove it, or set"):
        private_dir("kernels")


def test_a_link_is_refused_wherever_it_leads(own, tmp_path):
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    own.mkdir()
    (own / "kernels").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match="kernels is a link or no folder"):
        private_dir("kernels")


def test_another_users_folder_is_refused(monkeypatch):
    private_dir("kernels")
    monkeypatch.setattr(cache.os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(StoreError, match=r"belongs to user \d+, not to \d+"):
        private_dir("kernels")


def test_a_folder_that_everybody_may_exchange_is_refused(own):
    private_dir("kernels")
    own.chmod(0o777)
    with pytest.raises(StoreError, match="where any user may replace it"):
        private_dir("kernels")
    own.chmod(0o1777)  # As /tmp: everybody may add, nobody may exchange.
    assert private_dir("kernels") == own / "kernels"


def test_two_processes_may_write_the_same_file_at_once(own):
    code = (
        "import sys; from pathlib import Path\n"
        "from nw_base.files.cache import read_sealed, sealed_path\n"
        "file, content = Path(sys.argv[1]), sys.argv[2].encode() * 99999\n"
        "for _ in range(40):\n"
        "    with sealed_path(file) as path: path.write_bytes(content)\n"
        "    assert len(set(bytes(read_sealed(file)))) == 1\n"
    )
    path = own / "file"
    both = [subprocess.Popen([sys.executable, "-c", code, path, word]) for word in "ab"]
    assert [process.wait() for process in both] == [0, 0]
    assert [path.name for path in own.iterdir()] == ["file"]


def test_a_name_as_long_as_names_get_can_be_written(own):
    path = Path(own, "n" * 250)
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"1")
    assert path.read_bytes() == b"1"


def test_a_variable_that_is_empty_is_as_good_as_unset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NW_EVAL_CACHE", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert cache_dir("splats") == tmp_path / "caches" / "nw-eval" / "splats"
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_dir() == tmp_path / "home" / ".cache" / "nw-eval"
    assert {one.name for one in tmp_path.iterdir()} <= {"caches", "home"}


@pytest.mark.parametrize("name", ["NW_EVAL_CACHE_GB", "NW_EVAL_KERNELS"])
def test_other_variables_that_are_empty_are_as_good_as_unset_too(tmp_path, name):
    code = (
        "from nw_eval.engine.cache import *; from nw_base.machine_code import *; "
        "import nw_eval.engine.cache as s, nw_base.machine_code as k; "
        "print(s.limit_bytes(), bool(k.folder_note()))"
    )
    environment = {**os.environ, "NW_EVAL_CACHE": str(tmp_path)}
    environment.pop(name, None)
    said = [
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
            env={**environment, **more},
        ).stdout
        for more in ({}, {name: ""})
    ]
    assert said[0] == said[1]
