from __future__ import annotations

import hashlib
import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition._session.journal import GENESIS, encode_line, parse_journal

TIME = "2026-03-04T05:06:07.000000+00:00"
START = {"kind": "session", "seq": 0, "time_utc": TIME, "session_toml_sha256": "a" * 64}
FRAME = {
    "kind": "frame",
    "seq": 1,
    "time_utc": TIME,
    "role": "light",
    "led": 7,
    "bracket": 0,
    "repeat": 0,
    "exposure_us": 10.0,
    "gain_db": 0.0,
    "file": "frames/L07_E0.tif",
    "bytes": 100,
    "file_sha256": "b" * 64,
    "pixels_sha256": "c" * 64,
    "frame_id": 5,
    "timestamp_ns": 12,
    "temperature_c": None,
    "echo": {"seq": 3, "led": 7},
    "clipped_fraction": 0.0,
    "percentiles_dn": {"0": 1, "1": 1, "50": 4, "99": 8, "99.9": 9, "100": 9},
    "sharpness": 0.5,
    "status": "ok",
    "origin": None,
}


def event(seq: int, **details: Any) -> dict[str, Any]:
    return {"kind": "event", "seq": seq, "time_utc": TIME, "event": "note", "details": details}


def chain(*records: dict[str, Any]) -> bytes:
    data, previous = b"", GENESIS
    for record in records:
        line, previous = encode_line(record, previous)
        data += line
    return data


GOOD = chain(START, FRAME, event(2, why="ø\n\u2028"), event(3, torn='{"kind"', n=[1.5, None]))


def test_the_hash_follows_the_format() -> None:
    previous = "0" * 64
    for line in GOOD.splitlines():
        text, mark, rest = line.rpartition(b',"line_sha256":"')
        assert mark
        own = hashlib.sha256(previous.encode() + text).hexdigest()
        assert rest == own.encode() + b'"}'
        assert json.loads(line)["line_sha256"] == own
        previous = own


def test_an_intact_journal() -> None:
    found = parse_journal(GOOD)
    assert [line.seq for line in found.lines] == [0, 1, 2, 3]
    assert (found.damage, found.torn, found.unterminated, found.text) == (None, b"", False, GOOD)
    assert found.last_sha256.encode() in GOOD.splitlines()[-1]


def test_an_empty_file_is_a_journal_without_lines() -> None:
    found = parse_journal(b"")
    assert (found.lines, found.damage, found.torn) == ((), None, b"")


def test_every_cut_leaves_the_intact_lines_and_is_not_damage() -> None:
    for length in range(len(GOOD)):
        found = parse_journal(GOOD[:length])
        lines = GOOD[:length].count(b"\n")
        at_newline = length < len(GOOD) and GOOD[length : length + 1] == b"\n"
        assert found.damage is None
        assert found.unterminated == at_newline
        assert len(found.lines) == lines + at_newline
        assert found.text + found.torn == GOOD[:length] + b"\n" * at_newline
        assert bool(found.torn) == (length > 0 and not at_newline and GOOD[length - 1] != 10)


@settings(deadline=None, max_examples=300)
@given(st.integers(0, 8 * len(GOOD) - 1))
def test_every_flipped_bit_is_damage_and_earlier_lines_are_kept(bit: int) -> None:
    data = bytearray(GOOD)
    data[bit // 8] ^= 1 << bit % 8
    found = parse_journal(bytes(data))
    line = GOOD[: bit // 8].count(b"\n")
    assert found.damage is not None
    assert f"line {line + 1} " in found.damage
    assert len(found.lines) == line


def test_every_bit_of_the_last_newline_counts() -> None:
    for bit in range(8):
        found = parse_journal(GOOD[:-1] + bytes([GOOD[-1] ^ 1 << bit]))
        assert found.damage is not None
        assert "line 4 " in found.damage


@pytest.mark.parametrize(
    "order",
    [
        pytest.param((1, 2, 3), id="first-missing"),
        pytest.param((0, 2, 3), id="one-missing"),
        pytest.param((0, 2, 1, 3), id="swapped"),
        pytest.param((0, 1, 1, 2, 3), id="doubled"),
    ],
)
def test_lines_in_another_order_are_damage(order: tuple[int, ...]) -> None:
    lines = GOOD.splitlines(keepends=True)
    assert parse_journal(b"".join(lines[i] for i in order)).damage is not None


def test_a_torn_line_followed_by_another_is_damage() -> None:
    lines = GOOD.splitlines(keepends=True)
    found = parse_journal(lines[0] + lines[1][:40] + lines[1] + lines[2])
    assert found.damage is not None
    assert "line 2 " in found.damage


@pytest.mark.parametrize(
    ("record", "said"),
    [
        pytest.param({**FRAME, "colour": 1}, "unknown key 'frame.colour'", id="unknown-key"),
        pytest.param({**FRAME, "seq": 2}, "seq is 2 and should be 1", id="wrong-number"),
        pytest.param({**START, "seq": 1}, "must be of kind session", id="second-start"),
        pytest.param({**FRAME, "kind": "other"}, "kind", id="unknown-kind"),
        pytest.param({**FRAME, "led": -1}, "led", id="negative-led"),
        pytest.param({**FRAME, "exposure_us": 0}, "exposure_us", id="no-exposure"),
        pytest.param({**FRAME, "file": "/etc/passwd"}, "file", id="absolute"),
        pytest.param({**FRAME, "file": "frames/../../x.tif"}, "file", id="dots"),
        pytest.param({**FRAME, "file": "frames\\x.tif"}, "file", id="backslash"),
        pytest.param({**FRAME, "file": "frames/.."}, "file", id="parent"),
        pytest.param({**FRAME, "file": "frames/a/b.tif"}, "file", id="deeper"),
        pytest.param({**FRAME, "file": "frames/x.tif\n"}, "file", id="newline"),
        pytest.param({k: v for k, v in FRAME.items() if k != "status"}, "status", id="missing"),
    ],
)
def test_a_line_with_a_valid_hash_must_be_valid_itself(record: dict[str, Any], said: str) -> None:
    found = parse_journal(chain(START, record))
    assert found.damage is not None
    assert found.damage.startswith("line 2 is not understood")
    assert said in found.damage
    assert "\n" not in found.damage


@settings(deadline=None, max_examples=100)
@given(st.binary(max_size=200))
def test_any_bytes_are_parsed_without_an_error(data: bytes) -> None:
    assert parse_journal(data).lines == ()


@settings(deadline=None, max_examples=100)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=8,
    ).filter(lambda value: "Infinity" not in json.dumps(value))
)
def test_details_are_read_as_they_were_written(value: Any) -> None:
    found = parse_journal(chain(START, event(1, value=value)))
    assert found.damage is None
    assert found.lines[1].model_dump()["details"] == {"value": value}
