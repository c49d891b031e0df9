"""Joining a cluster: what is wrong is said in one line, before anything is written."""

import socket
import sys

import pytest

from nw_base.errors import PrerequisiteError, UsageError
from nw_eval import api


def test_without_ray_the_extra_is_named(tiny, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(PrerequisiteError, match=r"pip install 'nw-eval\[ray\]'"):
        api.run(tiny, engine="ray", out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_that_nobody_answers_is_an_error_of_one_line(scheme, tiny, tmp_path):
    pytest.importorskip("ray", reason="the extra `ray` is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # And listens to nobody.
        address = f"{scheme}127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UsageError, match="no Ray cluster can be used at") as raised:
            api.run(tiny, engine="ray", address=address, out=tmp_path / "run")
    assert address in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": "auto"}, "add --engine ray"),
        ({"engine": "rya"}, "did you mean 'ray'"),
        ({"engine": "ray", "in_process": True}, "drop one of them"),
        ({"engine": "ray", "address": "http://a:1"}, "is not an address of a Ray cluster"),
    ],
)
def test_what_no_engine_can_do_is_refused(options, message, tiny, tmp_path):
    if "in_process" not in options:
        pytest.importorskip("ray", reason="the extra `ray` is not installed")
    with pytest.raises(UsageError, match=message):
        api.run(tiny, out=tmp_path / "run", **options)
