"""Threads of OpenCV are limited for a while."""

import cv2
import pytest

from sgp.cli.threads import opencv_threads


def test_the_number_of_threads_is_restored():
    before = cv2.getNumThreads()
    with opencv_threads(1):
        assert cv2.getNumThreads() == 1
        with opencv_threads(2):
            assert cv2.getNumThreads() == 2
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before


def test_the_number_of_threads_is_restored_after_an_error():
    before = cv2.getNumThreads()
    with pytest.raises(ValueError, match="no light"), opencv_threads(1):
        raise ValueError("no light")
    assert cv2.getNumThreads() == before
