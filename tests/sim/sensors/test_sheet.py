"""Sheets of pictures lose no word of their labels."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image as PillowImage
from PIL import ImageFont

from nw_sim.sensors.drawing.pictures import Cell, draw_sheet, text_strip, wrapped

LONG = "two concrete ramps, 15 and 17 degrees, under the lamps of a car park at night"


def picture(width=120, height=40, value=90):
    return np.full((height, width, 3), value, dtype=np.uint8)


def sheet(cells, **options):
    with BytesIO(draw_sheet(cells, **options)) as file:
        return np.asarray(PillowImage.open(file))


@pytest.mark.parametrize("width", [60, 120, 400])
@pytest.mark.parametrize("text", [LONG, "a_name_without_a_single_blank_" * 4, "x", ""])
def test_a_text_is_broken_into_lines_that_fit_and_keeps_every_letter(text, width):
    font = ImageFont.load_default(size=14)
    lines = wrapped(text, width, font)
    assert all(font.getlength(line) <= width for line in lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")


def test_no_ink_is_at_the_right_edge_of_a_title():
    strip = np.asarray(text_strip(LONG, 150, size=14))
    assert (strip < 128).any()
    assert (strip[:, -1] == 255).all()


def test_a_longer_label_makes_a_higher_sheet_and_leaves_pictures_whole():
    short = sheet([Cell(name="x", images=[picture()])], across=1)
    long = sheet([Cell(name="x", caption=LONG, images=[picture(), picture(value=30)])], across=1)
    assert long.shape[1] == short.shape[1]
    assert (short == 90).all(axis=-1).sum() == (long == 90).all(axis=-1).sum() == 120 * 40
    assert (long == 30).all(axis=-1).sum() == 120 * 40
    assert long.shape[0] > short.shape[0] + 40 + 3 * 12


def test_pictures_of_a_row_begin_at_one_height_and_the_title_is_above_them():
    cells = [Cell(name="x", images=[picture()]), Cell(name="y", caption=LONG, images=[picture()])]
    drawn = sheet(cells, across=2, title=f"{LONG}, {LONG}")
    rows = np.flatnonzero((drawn == 90).all(axis=-1).any(axis=1))
    assert len(rows) == 40
    plain = sheet(cells, across=2)
    assert drawn.shape[0] > plain.shape[0] + 3 * 17


def test_orders_for_a_terminal_in_a_name_are_drawn_as_harmless_text():
    strip = text_strip("a\x1b[31mb\nc", 400, size=14)
    assert strip.height == text_strip("abc", 400, size=14).height
