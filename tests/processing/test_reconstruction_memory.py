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
    need = NormalsStage(channel="gray").need
    alone = replace(source, frames=(light,))
    with_dark = replace(source, frames=(replace(dark, role="dark"), light))
    assert need(with_dark).least - need(alone).least == beyond * 40 * 60


@pytest.mark.parametrize(
    ("channels", "channel", "whole"),
    [((), "auto", False), ((3,), "auto", True), ((3,), "gray", False), ((3,), "joint", True)],
)
def test_images_whose_colours_may_be_used_are_needed_as_a_whole(
    tmp_path, channels, channel, whole
) -> None:
    """The memory must not decide whether they are."""
    write_png(tmp_path / "card.0.png", np.full((40, 60, *channels), 700, np.uint16))
    assert NormalsStage(channel=channel).needs_whole(read_source(tmp_path)) == whole
