"""Contact sheets."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from lodpipe.geometry.sheet import GAP, contact_sheet, png_bytes


def plain(height, width, *colour):
    return np.broadcast_to(np.array(colour, np.uint8), (height, width, len(colour)))


def test_images_stand_in_a_grid():
    sheet = contact_sheet([plain(20, 30, 255, 0, 0), plain(10, 30, 0, 255, 0), plain(20, 20, 0, 0, 255)], columns=2)
    assert sheet.shape == (2 * 20 + 3 * GAP, 2 * 30 + 3 * GAP, 3)
    assert sheet[GAP, GAP].tolist() == [255, 0, 0]
    assert sheet[GAP, 2 * GAP + 30].tolist() == [0, 255, 0]
    assert sheet[2 * GAP + 20, GAP].tolist() == [0, 0, 255]
    assert sheet[0, 0].tolist() == sheet[-1, -1].tolist() == [255, 255, 255]


def test_labels_stand_below():
    bare, labelled = (contact_sheet([plain(20, 80, 9, 9, 9)], labels) for labels in ((), ("half",)))
    assert len(labelled) > len(bare)
    below = labelled[GAP + 20 :]
    assert (below < 128).any()
    dark = contact_sheet([plain(20, 80, 9, 9, 9)], ["half"], paper=(0, 0, 0))
    assert (dark[GAP + 20 :] > 128).any()


def test_see_through_pictures_lie_on_the_paper():
    assert contact_sheet([plain(5, 5, 0, 0, 0, 0)], paper=(200, 10, 10))[GAP, GAP].tolist() == [200, 10, 10]


def test_wrong_numbers():
    with pytest.raises(ValueError, match="0 images"):
        contact_sheet([])
    with pytest.raises(ValueError, match="1 images and 2 labels"):
        contact_sheet([plain(5, 5, 0, 0, 0)], ["a", "b"])


def test_png():
    picture = np.random.default_rng(0).integers(0, 256, (7, 5, 4), dtype=np.uint8)
    data = png_bytes(picture)
    assert data == png_bytes(picture)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))), picture)
