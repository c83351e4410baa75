"""Highlights at the border that belong to no sphere are named."""

import re
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from calibration.spheres.highlights.spots import reduce_stack
from calibration.spheres.propose.sphere_selection import cut_spheres

SIZE = (200, 260)


def seen(places, factor=1):
    """Return images of 12 lights on a gray board, light k with a spot at each of ``places[k]``."""
    images = np.full((12, SIZE[0] * factor, SIZE[1] * factor), 0.1, np.float32)
    for image, spots in zip(images, places, strict=False):
        for x, y in spots:
            cv2.circle(image, (x * factor, y * factor), 2 * factor, 0.9, -1)
    return reduce_stack(images)


def sphere(x, y, radius):
    outline = SimpleNamespace(centre_px=np.array([x, y]), radius_px=radius)
    return SimpleNamespace(outline=outline)


LEFT = [[(4, 90)], [(9, 100)], [(5, 110)], [(7, 104)]]
CASES = {
    "four lights at the left": (LEFT, [], ["(6, 102)"]),
    "two lights may glint": (LEFT[:2], [], []),
    "one light with many spots": ([[(4, 90), (9, 100), (5, 110), (7, 104)]], [], []),
    "away from the border": ([[(x + 40, y)] for ((x, y),) in LEFT], [], []),
    "of a sphere that was found": (LEFT, [sphere(0, 100, 20)], []),
    "next to a sphere that was found": (LEFT, [sphere(60, 100, 20)], ["(6, 102)"]),
    "two corners": (
        [[(4, 5), (250, 192)], [(9, 9), (254, 196)], [(5, 14), (251, 186)]],
        [],
        ["(5, 9)", "(251, 192)"],
    ),
}


@pytest.mark.parametrize(("places", "found", "named"), CASES.values(), ids=CASES)
def test_groups_of_highlights_at_the_border_are_named(places, found, named):
    notices = cut_spheres(seen(places), found)
    assert [notice.code for notice in notices] == ["sphere-cut"] * len(named)
    texts = "\n".join(notice.text for notice in notices)
    assert all(f"a sphere at {place} px is not used" in texts for place in named)


def test_places_are_those_of_the_full_image():
    (notice,) = cut_spheres(seen(LEFT, factor=6), [])
    assert "4 lights shine in it" in notice.text
    place = re.search(r"\((\d+), (\d+)\) px", notice.text)
    assert [int(number) for number in place.groups()] == pytest.approx([36, 612], abs=6)
