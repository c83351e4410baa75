from __future__ import annotations

import hashlib
import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from acquisition.session import GENESIS, EventLine, FrameLine, StartLine, encode_line, parse_journal

TIME = "2026-03-04T05:06:07.000000+00:00"
START = {"kind": "session", "seq": 0, "time_utc": TIME, "session_toml_sha256": "a" * 64}
PERCENTILES = {"0": 1, "1": 1, "50": 4, "99": 8, "99.9": 9, "100": 9}
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
    "percentiles_dn": PERCENTILES,
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


@settings(max_examples=300)
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


INVALID_LINES = {
    "unknown-key": ({**FRAME, "colour": 1}, "unknown key 'frame.colour'"),
    "wrong-number": ({**FRAME, "seq": 2}, "seq is 2 and should be 1"),
    "second-start": ({**START, "seq": 1}, "must be of kind session"),
    "unknown-kind": ({**FRAME, "kind": "other"}, "kind"),
    "negative-led": ({**FRAME, "led": -1}, "led"),
    "no-exposure": ({**FRAME, "exposure_us": 0}, "exposure_us"),
    "absolute": ({**FRAME, "file": "/etc/passwd"}, "file"),
    "dots": ({**FRAME, "file": "frames/../../x.tif"}, "file"),
    "backslash": ({**FRAME, "file": "frames\\x.tif"}, "file"),
    "parent": ({**FRAME, "file": "frames/.."}, "file"),
    "deeper": ({**FRAME, "file": "frames/a/b.tif"}, "file"),
    "newline": ({**FRAME, "file": "frames/x.tif\n"}, "file"),
    "missing": ({k: v for k, v in FRAME.items() if k != "status"}, "status"),
    "only-a-day": ({**FRAME, "time_utc": "2026-03-04"}, "in ISO 8601 format"),
    "month-13": ({**FRAME, "time_utc": "2026-13-04T05:06:07Z"}, "is not a date and time: "),
    "light-without-led": ({**FRAME, "led": None}, "a light frame needs an LED"),
    "dark-with-led": ({**FRAME, "role": "dark"}, "a dark frame has no LED, not 7"),
    "ambient-above-dark": (
        {**FRAME, "role": "ambient", "led": None, "above_dark": 0.1},
        "ambient frame has no above_dark",
    ),
    "few-percentiles": (
        {**FRAME, "percentiles_dn": {"0": 1, "100": 9}},
        "must have exactly the keys 0, 1, 50, 99, 99.9, 100",
    ),
    "percentiles-that-decrease": (
        {**FRAME, "percentiles_dn": {**PERCENTILES, "50": 9}},
        "must not decrease from 0 to 100 per cent",
    ),
}


@pytest.mark.parametrize(("record", "said"), INVALID_LINES.values(), ids=INVALID_LINES)
@pytest.mark.parametrize("ends", [True, False], ids=["", "no newline"])
def test_a_line_with_a_valid_hash_must_be_valid_itself(
    record: dict[str, Any], said: str, ends: bool
) -> None:
    data = chain(START, record)
    found = parse_journal(data if ends else data[:-1])
    assert found.damage is not None
    assert found.damage.startswith("line 2 is not understood")
    assert said in found.damage
    assert "\n" not in found.damage
    assert len(found.lines) == 1


# For each key the least and the greatest value, and values beyond them.
LIMITS: dict[str, tuple[tuple[Any, ...], tuple[Any, ...]]] = {
    "led": ((0, 2**31 - 1), (2**31, 7.0, "7", True)),
    "exposure_us": ((0.25, 1e12, None), (0.0, 1.5e12)),
    "bytes": ((1, 2**63 - 1), (0, 2**63)),
    "frame_id": ((-(2**63), -1, 2**64 - 1, None), (-(2**63) - 1, 2**64)),
    "clipped_fraction": ((0.0, 1.0), (-0.5, 1.5)),
    "sharpness": ((0.0,), (-0.5,)),
    # Percentiles 0 and 100 are 1 and 9.
    "mean_dn": ((1 - 1e-4, 1.0, 9.0, 9 + 1e-4, None), (1 - 1.5e-4, 9 + 1.5e-4, 100.0)),
    "above_dark": ((-0.5, 0.5, None), ("0.5",)),
    "percentiles_dn": (
        ({**PERCENTILES, "0": 0}, {**PERCENTILES, "100": 65_535}),
        ({**PERCENTILES, "0": -1}, {**PERCENTILES, "100": 65_536}),
    ),
    "echo": (
        ({"seq": 3, "led": 7, "lit_us": 0}, {"seq": 3, "led": None, "lit_us": 2**63 - 1}),
        ({"seq": 3, "led": 7, "lit_us": -1}, {"seq": 3, "led": 7, "lit_us": 2**63}),
    ),
}


@pytest.mark.parametrize("key", LIMITS)
def test_the_limits_of_values(key: str) -> None:
    for ours, number in zip(LIMITS[key], (2, 1), strict=True):
        for value in ours:
            found = parse_journal(chain(START, {**FRAME, key: value}))
            assert (len(found.lines), found.damage is None) == (number, number == 2), value


@pytest.mark.parametrize(
    ("text", "said"),
    [
        pytest.param('{"seq":1,"seq":1', "a key appears twice", id="a key twice"),
        pytest.param('{"seq":NaN', "NaN is not JSON", id="NaN"),
        pytest.param('[{"seq":1', "it is not a JSON object", id="not closed"),
        pytest.param(json.dumps(FRAME)[:-1].replace("0.5", "1e999"), "finite", id="infinite"),
    ],
)
def test_a_line_with_a_valid_hash_must_be_json(text: str, said: str) -> None:
    first = chain(START)
    own = hashlib.sha256((json.loads(first)["line_sha256"] + text).encode()).hexdigest()
    found = parse_journal(first + f'{text},"line_sha256":"{own}"}}\n'.encode())
    assert found.damage is not None
    assert found.damage.startswith("line 2 is not understood: ")
    assert said in found.damage


def test_a_journal_starts_with_the_line_of_the_session() -> None:
    found = parse_journal(chain(event(0)))
    assert found.damage is not None
    assert "line 1 is not understood: the first line, and no other, must be of" in found.damage


def test_values_that_are_not_json_are_not_written() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        encode_line(event(1, value=float("nan")), GENESIS)


def test_lines_have_their_identity_and_cannot_be_changed() -> None:
    start, frame, note, _ = parse_journal(GOOD).lines
    assert isinstance(start, StartLine)
    assert isinstance(frame, FrameLine)
    assert frame.key == ("light", 7, 0, 0)
    assert repr(frame) == "FrameLine(1, frames/L07_E0.tif, ok)"
    assert repr(note) == "EventLine(2, note)"
    with pytest.raises(ValidationError, match="frozen"):
        frame.status = "rejected"


@pytest.mark.parametrize(
    ("name", "details", "leds"),
    [
        pytest.param("left_out", {"leds": [3, 1, 3]}, {1, 3}, id="left out"),
        pytest.param("left_out", {"leds": [True, "2", 2.0, 4]}, {4}, id="not all whole numbers"),
        pytest.param("left_out", {"leds": 3}, set(), id="not a list"),
        pytest.param("left_out", {}, set(), id="none named"),
        pytest.param("retake", {"leds": [3]}, set(), id="another event"),
    ],
)
def test_leds_that_are_left_out(name: str, details: dict[str, Any], leds: set[int]) -> None:
    line = EventLine(seq=1, time_utc=TIME, event=name, details=details)
    assert line.left_out == leds


@settings(max_examples=100)
@given(st.binary(max_size=200))
def test_any_bytes_are_parsed_without_an_error(data: bytes) -> None:
    assert parse_journal(data).lines == ()


@settings(max_examples=50)
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
