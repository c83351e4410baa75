from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from acquisition import CapturePlan, DataError, Session, verify_session
from acquisition.session import SessionFrame, SessionWriter
from rig.arrays import UInt16
from tests.acquisition import small_session
from tests.acquisition.small_session import manifest
from tests.quick_sample import quick

FLIPS = 80
picture = partial(small_session.picture, shape=(12, 16), above=4096)


@pytest.fixture(params=["complete", pytest.param("incomplete", marks=pytest.mark.slow)])
def folder(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    plan = CapturePlan(leds=(0, 1, 2), exposures_us=(100.0,))
    content = manifest((12, 16), 12, notes="rim scratched at two o'clock", plan=plan)
    with SessionWriter.create(tmp_path / "s", content) as writer:
        for index, shot in enumerate(writer.missing):
            if request.param == "incomplete" and shot.led == 2:
                break
            writer.write_frame(shot, picture(index))
        else:
            writer.complete()
    return tmp_path / "s"


def outcome(frame: SessionFrame) -> UInt16 | str:
    try:
        return frame.read()
    except DataError as error:
        return str(error)


def flip(path: Path, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


@pytest.mark.parametrize("seed", quick([1, 2, 3], every=3))
def test_every_flipped_bit_is_found_and_its_file_named(
    folder: Path, tmp_path: Path, seed: int
) -> None:
    """Random bits in all files, each file equally likely; no damaged pixel is read."""
    rng = np.random.default_rng(seed)
    copy = tmp_path / "copy"
    files = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert verify_session(folder).ok
    for _ in range(FLIPS):
        name = files[int(rng.integers(len(files)))]
        bit = int(rng.integers(8 * (folder / name).stat().st_size))
        shutil.copytree(folder, copy)
        flip(copy / name, bit)
        found = verify_session(copy)
        assert any(str(copy / name) in problem for problem in found.problems), (name, bit)
        try:
            frames = Session.open(copy).frames
        except DataError:
            # Damage of one frame must not prevent reading the others.
            assert name.parts[0] != "frames", (name, bit)
        else:
            assert name.parts[0] == "frames", (name, bit)
            for index, frame in enumerate(frames):
                read = outcome(frame)
                if isinstance(read, str):
                    assert str(copy / name) in read
                else:
                    np.testing.assert_array_equal(read, picture(index))
        shutil.rmtree(copy)


@pytest.mark.parametrize("folder", ["complete"], indirect=True)
def test_every_byte_of_the_smallest_file_counts(folder: Path) -> None:
    path = folder / "COMPLETE"
    for bit in range(0, 8 * path.stat().st_size, 7):
        flip(path, bit)
        assert any("COMPLETE" in problem for problem in verify_session(folder).problems)
        flip(path, bit)
    assert verify_session(folder).ok


def test_every_bit_of_the_last_byte_of_the_journal_is_found(folder: Path) -> None:
    path = folder / "journal.jsonl"
    for back in range(8 * 3):
        bit = 8 * path.stat().st_size - 1 - back
        flip(path, bit)
        assert any("journal.jsonl" in problem for problem in verify_session(folder).problems)
        flip(path, bit)
