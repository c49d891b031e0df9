"""Heights in grey, and GeoTIFF with its own scale, become ground that a robot walks on."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from nw_base.errors import SceneError, UsageError
from nw_scenes.elevation_file import elevation_mesh, read_elevation
from nw_scenes.folder import load_folder
from nw_scenes.rays import RayScene
from nw_sim.catalogue import inspect_scene
from nw_twin.scans.scan import ScanOptions, import_scan

STAIRS = Path(__file__).parents[4] / "shared/assets/photographs/stairs/real_stairs_125cm.png"


def ramp(rows=30, columns=60):
    """Heights, metres: 0 at the left, 0.5 at the right; the upper half is 0.2 m higher."""
    heights = np.broadcast_to(np.linspace(0, 0.5, columns), (rows, columns)).copy()
    heights[: rows // 2] += 0.2
    return heights


def geotiff(path, values, tags=(), **more):
    directory = ImageFileDirectory_v2()
    for tag, kind, value in tags:
        directory.tagtype[tag] = kind
        directory[tag] = value
    Image.fromarray(values).save(path, tiffinfo=directory, **more)


DOUBLES, SHORTS, TEXT = 12, 3, 2
CELL = (33550, DOUBLES, (0.1, 0.1, 0.0))


@pytest.mark.parametrize(("kind", "most"), [(np.uint8, 255), (np.uint16, 65535)])
def test_grey_says_heights_between_black_and_white(tmp_path, kind, most):
    grey = np.round(ramp() / 0.7 * most).astype(kind)
    Image.fromarray(grey).save(tmp_path / "map.png")
    found = read_elevation(tmp_path / "map.png", cell=0.1, white=0.7, black=0.0)
    assert np.abs(found.heights - ramp()).max() < 0.6 * 0.7 / most
    deep = read_elevation(tmp_path / "map.png", cell=0.1, white=-1.0, black=-1.7)
    assert np.allclose(deep.heights, found.heights - 1.7)


def test_a_map_lies_with_north_above_and_a_metre_is_a_metre(tmp_path):
    grey = np.round(ramp() / 0.7 * 65535).astype(np.uint16)
    Image.fromarray(grey).save(tmp_path / "map.png")
    options = ScanOptions(cell=0.1, white=0.7, trail=((0.5, 0.7), (2.0, 0.7), (4.0, 0.7)))
    import_scan(tmp_path / "map.png", tmp_path / "mine", options)
    scene = load_folder(tmp_path / "mine")
    assert np.allclose(np.ptp(scene.static_mesh.vertices[:, :2], axis=0), (5.9, 2.9), atol=1e-5)
    # The upper half of the picture is the far one along y, and 0.2 m higher.
    below, above = RayScene(scene.static_mesh).height(np.array([[2.0, 0.7], [2.0, 2.2]]))
    rise = above - below
    assert rise == pytest.approx(0.2, abs=0.01)
    assert scene.trail[:, 2] == pytest.approx([1.5 / 5.9 * 0.5, 3.5 / 5.9 * 0.5], abs=0.01)
    found = inspect_scene(str(tmp_path / "mine")).findings
    assert [one for one in found if one.severity == "error"] == []


def test_transparent_pixels_and_a_value_of_no_ground_are_holes(tmp_path):
    grey = np.round(ramp() / 0.7 * 255).astype(np.uint8)
    alpha = np.full_like(grey, 255)
    alpha[5:9, 10:14] = 0
    Image.fromarray(np.dstack([grey, grey, grey, alpha])).save(tmp_path / "map.png")
    found = read_elevation(tmp_path / "map.png", cell=0.1, white=0.7)
    assert (np.isnan(found.heights) == (alpha == 0)).all()
    assert found.findings == ("0.9 % of the pixels have no ground, and are holes",)
    vertices, faces = elevation_mesh(found)
    whole = 2 * (grey.shape[0] - 1) * (grey.shape[1] - 1)
    # Of the squares around the hole, those at its corners keep one triangle each.
    assert len(faces) == whole - 2 * 5 * 5 + 4
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0).all()
    black = read_elevation(tmp_path / "map.png", cell=0.1, white=0.7, no_data=0)
    assert np.isnan(black.heights).sum() == 16 + (grey == 0).sum()


def test_a_geotiff_says_its_cells_and_what_is_no_ground(tmp_path):
    values = ramp().astype(np.float32)
    values[3:6, 3:6] = -9999.0
    values[8, 8] = np.nan
    tags = [CELL, (42113, TEXT, "-9999")]
    geotiff(tmp_path / "map.tif", values, tags, compression="tiff_lzw")
    found = read_elevation(tmp_path / "map.tif")
    assert found.cell == (0.1, 0.1)
    assert np.isnan(found.heights).sum() == 10
    assert np.nanmax(np.abs(found.heights - ramp())) < 1e-6


def test_feet_are_metres_and_degrees_are_refused(tmp_path):
    values = ramp().astype(np.float32)
    feet = (34735, SHORTS, (1, 1, 0, 3, 1024, 0, 1, 1, 3076, 0, 1, 9002, 4099, 0, 1, 9003))
    geotiff(tmp_path / "feet.tif", values, [CELL, feet])
    found = read_elevation(tmp_path / "feet.tif")
    assert found.cell == pytest.approx((0.03048, 0.03048))
    assert found.heights.max() == pytest.approx(0.7 * 1200 / 3937)
    degrees = (34735, SHORTS, (1, 1, 0, 1, 1024, 0, 1, 2))
    geotiff(tmp_path / "degrees.tif", values, [CELL, degrees])
    with pytest.raises(SceneError, match=r"cells are degrees.*gdalwarp"):
        read_elevation(tmp_path / "degrees.tif")


BAND = '<GDALMetadata><Item name="S" sample="0" role="{}">{}</Item></GDALMetadata>'


@pytest.mark.parametrize(
    ("role", "said", "factor", "plus"),
    [("scale", "0.01", 0.01, 0), ("offset", "-2", 1, -2), ("unittype", "ft", 0.3048, 0)],
)
def test_scale_offset_and_unit_of_the_band_are_used(tmp_path, role, said, factor, plus):
    values = ramp().astype(np.float32)
    geotiff(tmp_path / "map.tif", values, [CELL, (42112, TEXT, BAND.format(role, said))])
    found = read_elevation(tmp_path / "map.tif")
    assert np.allclose(found.heights, values * factor + plus)
    assert len(found.findings) == 1


@pytest.mark.parametrize(
    ("tags", "why"),
    [
        ([(42112, TEXT, BAND.format("scale", "0"))], "scale of its heights cannot be '0'"),
        ([(42112, TEXT, BAND.format("unittype", "furlong"))], "'furlong', is not known here"),
        (
            [
                (42112, TEXT, BAND.format("unittype", "m")),
                (34735, SHORTS, (1, 1, 0, 1, 4099, 0, 1, 9002)),
            ],
            "EPSG code 9002 by one tag and 9001 by another",
        ),
        ([(34735, SHORTS, (1, 1, 0, 1, 3072, 0, 1, 3857))], "longer than metres on the ground"),
        ([(42112, TEXT, "<!DOCTYPE a><a/>")], "metadata .* are damaged"),
    ],
    ids=["scale", "unit", "units", "mercator", "entities"],
)
def test_heights_and_cells_that_cannot_be_known_are_refused(tmp_path, tags, why):
    geotiff(tmp_path / "map.tif", ramp().astype(np.float32), [CELL, *tags])
    with pytest.raises(SceneError, match=why):
        read_elevation(tmp_path / "map.tif")


def test_pixels_that_a_mask_of_the_file_hides_are_holes(tmp_path):
    values, mask = ramp().astype(np.float32), np.full((30, 60), 255, np.uint8)
    mask[3:6, 3:6] = 0
    pages = []
    for pixels, kind in ((values, 0), (mask, 4), (mask[::2, ::2], 5), (mask, 0)):
        page, directory = Image.fromarray(pixels), ImageFileDirectory_v2()
        directory.tagtype[33550], directory[33550] = DOUBLES, CELL[2]
        directory[254] = kind
        page.encoderinfo = {"tiffinfo": directory}
        pages.append(page)
    pages[0].save(
        tmp_path / "map.tif",
        save_all=True,
        append_images=pages[1:],
        tiffinfo=pages[0].encoderinfo["tiffinfo"],
    )
    found = read_elevation(tmp_path / "map.tif")
    assert (np.isnan(found.heights) == (mask == 0)).all()
    assert "not read: page 4 of the file" in found.findings


def test_every_tag_and_key_is_used_passed_over_or_named(tmp_path):
    values = ramp().astype(np.float32)
    marks = {305: (TEXT, "QGIS"), 270: (TEXT, "a hill"), 33922: (DOUBLES, (0.0,) * 6)}
    keys = {1025: 1, 1026: 0, 3074: 16032, 4097: 0, 4242: 7}
    rows = [number for key, value in sorted(keys.items()) for number in (key, 0, 1, value)]
    geotiff(
        tmp_path / "map.tif",
        values,
        [
            CELL,
            (34735, SHORTS, (1, 1, 0, len(keys), *rows)),
            (65000, SHORTS, (7,)),
            *((tag, *mark) for tag, mark in marks.items()),
        ],
    )
    found = read_elevation(tmp_path / "map.tif")
    assert found.findings == ("not read: tag 65000, geo key 4242",)
    assert np.allclose(found.heights, values)


def test_what_is_no_map_says_why(tmp_path):
    grey = np.zeros((4, 4), np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(np.dstack([grey, grey, grey + 9])).save(tmp_path / "colours.png")
    geotiff(tmp_path / "bare.tif", np.zeros((4, 4), np.float32))
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "photo.tif")
    Image.new("L", (3000, 3000)).save(tmp_path / "large.png")
    (tmp_path / "ps.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n")
    whole = (tmp_path / "grey.png").read_bytes()
    (tmp_path / "short.png").write_bytes(whole[: len(whole) // 2])
    for name, options, error, why in (
        ("grey.png", {}, UsageError, "--cell and --white are missing"),
        ("grey.png", {"cell": 0.1}, UsageError, "--white is missing"),
        ("grey.png", {"cell": -1.0, "white": 1.0}, UsageError, "--cell -1"),
        ("colours.png", {"cell": 0.1, "white": 1.0}, SceneError, "in colours"),
        ("bare.tif", {}, UsageError, "does not say how wide a pixel is"),
        ("bare.tif", {"cell": 0.1, "white": 1.0}, UsageError, "numbers of a TIFF are heights"),
        ("photo.tif", {"cell": 0.1}, SceneError, "3 bands"),
        ("large.png", {"cell": 0.1, "white": 1.0}, SceneError, "9.0 million"),
        ("ps.png", {"cell": 0.1, "white": 1.0}, SceneError, "no elevation map"),
        ("short.png", {"cell": 0.1, "white": 1.0}, SceneError, "short.png: "),
        ("none.png", {"cell": 0.1, "white": 1.0}, SceneError, "No such file"),
    ):
        with pytest.raises(error, match=why):
            read_elevation(tmp_path / name, **options)


@pytest.mark.assets
@pytest.mark.skipif(not STAIRS.exists(), reason="the assets are not here")
def test_real_stairs_of_a_robot_s_map_are_a_scene_without_a_finding(tmp_path):
    trail = ((4.4, 1.3), (2.5, 1.3), (1.2, 1.3))
    options = ScanOptions(cell=0.04, white=1.25, trail=trail, task="stairs")
    import_scan(STAIRS, tmp_path / "stairs", options)
    assert inspect_scene(str(tmp_path / "stairs")).findings == ()
    scene = load_folder(tmp_path / "stairs")
    assert scene.trail[:, 2] == pytest.approx([0.186, 0.559], abs=0.01)


def test_a_map_whose_first_row_is_the_southernmost_is_refused_and_so_are_heights_of_no_ground(
    tmp_path,
):
    heights = ramp().astype(np.float32)
    south = (34264, DOUBLES, (0.1, 0, 0, 0, 0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1.0))
    geotiff(tmp_path / "south.tif", heights, [south])
    with pytest.raises(SceneError, match=r"first row is the southernmost.*north is up"):
        read_elevation(tmp_path / "south.tif")
    heights[3, 4] = 3e38
    geotiff(tmp_path / "spike.tif", heights, [CELL])
    with pytest.raises(SceneError, match=r"spike.tif: a pixel is at 3e\+38 m.*--no-data"):
        read_elevation(tmp_path / "spike.tif")
    assert np.isnan(read_elevation(tmp_path / "spike.tif", no_data=3e38).heights[3, 4])


def test_black_of_a_tiff_is_refused_as_white_is(tmp_path):
    Image.fromarray(np.zeros((4, 4), np.float32)).save(tmp_path / "map.tif")
    for options in ({"black": 1.0}, {"white": 1.0}):
        with pytest.raises(UsageError, match="drop --white and --black"):
            read_elevation(tmp_path / "map.tif", cell=0.1, **options)


def png_of(rows, *, height):
    """Return a grey PNG that says it has `height` rows and has these, each as wide."""
    raw = zlib.compress(b"".join(b"\0" + bytes(row) for row in rows))
    parts = ((b"IHDR", struct.pack(">IIBBBBB", len(rows[0]), height, 8, 0, 0, 0, 0)),)
    content = b"\x89PNG\r\n\x1a\n"
    for kind, body in (*parts, (b"IDAT", raw), (b"IEND", b"")):
        content += struct.pack(">I", len(body)) + kind + body
        content += struct.pack(">I", zlib.crc32(kind + body))
    return content


def test_rows_that_a_picture_lacks_are_no_ground(tmp_path):
    rows = np.full((10, 40), 200, np.uint8)
    (tmp_path / "whole.png").write_bytes(png_of(rows, height=10))
    (tmp_path / "half.png").write_bytes(png_of(rows, height=20))
    assert read_elevation(tmp_path / "whole.png", cell=0.1, white=1.0).heights.shape == (10, 40)
    with pytest.raises(SceneError, match="cut short: 50% of its rows"):
        read_elevation(tmp_path / "half.png", cell=0.1, white=1.0)
    with pytest.raises(UsageError, match="--cell 1e"):
        read_elevation(tmp_path / "whole.png", cell=1e308, white=1.0)
