"""The pages on scenes name what the readers read: every key with its default, format and bound."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nw_scenes import limits
from nw_scenes.limits import checked_name
from nw_scenes.mesh_file import MESH_SUFFIXES
from nw_scenes.neverwhere.scan import _SIZES
from nw_sim.catalogue import get_scene
from nw_splat import files as splat_files

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("how-to/published-scenes.md", "reference/scene.md", "reference/meshes-and-splats.md")
TEXT = "\n".join((DOCS / page).read_text(encoding="utf-8") for page in PAGES)
PROSE = " ".join(TEXT.split())


def table(heading: str) -> list[list[str]]:
    """The rows of the table whose first column has this heading, as cells."""
    (rows,) = re.findall(
        rf"^\| {re.escape(heading)} \|.*\n\|[-|:]+\n((?:\|.*\n)+)", TEXT, re.MULTILINE
    )
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows.splitlines()]


def test_its_bounds_are_those_of_the_readers() -> None:
    assert f"1 to {limits.WAYPOINTS}" in PROSE
    assert f"Up to {limits.MESH_BYTES // 10**6} MB and {limits.MESH_FACES:,} faces" in PROSE
    four, longest = "/".join(["a"] * 4), "a" * 120
    assert (checked_name(four), checked_name(longest)) == (four, longest)
    for name in (f"{four}/a", f"{longest}a", "a b"):
        with pytest.raises(ValueError, match="not a valid scene name"):
            checked_name(name)
    assert "up to four words" in PROSE
    assert "120 characters" in PROSE


def test_it_names_the_files_and_the_solids_that_are_read() -> None:
    for suffix in MESH_SUFFIXES:
        assert f"`{suffix}`" in PROSE
    for kind in ("plane", *_SIZES):
        assert kind in PROSE.split("and geoms:")[1].split(". ")[0]
    formats = [each.suffix for each in splat_files.FORMATS.values()]
    assert formats == [row[0].strip("`") for row in table("file")]


def test_its_boxes_are_a_place(tmp_path: Path) -> None:
    (boxes,) = re.findall(r"^```yaml\n(boxes:.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    (tmp_path / "collision.yaml").write_text(boxes)
    (tmp_path / "scene.yaml").write_text(
        "{nw-scene: 1, name: boxes, task: hurdles, licence: MIT, trail: [[2.5, 0, 0.1]]}"
    )
    assert len(get_scene(tmp_path).solids) == 2


def test_its_xml_has_the_trail_and_the_solids_that_it_names(tmp_path: Path) -> None:
    (xml,) = re.findall(r"^```xml (?:\S+)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    file = tmp_path / "stepping.xml"
    file.write_text(xml)
    scene = get_scene(f"neverwhere:{file}")
    assert len(scene.solids) == 2
    assert scene.trail.tolist() == [[2.0, 0.0, 0.1], [3.4, 0.0, 0.1]]
    assert scene.splat is None
