"""Counts with their nouns."""

import pytest

from rig import pluralize


@pytest.mark.parametrize(
    ("count", "words", "shown"),
    [
        pytest.param(0, ("frame",), "0 frames", id="none"),
        pytest.param(1, ("frame",), "1 frame", id="one"),
        pytest.param(2, ("frame",), "2 frames", id="several"),
        pytest.param(1, ("image is", "images are"), "1 image is", id="one with a verb"),
        pytest.param(3, ("image is", "images are"), "3 images are", id="several with a verb"),
    ],
)
def test_a_noun_agrees_with_its_count(count: int, words: tuple[str, ...], shown: str) -> None:
    assert pluralize(count, *words) == shown
