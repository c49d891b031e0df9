"""A scene's figures and its view from above say what the scene holds."""

import numpy as np
from PIL import Image

from nw_eval.cli.verbs.scenes import scene_page
from nw_scenes.overview import draw_plan, figures
from nw_sim.catalogue import get_scene


def test_the_figures_name_every_waypoint_and_the_digest():
    scene = get_scene("hurdles/three_low")
    text = scene_page(figures(scene))
    assert scene.digest in text
    for x, _, z in scene.trail.tolist():
        assert f"x {x:.2f}" in text
        assert f"z {z:.2f}" in text


def test_the_view_from_above_shows_bars_in_another_colour_than_the_ground(tmp_path):
    draw_plan(get_scene("hurdles/three_low"), tmp_path / "plan.png")
    with Image.open(tmp_path / "plan.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    # The ground and each of three bars of 12 to 20 cm: at least four areas of one colour.
    _, counts = np.unique(pixels, axis=0, return_counts=True)
    assert (counts > 1500).sum() >= 5
