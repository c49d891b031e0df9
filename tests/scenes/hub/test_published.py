"""Scenes of the published release come as zips, of which what is read is unpacked and no more."""

from __future__ import annotations

import importlib.util
import io
import stat
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_eval import api
from nw_scenes.hub import limits
from nw_sim import catalogue

NAME = "hurdle_stata_v1"
REFERENCE = f"neverwhere:{NAME}"
XML = """\
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <geom type="box" pos="2 0 0.05" size="0.1 1.0 0.05"/>
    <body name="waypoint-0" pos="2 0 0.1"/>
  </worldbody>
</mujoco>
"""


def zipped(members):
    """The bytes of a zip; keys are names, or what zipfile knows of a member."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return out.getvalue()


GOOD = {
    f"nw-go1-{NAME}.xml": XML,
    "geometry/visual_mesh_simplified.obj": "v 0 0 0\n",
    "geometry/pcd_colmap.ply": "x" * 1000,
    "3dgs/model.ply": "ply\n",
    "3dgs/ckpts/ckpt_29999_rank0.pt": "x" * 1000,
    "colmap/database.db": "x" * 1000,
    "images/0000.png": "x" * 1000,
}


@pytest.fixture
def release(hub):
    def publish(members=GOOD):
        archive = zipped(members) if isinstance(members, dict) else members
        other = b"x" * 100
        files = {f"scenes/{NAME}.zip": archive, "scenes/other.zip": other, "README.md": other}
        return hub.add("datasets", "ziyc/neverwhere", files)

    return publish


def test_a_scene_is_fetched_by_its_name_and_of_its_zip_what_is_read(hub, release):
    release()
    fetched = api.fetch_scene(REFERENCE)
    assert sorted(fetched.files) == [
        "3dgs/model.ply", "geometry/visual_mesh_simplified.obj", f"nw-go1-{NAME}.xml"
    ]  # fmt: skip
    assert hub.transfers()[0].path.endswith(f"/{NAME}.zip")
    assert not [call for call in hub.transfers() if "other" in call.path]
    hub.close()
    assert catalogue.get_scene(REFERENCE).name == f"neverwhere/{NAME}"
    assert catalogue.references([REFERENCE])[0][0] == f"neverwhere:{fetched.folder}"
    assert not list(fetched.folder.parents[1].glob(".parts/*"))


def written_scan(folder):
    """Write a scan as the release's own tool does: the writer of the tests of its reader."""
    path = Path(__file__).parents[2] / "scenes" / "neverwhere" / "conftest.py"
    spec = importlib.util.spec_from_file_location("published_writer", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    vertices, faces = module.plain_mesh()
    return module.Writer(
        folder=folder,
        label=module.random_label(np.random.default_rng(7)),
        normalise=None,
        vertices=vertices,
        faces=faces,
        trail=np.array([[1.7, 0.0, 0.15], [3.0, 0.1, 0.0]]),
    ).write()


def test_a_scan_is_the_same_place_as_if_it_had_been_unpacked_by_hand(release, tmp_path):
    folder = written_scan(tmp_path / "real_scenes" / NAME)
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.*")}
    release({name: path.read_bytes() for name, path in files.items()} | {"images/1.png": b"x"})
    by_hand = catalogue.get_scene(f"neverwhere:{folder}")
    assert catalogue.get_scene(REFERENCE).digest == by_hand.digest
    (checked,) = api.check_scenes([REFERENCE])
    assert [each.code for each in checked.findings if each.severity == "error"] == ["no_splat"]


def test_a_folder_of_that_name_comes_first(hub, tmp_path, monkeypatch):
    (tmp_path / NAME).mkdir()
    (tmp_path / NAME / f"nw-go1-{NAME}.xml").write_text(XML)
    monkeypatch.chdir(tmp_path)
    assert catalogue.get_scene(REFERENCE).name == f"neverwhere/{NAME}"
    assert not hub.calls


def test_a_name_that_the_release_has_not_is_told_with_the_nearest(hub):
    with pytest.raises(SceneError, match=f"neither hub:org/name nor .*; did you mean '{NAME}'"):
        api.fetch_scene("neverwhere:hurdle_stataa_v1")
    assert not hub.calls


def test_a_zip_that_is_not_there(release):
    release()
    with pytest.raises(SceneError, match=r"ziyc/neverwhere does not hold scenes/ramp_geisel\.zip"):
        api.fetch_scene("neverwhere:ramp_geisel")


def link(name):
    member = zipfile.ZipInfo(name)
    member.external_attr = (stat.S_IFLNK | 0o777) << 16
    return member


@pytest.mark.parametrize(
    ("members", "words"),
    [
        (GOOD | {"geometry/../../escaped.obj": "v"}, None),
        (GOOD | {"../escaped.xml": XML}, None),
        (GOOD | {"/escaped.xml": XML}, None),
        (GOOD | {"geometry/..\\escaped.obj": "v"}, "has a backslash"),
        (GOOD | {link("geometry/linked.obj"): "/etc/passwd"}, "not a regular file"),
        ({"geometry/collision_mesh.obj": "v"}, r"holds no XML at its root, .* docs/\S+\.md"),
        (b"PK nothing", "is damaged: .*; fetch it again"),
    ],
)
def test_a_zip_of_a_stranger_leaves_its_folder_nowhere(release, tmp_path, members, words):
    release(members)
    if words is None:  # Not what is read, so nobody looks at it.
        api.fetch_scene(REFERENCE)
    else:
        with pytest.raises(SceneError, match=words):
            api.fetch_scene(REFERENCE)
    escaped = [path for path in tmp_path.rglob("*") if "escaped" in path.name or path.is_symlink()]
    assert not escaped


def test_a_zip_that_grows_is_refused_before_it_does(release, monkeypatch):
    monkeypatch.setattr(limits, "BYTES", 10**6)
    release(GOOD | {"geometry/collision_mesh.obj": "0" * (10**6 + 1)})
    with pytest.raises(SceneError, match="would be unpacked; 1000 files and 1 MB are the limit"):
        api.fetch_scene(REFERENCE)


def test_a_zip_that_says_less_than_it_holds_is_damaged(release):
    content = bytearray(zipped(GOOD | {"geometry/collision_mesh.obj": "0" * 10**6}))
    # The sizes that the directory at the end says of the last member.
    at = content.rindex(b"PK\x01\x02")
    content[at + 24 : at + 28] = (1000).to_bytes(4, "little")
    release(bytes(content))
    with pytest.raises(SceneError, match="is damaged"):
        api.fetch_scene(REFERENCE)
