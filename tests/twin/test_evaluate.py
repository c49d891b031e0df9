"""Figures of views that training did not see."""

from dataclasses import replace

import numpy as np
from small_capture import PLACE, beginning, photos

from nw_twin.gaussians.loss import view_figures
from nw_twin.gaussians.rasteriser import Rasteriser


def test_the_place_itself_is_shown_as_well_as_a_byte_can_say():
    figures = view_figures(PLACE, photos(1)[0], Rasteriser())
    # Bytes are cut off, not rounded: an error of up to a step, which 48.1 dB is.
    assert 48.1 < figures.psnr < 60.0
    assert figures.ssim > 0.999
    assert figures.name == "00.png"


def test_another_exposure_is_told_from_another_place():
    black = (0.0, 0.0, 0.0)  # What is white with any exposure would be no exposure's.
    rasteriser, dark = Rasteriser(background=black), photos(1, gains=(0.6,), background=black)[0]
    of_the_place = view_figures(PLACE, dark, rasteriser)
    assert of_the_place.psnr < 25.0
    assert of_the_place.psnr_corrected > 45.0
    of_another = view_figures(beginning(), dark, rasteriser)
    assert of_another.psnr_corrected < 25.0


def test_what_a_mask_hides_does_not_count():
    photo = photos(1)[0]
    mask = np.ones((48, 72), dtype=bool)
    mask[10:20, 30:50] = False
    spoilt = photo.rgb.copy()
    spoilt[~mask] = 255 - spoilt[~mask]
    hidden = view_figures(PLACE, replace(photo, rgb=spoilt, mask=mask), Rasteriser())
    assert hidden.psnr > 48.1
    assert hidden.ssim > 0.999
    assert view_figures(PLACE, replace(photo, rgb=spoilt), Rasteriser()).psnr < 25.0


def test_a_picture_of_one_colour_has_a_correction_too():
    nothing = replace(PLACE, means=PLACE.means + np.float32([0, 0, 1e6]))
    figures = view_figures(nothing, photos(1)[0], Rasteriser())
    assert np.isfinite(figures.psnr_corrected)
    assert figures.psnr_corrected >= figures.psnr
