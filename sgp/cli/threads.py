"""How many threads OpenCV uses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def opencv_threads(count: int) -> Iterator[None]:
    """Let OpenCV use at most so many threads: on small images they mostly wait for each other."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
