"""Pictures are opened by one function, as one of a few kinds: a photograph starts no program."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
from PIL import Image, UnidentifiedImageError

import nw_eval
from nw_base.files.pictures import FORMATS, open_picture

HARNESS = Path(nw_eval.__file__).parents[1]
FOUND = Path(__file__).parents[3].parent / "shared" / "assets" / "found" / "force" / "eps_photos"

EPS = b"""%!PS-Adobe-3.0 EPSF-3.0
%%BoundingBox: 0 0 64 48
%%EndComments
(owned) =
showpage
"""


def written(kind: str) -> bytes:
    pillow_heif.register_heif_opener()
    file = BytesIO()
    Image.fromarray(np.full((6, 8, 3), 99, np.uint8)).save(file, kind)
    return file.getvalue()


@pytest.mark.parametrize("kind", FORMATS)
def test_photographs_of_each_kind_are_opened_whatever_they_are_called(
    kind: str, tmp_path: Path
) -> None:
    (tmp_path / "a.txt").write_bytes(written(kind))
    with open_picture(tmp_path / "a.txt") as image:
        assert (image.format, image.size) == (kind, (8, 6))
        assert np.allclose(np.asarray(image.convert("RGB")), 99, atol=3)


def test_a_cameras_jpeg_of_two_pictures_is_one() -> None:
    file = BytesIO()
    two = [Image.new("RGB", (8, 6), colour) for colour in ("red", "blue")]
    two[0].save(file, "MPO", save_all=True, append_images=two[1:])
    with open_picture(file) as image:
        assert (image.format, image.size) == ("MPO", (8, 6))


@pytest.mark.parametrize("data", [EPS, written("GIF"), written("PPM"), written("PDF"), b""])
def test_other_kinds_are_not_tried(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(UnidentifiedImageError):
        open_picture(tmp_path / "a.jpg")


def build(photographs: Path, tmp_path: Path) -> tuple[str, Path]:
    """Have a twin built where a Ghostscript would leave a note of its start."""
    note = tmp_path / "started"
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "gs"
    program.write_text(f"#!/bin/sh\ntouch '{note}'\n")
    program.chmod(0o755)
    command = [sys.executable, "-m", "nw_eval", "twin", "build", photographs]
    done = subprocess.run(
        [*command, "--out", tmp_path / "twin"],
        env={**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    return done.stderr, note


def test_photographs_that_are_postscript_start_no_program_and_are_named(tmp_path: Path) -> None:
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    for name in ("IMG_0.jpg", "IMG_1.jpg", "IMG_2.heic", "IMG_3.HEIC"):
        (photographs / name).write_bytes(EPS)
    said, note = build(photographs, tmp_path)
    assert "cannot be read: IMG_0.jpg, IMG_1.jpg, IMG_2.heic, IMG_3.HEIC" in said
    assert "no JPEG, PNG, TIFF, BMP, WebP, AVIF or HEIC, or damaged" in said
    assert not note.exists()


@pytest.mark.assets
@pytest.mark.skipif(not FOUND.is_dir(), reason="the third-party files are not here")
def test_the_photographs_that_started_ghostscript_are_refused_by_name(tmp_path: Path) -> None:
    said, note = build(FOUND, tmp_path)
    assert "cannot be read: IMG_0.jpg, IMG_1.jpg, IMG_2.jpg, IMG_3.jpg" in said
    assert not note.exists()


def calls_of_image_open(tree: ast.AST) -> list[int]:
    """Lines on which Pillow's own `open` is called or handed on, however it was imported."""
    names, modules = set[str](), {"PIL.Image"}
    lines: list[int] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "PIL":
            modules |= {each.asname or each.name for each in node.names if each.name == "Image"}
        elif isinstance(node, ast.ImportFrom) and node.module == "PIL.Image":
            names |= {each.asname or each.name for each in node.names if each.name == "open"}
        elif isinstance(node, ast.Import):
            modules |= {each.asname for each in node.names if each.name == "PIL.Image"} - {None}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr == "open":
            lines += [node.lineno] if ast.unparse(node.value) in modules else []
        elif isinstance(node, ast.Name) and node.id in names:
            lines.append(node.lineno)
    return lines


def test_nobody_else_opens_pictures() -> None:
    found = {
        path.relative_to(HARNESS).as_posix(): lines
        for path in HARNESS.rglob("*.py")
        if (lines := calls_of_image_open(ast.parse(path.read_text(encoding="utf-8"))))
    }
    assert found.keys() == {"nw_base/files/pictures.py"}


@pytest.mark.parametrize(
    "code",
    [
        "from PIL import Image\nImage.open(p)",
        "from PIL import Image as I\nwith I.open(p) as i: pass",
        "import PIL.Image\nPIL.Image.open(p)",
        "import PIL.Image as I\nI.open(p)",
        "from PIL.Image import open as o\no(p)",
        "def f():\n    from PIL import Image\n    return map(Image.open, p)",
    ],
)
def test_however_it_is_imported_it_is_found(code: str) -> None:
    assert calls_of_image_open(ast.parse(code))
