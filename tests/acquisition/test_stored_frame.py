from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import StorageError, read_image
from acquisition.session.frame_file import store_frame
from acquisition.session.session_frame import pixels_sha256
from rig.arrays import UInt16


def picture(shape: tuple[int, ...], seed: int = 0) -> UInt16:
    return np.random.default_rng(seed).integers(0, 65536, shape).astype(np.uint16)


@settings(max_examples=40)
@given(
    height=st.integers(1, 90), width=st.integers(1, 90), colour=st.booleans(), seed=st.integers(0)
)
def test_two_libraries_read_the_stored_frame(
    tmp_path_factory: pytest.TempPathFactory, height: int, width: int, colour: bool, seed: int
) -> None:
    pixels = picture((height, width, 3) if colour else (height, width), seed)
    path = tmp_path_factory.mktemp("frame") / "L00_E0.tif"
    stored = store_frame(path, pixels)
    data = path.read_bytes()
    assert stored.bytes == len(data)
    assert stored.file_sha256 == hashlib.sha256(data).hexdigest()
    assert stored.pixels_sha256 == pixels_sha256(pixels)
    np.testing.assert_array_equal(read_image(path), pixels)
    seen = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(seen[..., ::-1] if colour else seen, pixels)


def test_equal_pixels_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.tif", "b.tif"):
        store_frame(tmp_path / name, picture((300, 200)))
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(picture((40, 60))[:, ::-1], id="mirrored"),
        pytest.param(picture((60, 40)).T, id="transposed"),
        pytest.param(picture((40, 60)).astype(">u2"), id="byte-swapped"),
        pytest.param(picture((80, 120))[::2, ::2], id="strided"),
    ],
)
def test_arrays_that_are_not_contiguous(tmp_path: Path, view: UInt16) -> None:
    stored = store_frame(tmp_path / "a.tif", view)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), view)
    assert stored.pixels_sha256 == pixels_sha256(view)


def test_a_system_that_writes_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write
    monkeypatch.setattr(os, "write", lambda to, data: real(to, bytes(data)[: 1 + len(data) // 3]))
    store_frame(tmp_path / "a.tif", picture((50, 70)))
    monkeypatch.undo()
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), picture((50, 70)))


@pytest.mark.parametrize("call", ["open", "write", "fsync", "replace"])
def test_a_disk_that_refuses_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(StorageError, match=r"a\.tif: cannot write: No space left"):
        store_frame(tmp_path / "a.tif", picture((5, 7)))
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []
