"""What measures a twin finds the errors that are put into it, and none in the original."""

from types import SimpleNamespace

import numpy as np
import pytest
from fit import similarity
from looks import MeshRenderer, psnr
from surface import surface_figures
from trials import tallied
from twin_parts import grid, terrain
from walk import handheld

from nw_sim.catalogue import get_scene
from nw_splat.camera import Camera, look_at
from nw_twin.reconstruct.surface import ColourMesh

SCENE = "hurdles/one_low_carpet"


@pytest.fixture(scope="module")
def place():
    return get_scene(SCENE)


@pytest.fixture(scope="module")
def cameras(place):
    return handheld(place, 6, width=96, height=54)


def floor(height):
    """The floor near the trail as fine triangles, as a reconstruction would have it."""
    return terrain(*grid((-1.5, -1.5, height), (6.5, 0, 0), (0, 3.0, 0), (130, 60)))


def test_the_walk_goes_over_the_course_and_around_it_at_the_height_of_a_hand(place):
    centres = np.array([c.T_world_camera[:3, 3] for c in handheld(place, 40, width=64, height=36)])
    over, around = centres[:13], centres[13:]
    assert np.abs(over[:, 1]).max() < 0.15
    assert np.ptp(over[:, 0]) > 4.0
    assert around[:, 1].min() < -1.0
    assert around[:, 1].max() > 1.0
    assert (np.abs(centres[:, 2] - 1.5) < 0.3).all()


def test_a_surface_that_is_a_centimetre_off_measures_a_centimetre_and_one_of_five_is_none(
    place, cameras
):
    line = np.vstack([place.spawn.position, place.trail])
    near, far = (
        surface_figures(place.mesh(), floor(height), line, cameras) for height in (-0.01, -0.05)
    )
    assert near.accuracy == pytest.approx(0.01, abs=1e-3)
    assert near.precision > 0.99
    assert 0.5 < near.completeness < 0.99, "the bar is missing in it"
    assert far.precision == 0.0
    assert far.f < 0.1


def test_a_similarity_is_found_again():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(20, 3))
    T = look_at((1.0, 2.0, 3.0), (0.0, 0.5, 0.0)).copy()
    T[:3, :3] *= 0.47
    np.testing.assert_allclose(similarity(points, points @ T[:3, :3].T + T[:3, 3]), T, atol=1e-12)


def test_another_exposure_is_no_error_and_another_picture_is():
    rng = np.random.default_rng(0)
    picture = rng.uniform(size=(20, 30, 3))
    assert psnr(0.8 * picture + 0.05, picture) > 100.0
    assert psnr(rng.uniform(size=(20, 30, 3)), picture) < 12.0


def test_a_mesh_is_shown_in_the_colours_of_its_corners_and_white_beyond():
    corners, faces = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1))
    colours = np.where(corners[:, 1:2] > 0.5, (0, 0, 255), (255, 0, 0)).astype(np.uint8)
    mesh = ColourMesh(vertices=corners, faces=faces, colours=colours)
    T = look_at((0.5, 0.5, 1.5), (0.5, 0.5, 0.0), (0.0, 1.0, 0.0))
    camera = Camera.from_fovy(width=60, height=60, fovy=np.radians(90.0), T_world_camera=T)
    seen = MeshRenderer(mesh).render(camera)
    np.testing.assert_allclose(seen[2, 2], 1.0)
    np.testing.assert_allclose(seen[30, 30], (0.5, 0.0, 0.5), atol=0.05)
    assert seen[45, 30, 0] > 0.7, "red is below"


def test_the_failing_waypoint_is_the_one_that_most_failures_did_not_reach():
    def row(reached, status="ok"):
        return SimpleNamespace(
            status=status, success=reached / 3, completed=reached == 3, waypoints_reached=reached
        )

    outcome = tallied([row(3), row(1), row(1), row(0), row(0, "error")])
    assert outcome.failing == 2
    assert outcome.failures == 3
    assert outcome.trials == 4
    assert outcome.success == pytest.approx(5 / 12)
    assert tallied([row(3)]).failing is None
