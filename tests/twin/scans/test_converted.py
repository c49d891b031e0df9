"""USD stages and E57 clouds are opened in a confined process, and read as what they say."""

import io

import numpy as np
import pytest
from PIL import Image

from nw_base.confinement import offered
from nw_base.errors import PrerequisiteError, SceneError
from nw_scenes.folder import load_folder
from nw_scenes.rays import RayScene
from nw_twin.scans import converted
from nw_twin.scans.converted import read_stage
from nw_twin.scans.points import read_cloud, surfaced
from nw_twin.scans.scan import ScanOptions, import_scan


def stage(path, *, up="Z", metres=0.01):
    """Write a stage: a floor of 6 x 4 m with a texture, a mirrored step on it, a hidden wall."""
    usd = pytest.importorskip("pxr.Usd")
    from pxr import Gf, Sdf, UsdGeom, UsdShade, UsdUtils

    made = usd.Stage.CreateNew(str(path.with_suffix(".usdc")))
    UsdGeom.SetStageUpAxis(made, up)
    UsdGeom.SetStageMetersPerUnit(made, metres)
    one = 1.0 / metres
    floor = UsdGeom.Mesh.Define(made, "/World/Floor")
    flat = np.array([(0, 0), (6, 0), (6, 4), (0, 4)], float) * one
    z = np.zeros(4)
    points = np.column_stack([flat, z] if up == "Z" else [flat[:, 0], z, -flat[:, 1]])
    floor.CreatePointsAttr([Gf.Vec3f(*map(float, point)) for point in points])
    floor.CreateFaceVertexCountsAttr([4])
    floor.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    places = UsdGeom.PrimvarsAPI(floor).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray)
    places.Set([Gf.Vec2f(0, 0), Gf.Vec2f(1, 0), Gf.Vec2f(1, 1), Gf.Vec2f(0, 1)])
    Image.new("RGB", (8, 8), (200, 40, 10)).save(path.parent / "floor.png")
    material = UsdShade.Material.Define(made, "/World/Paint")
    surface = UsdShade.Shader.Define(made, "/World/Paint/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    picture = UsdShade.Shader.Define(made, "/World/Paint/Picture")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set("./floor.png")
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
        picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    )
    material.CreateSurfaceOutput().ConnectToSource(
        surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    )
    UsdShade.MaterialBindingAPI.Apply(floor.GetPrim()).Bind(material)
    step = UsdGeom.Cube.Define(made, "/World/Step")
    step.CreateSizeAttr(1.0)
    middle = (5.0, 3.4, 0.05) if up == "Z" else (5.0, 0.05, -3.4)
    step.AddTranslateOp().Set(Gf.Vec3d(*(one * np.array(middle)).tolist()))
    size = (-1.0, 0.6, 0.1) if up == "Z" else (-1.0, 0.1, 0.6)
    step.AddScaleOp().Set(Gf.Vec3f(*(one * np.array(size)).tolist()))
    step.CreateDisplayColorAttr([Gf.Vec3f(0.0, 0.5, 0.0)])
    wall = UsdGeom.Cube.Define(made, "/World/Wall")
    wall.CreateVisibilityAttr(UsdGeom.Tokens.invisible)
    UsdGeom.Sphere.Define(made, "/World/Ball")
    made.Save()
    assert UsdUtils.CreateNewUsdzPackage(str(path.with_suffix(".usdc")), str(path))
    return path


@pytest.mark.parametrize(("up", "metres"), [("Z", 0.01), ("Y", 1.0)])
def test_a_stage_is_read_in_metres_with_its_own_axis_up(tmp_path, up, metres):
    source = stage(tmp_path / "hall.usdz", up=up, metres=metres)
    painted, axis, lines = read_stage(source)
    assert axis == f"+{up.lower()}"
    height = "xyz".index(axis[1])
    size = np.ptp(painted.vertices, axis=0)
    assert size[height] == pytest.approx(0.1, abs=1e-4)
    np.testing.assert_allclose(np.sort(size), (0.1, 4.0, 6.0), atol=1e-4)
    assert "not read of the stage: 1 Sphere, 1 hidden part" in lines
    textures = [one.texture for one in painted.materials if one.texture is not None]
    assert len(textures) == 1
    assert Image.open(io.BytesIO(textures[0])).getpixel((3, 3)) == (200, 40, 10)
    # Linear 0.5 is displayed as 0.73 (IEC 61966-2-1 gives 0.735).
    green = [one.factor[1] for one in painted.materials if one.factor[0] == 0.0]
    assert green == [pytest.approx(0.735, abs=0.01)]


def test_a_package_of_a_phone_becomes_a_scene_whose_step_looks_up(tmp_path):
    source = stage(tmp_path / "hall.usdz")
    written = import_scan(source, tmp_path / "scene", ScanOptions(trail=((1.0, 1.0), (3.0, 1.0))))
    assert "the stage says: +z is up, one unit is 0.01 m" in written.lines
    assert "up is +z of the file" in "\n".join(written.lines)
    assert any("splat of the mesh's colours" in line for line in written.lines)
    assert written.fault is None
    painted, *_ = read_stage(source)
    corners = painted.vertices[painted.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    top = np.isclose(corners[:, :, 2], 0.1).all(axis=1)
    assert top.sum() == 2
    assert (normal[top, 2] > 0).all()


def test_a_stage_that_is_none_or_has_no_sensible_unit_is_an_error(tmp_path):
    pytest.importorskip("pxr")
    (tmp_path / "broken.usdz").write_bytes(b"PK\3\4" + bytes(200))
    (tmp_path / "broken.usda").write_text("#usda 1.0\n(\n")
    for name in ("broken.usdz", "broken.usda"):
        with pytest.raises(SceneError, match=f"{name}: it cannot be read as a USD stage"):
            read_stage(tmp_path / name)
    with pytest.raises(SceneError, match=r"none\.usdz: it cannot be read: No such file"):
        read_stage(tmp_path / "none.usdz")
    (tmp_path / "empty.usda").write_text("#usda 1.0\n")
    with pytest.raises(SceneError, match=r"empty\.usda: .*0 faces"):
        read_stage(tmp_path / "empty.usda")
    tiny = stage(tmp_path / "tiny.usdz", metres=1e-9)
    with pytest.raises(SceneError, match="1e-09 metres per unit"):
        read_stage(tiny)


@pytest.mark.skipif(not offered().landlock, reason="this kernel has no Landlock")
def test_a_stage_reaches_no_file_but_itself(tmp_path):
    pytest.importorskip("pxr")
    stage(tmp_path / "secret.usdz")
    (tmp_path / "thief.usda").write_text(
        '#usda 1.0\ndef "World" (references = @./secret.usdz@</World>) {}\n'
    )
    with pytest.raises(SceneError, match=r"thief\.usda: (no triangles|it has no|0 )"):
        read_stage(tmp_path / "thief.usda")


def test_boxes_of_roomplan_are_named(tmp_path):
    pytest.importorskip("pxr")
    (tmp_path / "Room.usda").write_text(
        '#usda 1.0\n(\n    upAxis = "Y"\n    metersPerUnit = 1\n)\n'
        'def Xform "Room"\n{\n def Xform "Parametric_grp"\n {\n'
        '  def Cube "Wall0"\n  {\n   double size = 2\n  }\n }\n}\n'
    )
    painted, up, lines = read_stage(tmp_path / "Room.usda")
    assert (len(painted.faces), up) == (12, "+y")
    assert any("made by RoomPlan as boxes: doors are closed" in line for line in lines)


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    def missing(name):
        raise PrerequisiteError(f"a twin needs the package {name}", fix="pip install it")

    monkeypatch.setattr(converted, "package", missing)
    (tmp_path / "a.e57").write_bytes(b"ASTM-E57")
    with pytest.raises(PrerequisiteError, match="pye57"):
        read_cloud(tmp_path / "a.e57")


def room(rng, count):
    """Return points on the floor, the walls and the ceiling of a room of 4 x 3 x 2.5 m."""
    size = np.array([4.0, 3.0, 2.5])
    areas = np.repeat([size[1] * size[2], size[0] * size[2], size[0] * size[1]], 2)
    side = rng.choice(6, count, p=areas / areas.sum())
    points = rng.random((count, 3)) * size
    points[np.arange(count), side // 2] = (side % 2) * size[side // 2]
    return points


def scans(path, rng, *, grid=True):
    """Write an E57 of a room, scanned from two places by a scanner that was turned."""
    pye57 = pytest.importorskip("pye57")
    file = pye57.E57(str(path), mode="w")
    for place, turn in (((1.0, 1.0, 1.5), 0.0), ((3.0, 2.0, 1.5), 0.7)):
        c, s = np.cos(turn), np.sin(turn)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        own = (room(rng, 20_000) - place) @ rotation
        table = {f"cartesian{axis}": own[:, i] for i, axis in enumerate("XYZ")}
        shade = np.full(len(own), 90, np.uint16)
        table |= {f"color{name}": shade for name in ("Red", "Green", "Blue")}
        if grid:
            table |= {"rowIndex": np.arange(len(own)), "columnIndex": np.zeros(len(own), int)}
        quat = np.array([np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)])
        file.write_scan_raw(table, rotation=quat, translation=np.array(place))
    file.close()
    return path


def test_scans_of_an_e57_are_put_together_by_their_poses(tmp_path):
    source = scans(tmp_path / "room.e57", np.random.default_rng(0))
    cloud = read_cloud(source)
    assert len(cloud.points) == 40_000
    np.testing.assert_allclose(cloud.points.min(axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(cloud.points.max(axis=0), (4.0, 3.0, 2.5), atol=1e-3)
    np.testing.assert_allclose(cloud.colours, 90 / 255, atol=1e-6)
    assert cloud.unread == ()
    places = np.unique(cloud.seen_from.round(6), axis=0)
    np.testing.assert_allclose(places, [(1.0, 1.0, 1.5), (3.0, 2.0, 1.5)])


def test_a_room_looks_inwards_to_where_the_scanner_stood(tmp_path):
    source = scans(tmp_path / "room.e57", np.random.default_rng(1))
    mesh, _ = surfaced(source, "auto")
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = np.einsum("ni,ni->n", normal, np.array([2.0, 1.5, 1.25]) - corners.mean(axis=1))
    assert (inwards > 0).mean() > 0.98
    written = import_scan(source, tmp_path / "scene")
    assert any("up is +z of the file" in line for line in written.lines)
    scene = RayScene(load_folder(tmp_path / "scene").mesh())
    assert abs(scene.height(np.array([[0.5, 0.5]]), z_from=np.array([1.0]))[0]) < 0.02


@pytest.mark.parametrize("grid", [True, False])
def test_points_that_were_put_together_have_no_scanner(tmp_path, grid):
    source = scans(tmp_path / "room.e57", np.random.default_rng(2), grid=grid)
    assert (read_cloud(source).seen_from is not None) == grid


def test_an_e57_that_is_damaged_is_an_error(tmp_path):
    source = scans(tmp_path / "room.e57", np.random.default_rng(3))
    content = bytearray(source.read_bytes())
    content[5000] ^= 0xFF
    source.write_bytes(content)
    with pytest.raises(SceneError, match=r"room.e57: it cannot be read as an E57 point cloud"):
        read_cloud(source)
