"""Splats of built-in scenes are built beside other things, and are what one process builds."""

import sys
from pathlib import Path

import pytest

from nw_eval.catalogue import open_scene
from nw_eval.engine.building import SplatBuilders

NAMES = ("hurdles/one_low_carpet", "hurdles/three_low")


class Heard:
    def __init__(self):
        self.shares = {}

    def scene(self, name, fraction):
        self.shares.setdefault(name, []).append(fraction)


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))


def scenes():
    return [open_scene(name) for name in NAMES]


@pytest.mark.nightly
@pytest.mark.usefixtures("empty_cache")
def test_two_processes_write_what_one_writes():
    heard = Heard()
    with SplatBuilders(scenes(), count=2, listener=heard) as builders:
        builders.wait()
    built = [scene.splat.path.read_bytes() for scene in scenes()]
    assert {name: shares[-1] for name, shares in heard.shares.items()} == dict.fromkeys(NAMES, 1.0)
    for scene, bits in zip(scenes(), built, strict=True):
        scene.splat.path.unlink()
        assert scene.splat_store().read_bytes() == bits


@pytest.mark.usefixtures("empty_cache")
def test_what_their_processes_do_not_build_is_left_to_others(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    heard = Heard()
    with SplatBuilders(scenes(), count=2, listener=heard) as builders:
        builders.wait()
    assert not heard.shares
    assert not any(scene.splat.path.exists() for scene in scenes())


@pytest.mark.usefixtures("empty_cache")
def test_their_end_is_not_waited_for_when_nobody_needs_them_any_more():
    with SplatBuilders(scenes(), count=2) as builders:
        processes = builders._processes
        assert [process.poll() for process in processes] == [None, None]
    assert all(process.returncode is not None for process in processes)


def test_no_process_is_started_where_nothing_is_missing(monkeypatch):
    monkeypatch.setattr("nw_eval.built_in.entry.BuiltInSplat.path", Path(__file__))
    with SplatBuilders(scenes(), count=2) as builders:
        assert not builders._processes
