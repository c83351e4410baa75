"""Which images show light on the object."""

import numpy as np

from processing.recording.examination import lit_images


def test_a_large_object_is_judged_by_pixels_spread_over_it():
    """Light on 3 % of the columns counts, wherever they are; less than 1 % does not."""
    values = np.full((7, 300, 500), 0.5, np.float32)
    values[1] = 0
    values[2] = np.nan
    values[3:] = 0
    values[3, :, :15] = 0.5
    values[4, :, 485:] = 0.5
    values[5, :, 100:400:20] = 0.5
    values[6, :, :3] = 0.5
    mask = np.ones(values.shape[1:], bool)
    assert lit_images(values, mask) == [0, 2, 3, 4, 5]
    mask[:, :20] = False
    assert lit_images(values, mask) == [0, 2, 4, 5]
