"""The memory that a reconstruction states before it begins."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import read_source, write_png
from processing.recording import NormalsStage


@pytest.mark.parametrize(("channels", "beyond"), [((), 0), ((3,), 2 * 12 - 4)])
def test_references_of_images_in_colour_count_twice(tmp_path, channels, beyond) -> None:
    """The estimate contains one reference in gray."""
    for i in range(2):
        write_png(tmp_path / f"card.{i}.png", np.full((40, 60, *channels), 700, np.uint16))
    source = read_source(tmp_path)
    dark, light = source.frames
    need = NormalsStage().need
    alone = replace(source, frames=(light,))
    with_dark = replace(source, frames=(replace(dark, role="dark"), light))
    assert need(with_dark).least - need(alone).least == beyond * 40 * 60
