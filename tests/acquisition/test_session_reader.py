from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, DataError, MissingPathError, Session, verify_session
from acquisition.pixels import write_tiff
from acquisition.session import (
    GENESIS,
    SessionWriter,
    compact_session,
    encode_line,
)
from acquisition.session import session as _session
from tests.acquisition.small_session import manifest

PLAN = CapturePlan(repeat=False, leds=(0, 1), exposures_us=(100.0,))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a complete session of three frames whose pixels are 100, 101, 102."""
    with SessionWriter.create(tmp_path / "s", manifest((6, 8), 12, plan=PLAN)) as writer:
        for index, shot in enumerate(writer.missing):
            writer.write_frame(shot, np.full((6, 8), 100 + index, np.uint16))
        writer.complete()
    return tmp_path / "s"


def records(folder: Path) -> list[dict[str, Any]]:
    lines = (folder / "journal.jsonl").read_text().splitlines()
    return [{k: v for k, v in json.loads(line).items() if k != "line_sha256"} for line in lines]


def forge(folder: Path, rows: list[dict[str, Any]], *, complete: bool = True) -> None:
    """Write a journal with valid hashes, as anyone who knows the format can."""
    toml = (folder / "session.toml").read_bytes()
    rows[0]["session_toml_sha256"] = hashlib.sha256(toml).hexdigest()
    data, previous = b"", GENESIS
    for row in rows:
        line, previous = encode_line(row, previous)
        data += line
    (folder / "journal.jsonl").write_bytes(data)
    (folder / "COMPLETE").unlink()
    if complete:
        mark = f"{hashlib.sha256(data).hexdigest()}  journal.jsonl\n"
        (folder / "COMPLETE").write_text(mark)


def compacted(rows: list[dict[str, Any]], details: dict[str, Any]) -> dict[str, Any]:
    event = {"kind": "event", "seq": 4, "time_utc": rows[0]["time_utc"], "event": "compacted"}
    return {**event, "details": details}


def toml_with(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "session.toml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        forge(folder, records(folder))

    return change


def frame_with(**changed: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        rows = records(folder)
        rows[2].update(changed)
        forge(folder, rows)

    return change


def linked(name: str) -> Callable[[Path], None]:
    """Move a file or folder out of the session and leave a link."""

    def change(folder: Path) -> None:
        outside = folder.parent / "outside"
        (folder / name).rename(outside)
        (folder / name).symlink_to(outside)

    return change


def circled(folder: Path) -> None:
    (folder / "frames/L00_E0.tif").unlink()
    (folder / "frames/L00_E0.tif").symlink_to("L00_E0.tif")


def dropped(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def broken_middle(folder: Path) -> None:
    path = folder / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + lines[1][:50] + b"\n" + b"".join(lines[2:]))


INVALID_SESSIONS = {
    "newer-version": (
        toml_with("format_version = 6", "format_version = 7"),
        "session.toml",
        "format version 7 is unknown, this program reads 1, 2, 3, 4, 5 and 6",
    ),
    "no-version": (toml_with("format_version = 6\n", ""), "session.toml", "version None"),
    "unknown-key": (
        toml_with("[camera]", 'colour = "red"\n[camera]'),
        "session.toml",
        "unknown key 'plan.colour'",
    ),
    "bits": (toml_with("bit_depth = 12", "bit_depth = 99"), "session.toml", "bit_depth"),
    "key-twice": (
        toml_with("bit_depth = 12", "bit_depth = 12\nblack_level_dn = 5000"),
        "session.toml",
        "",
    ),
    "levels": (
        toml_with("black_level_dn = 0.0", "black_level_dn = 5000.0"),
        "session.toml",
        "black level is not below",
    ),
    "lights-that-are-none": (
        toml_with(
            "[camera]",
            "[[lights.lights]]\nid = 'L00'\ndirection = [0, 0, 0]\n[camera]",
        ),
        "session.toml",
        "zero vector",
    ),
    "path-with-dots": (frame_with(file="../outside.tif"), "journal.jsonl", "line 3"),
    "path-absolute": (frame_with(file="/etc/hosts"), "journal.jsonl", "line 3"),
    "not-planned": (frame_with(led=5), "L00_E0.tif", "not in the plan"),
    "folder-linked": (linked("frames"), "s/frames", "leaves the session"),
    "frame-linked": (linked("frames/L00_E0.tif"), "L00_E0.tif", "leaves the session"),
    "links-in-a-circle": (circled, "L00_E0.tif", "leaves the session"),
    "broken-middle": (broken_middle, "journal.jsonl", "line 2 is damaged"),
    "other-mark": (
        lambda folder: (folder / "COMPLETE").write_text("yes\n"),
        "COMPLETE",
        "does not match journal.jsonl",
    ),
    "complete-without-frames": (
        lambda folder: forge(folder, records(folder)[:-1]),
        "COMPLETE",
        "first L01_E0.tif",
    ),
    "no-manifest": (dropped("session.toml"), "session.toml", "missing"),
    "no-journal": (dropped("journal.jsonl"), "journal.jsonl", "missing"),
    "manifest-not-text": (
        lambda folder: (folder / "session.toml").write_bytes(b"\xff\xfe"),
        "session.toml",
        "not TOML",
    ),
    "forged-but-consistent": (toml_with('operator = "Ada"', 'operator = "Eve"'), "", None),
}


@pytest.mark.parametrize(
    ("change", "name", "said"), INVALID_SESSIONS.values(), ids=INVALID_SESSIONS
)
def test_invalid_sessions_are_refused(
    folder: Path, change: Callable[[Path], None], name: str, said: str | None
) -> None:
    change(folder)
    if said is None:
        # Hashes reveal changes, but do not prove who wrote a session.
        assert Session.open(folder).manifest.operator == "Eve"
        return
    with pytest.raises(DataError) as caught:
        Session.open(folder)
    assert said in str(caught.value)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    found = verify_session(folder)
    assert not found.ok
    assert any(name in problem and said in problem for problem in found.problems)


def test_folders_that_are_not_sessions(tmp_path: Path) -> None:
    for reader in (Session.open, verify_session):
        with pytest.raises(MissingPathError):
            reader(tmp_path / "none")
        with pytest.raises(DataError, match="is not a session"):
            reader(tmp_path)
        with pytest.raises(DataError, match="is not a session"):
            reader(Path(__file__))


def test_an_altered_manifest_is_reported_even_if_it_is_valid(folder: Path) -> None:
    path = folder / "session.toml"
    path.write_text(path.read_text().replace("Ada", "Eve"))
    with pytest.raises(DataError, match=r"session\.toml: differs from the one that"):
        Session.open(folder)
    assert verify_session(folder).frames == 3


def test_a_lost_frame(folder: Path) -> None:
    (folder / "frames/L01_E0.tif").unlink()
    found = verify_session(folder)
    assert len(found.problems) == 1
    assert "L01_E0.tif" in found.problems[0]
    with pytest.raises(DataError, match=r"L01_E0\.tif: is in the journal but not there"):
        Session.open(folder).frames[2].read()


def test_a_frame_replaced_by_another_picture(folder: Path) -> None:
    write_tiff(folder / "frames/L01_E0.tif", np.full((6, 8), 7, np.uint16))
    with pytest.raises(DataError, match=r"L01_E0\.tif: its pixels differ"):
        Session.open(folder).frames[2].read()
    assert "L01_E0.tif" in verify_session(folder).problems[0]


def test_a_frame_of_another_size(folder: Path) -> None:
    write_tiff(folder / "frames/L01_E0.tif", np.full((6, 9), 7, np.uint16))
    with pytest.raises(DataError, match=r"L01_E0\.tif: has uint16 pixels of shape \(6, 9\)"):
        Session.open(folder).frames[2].read()


def test_the_pixel_hash_is_checked_independently(folder: Path) -> None:
    frame_with(pixels_sha256="0" * 64)(folder)
    assert "its pixels differ" in verify_session(folder).problems[0]


def test_the_pixel_hash_is_that_of_the_samples(folder: Path) -> None:
    row = records(folder)[2]
    samples = np.full((6, 8), 101, "<u2").tobytes()
    assert row["pixels_sha256"] == hashlib.sha256(samples).hexdigest()
    data = (folder / row["file"]).read_bytes()
    assert (row["bytes"], row["file_sha256"]) == (len(data), hashlib.sha256(data).hexdigest())


def test_an_extra_file(folder: Path) -> None:
    (folder / "frames/L99_E0.tif").write_bytes(b"who put this here")
    (folder / "frames/.part-x.tif").write_bytes(b"")
    found = verify_session(folder)
    assert [("L99" in text) for text in found.problems] == [True]
    assert [notice.where for notice in found.warnings] == [str(folder / "frames/.part-x.tif")]
    assert len(Session.open(folder).frames) == 3


@pytest.mark.parametrize("name", ["session.toml", "journal.jsonl", "COMPLETE"])
def test_a_folder_in_place_of_a_file(folder: Path, name: str) -> None:
    (folder / name).unlink()
    (folder / name).mkdir()
    for reader in (Session.open, verify_session):
        with pytest.raises(DataError, match=f"{name}: a folder, not a file"):
            reader(folder)


def test_derived_files_do_not_matter(folder: Path) -> None:
    (folder / "derived").mkdir()
    (folder / "derived" / "normals.exr").write_bytes(b"any")
    assert verify_session(folder).ok


def test_a_compacted_frame_is_read_from_its_new_file(folder: Path) -> None:
    rows = records(folder)
    old, new = folder / "frames/L00_E0.tif", folder / "frames/L00_E0_C.tif"
    # Other bytes, same pixels, as after lossless compression.
    data = old.read_bytes() + b"\0"
    new.write_bytes(data)
    old.unlink()
    details = {
        "frame_seq": 2,
        "file": "frames/L00_E0_C.tif",
        "bytes": len(data),
        "file_sha256": hashlib.sha256(data).hexdigest(),
    }
    forge(folder, [*rows, compacted(rows, details)])
    assert verify_session(folder).problems == ()
    assert int(Session.open(folder).frames[1].read()[0, 0]) == 101
    data = new.read_bytes()
    new.write_bytes(data[:-1] + b"\1")
    assert "L00_E0_C.tif" in verify_session(folder).problems[0]


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param({"frame_seq": 9}, id="no-such-frame"),
        pytest.param({"file": "frames/../../x"}, id="leaves"),
        pytest.param({"bytes": 0}, id="no-bytes"),
        pytest.param({"bytes": "5"}, id="bytes-as-text"),
        pytest.param({"frame_seq": True}, id="frame-as-truth"),
        pytest.param({"colour": 1}, id="more-than-there-is"),
        pytest.param({"file": "frames/L00_E0.tif"}, id="its-own-file"),
        pytest.param({"file": "frames/L01_E0.tif"}, id="the-file-of-another"),
    ],
)
def test_an_invalid_compaction_event(folder: Path, changed: dict[str, Any]) -> None:
    rows = records(folder)
    details = {"frame_seq": 2, "file": "frames/L00_E0.z.tif", "bytes": 5, "file_sha256": "a" * 64}
    details.update(changed)
    forge(folder, [*rows, compacted(rows, details)])
    with pytest.raises(DataError, match=r"journal\.jsonl: line 5: "):
        Session.open(folder)


@pytest.mark.parametrize("ends", ["complete", "compact"])
def test_a_session_that_is_written_while_it_is_read_is_not_damaged(
    folder: Path, monkeypatch: pytest.MonkeyPatch, ends: str
) -> None:
    """Journal and COMPLETE are two files, and both change right after the first is read."""
    if ends == "complete":
        (folder / "COMPLETE").unlink()
    real = _session.read_bounded

    def read_and_write(path: Path, most_bytes: int) -> bytes:
        data = real(path, most_bytes)
        if path.name == "journal.jsonl":
            monkeypatch.setattr(_session, "read_bounded", real)
            if ends == "compact":
                compact_session(folder)
            else:
                with SessionWriter.reopen(folder) as writer:
                    writer.complete()
        return data

    monkeypatch.setattr(_session, "read_bounded", read_and_write)
    assert Session.open(folder).complete


def test_counts(folder: Path) -> None:
    found = verify_session(folder)
    assert (found.ok, found.complete, found.frames, found.events) == (True, True, 3, 0)
    assert found.bytes == sum(path.stat().st_size for path in (folder / "frames").iterdir())


def test_a_verification_in_words(folder: Path) -> None:
    assert repr(verify_session(folder)) == f"Verification({folder}, complete, 3 frames, 0 problems)"
    forge(folder, records(folder)[:-1], complete=False)
    (folder / "frames/L00_E0.tif").unlink()
    said = f"Verification({folder}, incomplete, 1 missing, 2 frames, 1 problem)"
    assert repr(verify_session(folder)) == said


def test_without_its_manifest_nothing_of_a_session_is_known(folder: Path) -> None:
    (folder / "session.toml").unlink()
    found = verify_session(folder)
    assert (found.ok, found.complete) == (False, False)
    assert (found.frames, found.events, found.bytes, found.missing) == (0, 0, 0, ())
