"""One schema for all readers: a session with a line that violates the format is refused."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    Calibrations,
    DataError,
    Lights,
    Session,
    read_source,
    record,
    verify_session,
)
from acquisition.files.storage import sha256_of
from acquisition.session import GENESIS, SessionWriter, parse_journal
from acquisition.session.event_details import details_complaint
from rig import CameraError
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, rig_on
from tests.acquisition.mutants import LAYOUTS, mutant, read_by_all, rows_of, seal
from tests.quick_sample import quick

GOLDEN = Path(__file__).parent
ABSENT = object()

PERCENTILES = {"0": 4, "1": 4, "50": 1844, "99": 3764, "99.9": 3764, "100": 3764}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(shutil.copytree(GOLDEN / "golden_session_3", tmp_path / "s"))


def light_of(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the line of the first light: 8 x 6 pixels of 0, 80 ... 3760 plus 4, of 12 bits."""
    return next(row for row in rows if row.get("role") == "light")


@pytest.mark.parametrize("version", quick([1, 2, 3], every=3))
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("percentiles_dn", {}),
        ("percentiles_dn", {"0": 4, "1": 4, "50": 1844, "99": 3764, "100": 3764}),
        ("percentiles_dn", {**PERCENTILES, "75": 3000}),
        ("percentiles_dn", {**PERCENTILES, "1": 3}),
        ("percentiles_dn", {**PERCENTILES, "100": 3763}),
        ("percentiles_dn", {**PERCENTILES, "99.9": 4095, "100": 4096}),
        ("percentiles_dn", {**PERCENTILES, "0": -1}),
        ("percentiles_dn", {**PERCENTILES, "0": 4.0}),
        ("percentiles_dn", {**PERCENTILES, "0": True}),
        ("percentiles_dn", [4, 4, 1844, 3764, 3764, 3764]),
        ("percentiles_dn", None),
        ("time_utc", "yesterday"),
        ("time_utc", "2026-02-30T00:00:00+00:00"),
        ("time_utc", "2026-03-04"),
        ("time_utc", ""),
        ("time_utc", 5),
        ("clipped_fraction", -0.1),
        ("clipped_fraction", 1.1),
        ("clipped_fraction", None),
        ("sharpness", -1.0),
        ("sharpness", "0.2"),
        ("exposure_us", 0),
        ("exposure_us", -5.0),
        ("exposure_us", 1e300),
        ("exposure_us", True),
        ("gain_db", "1"),
        ("temperature_c", []),
        ("frame_id", 1.5),
        ("frame_id", 10**30),
        ("timestamp_ns", 2**64),
        ("bytes", 0),
        ("bytes", "218"),
        ("bytes", 50),
        ("led", None),
        ("led", 3.0),
        ("led", "3"),
        ("led", 2**31),
        ("bracket", -1),
        ("bracket", 2),
        ("repeat", 1),
        ("role", "flat"),
        ("role", "dark"),
        ("role", "night"),
        ("status", "good"),
        ("status", None),
        ("echo", {}),
        ("echo", {"seq": 1}),
        ("echo", []),
        ("origin", 5),
        ("file", "frames/../x.tif"),
        ("file_sha256", "AB" * 32),
        ("pixels_sha256", "0" * 63),
        ("colour", "red"),
        ("sharpness", ABSENT),
        ("origin", ABSENT),
        ("echo", ABSENT),
    ],
)
def test_a_line_that_violates_the_format_is_refused(
    tmp_path: Path, version: int, key: str, value: Any
) -> None:
    name = "golden_session" if version == 1 else f"golden_session_{version}"
    folder = Path(shutil.copytree(GOLDEN / name, tmp_path / "s"))
    rows = rows_of(folder)
    row = light_of(rows)
    if value is ABSENT:
        del row[key]
    else:
        row[key] = value
    seal(folder, rows)
    for reader in (Session.open, read_source, SessionWriter.reopen):
        with pytest.raises(DataError, match=rf"journal\.jsonl: line {row['seq'] + 1}\b") as caught:
            reader(folder)
        assert "\n" not in str(caught.value)
    assert f"line {row['seq'] + 1}" in verify_session(folder).problems[0]


@pytest.mark.parametrize(
    ("version", "change"),
    [
        pytest.param(1, lambda row: row.update(mean_dn=1884.0), id="a key of version 2 in 1"),
        pytest.param(1, lambda row: row["echo"].update(lit_us=1), id="an echo of version 2 in 1"),
        pytest.param(2, lambda row: row.pop("mean_dn"), id="a key of version 2 not in 2"),
        pytest.param(3, lambda row: row.pop("above_dark"), id="a key of version 2 not in 3"),
        pytest.param(3, lambda row: row["echo"].pop("lit_us"), id="an echo of version 1 in 3"),
        pytest.param(3, lambda row: row.update(mean_dn=5000.0), id="a mean above the maximum"),
        pytest.param(3, lambda row: row.update(mean_dn=3.0), id="a mean below the minimum"),
        pytest.param(3, lambda row: row["echo"].update(seq=True), id="an echo that is true"),
        pytest.param(3, lambda row: row["echo"].update(led=-1), id="an echo of no LED"),
        pytest.param(3, lambda row: row["echo"].update(more=1), id="an echo with more"),
    ],
)
def test_a_line_has_the_keys_of_its_version(
    tmp_path: Path, version: int, change: Callable[[dict[str, Any]], object]
) -> None:
    name = "golden_session" if version == 1 else f"golden_session_{version}"
    folder = Path(shutil.copytree(GOLDEN / name, tmp_path / "s"))
    rows = rows_of(folder)
    change(light_of(rows))
    seal(folder, rows)
    with pytest.raises(DataError, match=rf"line {light_of(rows)['seq'] + 1}\b"):
        Session.open(folder)


def test_frames_without_an_led_have_no_difference_from_the_dark(folder: Path) -> None:
    rows = rows_of(folder)
    next(row for row in rows if row.get("role") == "dark")["above_dark"] = 0.5
    seal(folder, rows)
    with pytest.raises(DataError, match="a dark frame has no above_dark"):
        Session.open(folder)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("clipped_fraction", 0.25, "other grey values"),
        ("mean_dn", 1884.5, "other grey values"),
        ("percentiles_dn", {**PERCENTILES, "50": 1845}, "other grey values"),
        ("sharpness", 7.0, None),
    ],
)
def test_the_figures_of_a_frame_are_those_of_its_pixels(
    folder: Path, key: str, value: Any, said: str | None
) -> None:
    """A resumed recording judges frames by these figures, but not by the sharpness."""
    rows = rows_of(folder)
    light_of(rows)[key] = value
    seal(folder, rows)
    found = verify_session(folder)
    assert [said in problem for problem in found.problems if said] == ([True] if said else [])
    assert found.ok == (said is None)


def sealed(text: str, previous: str) -> bytes:
    own = sha256_of((previous + text).encode())
    return f'{text},"line_sha256":"{own}"}}\n'.encode()


START = (
    '{"kind":"session","seq":0,"time_utc":"2026-03-04T05:06:07Z","session_toml_sha256":"'
    + "a" * 64
    + '"'
)
EVENT = '{"kind":"event","seq":1,"time_utc":"2026-03-04T05:06:07Z","event":"note","details":'


@pytest.mark.parametrize(
    ("details", "said"),
    [
        pytest.param("{}", None, id="good"),
        pytest.param('{"a":1,"a":2}', "a key appears twice", id="a key twice"),
        pytest.param('{},"event":"left_out"', "a key appears twice", id="another event"),
        pytest.param('{"a":NaN}', "NaN", id="NaN"),
        pytest.param('{"a":-Infinity}', "Infinity", id="infinite"),
        pytest.param('{"a":1e999}', "finite", id="too large"),
        pytest.param('{"a":' + "9" * 5000 + "}", "", id="digits without end"),
        pytest.param('{"a":' + "[" * 50_000 + "]" * 50_000 + "}", "", id="nested without end"),
        pytest.param('{"a":"ü"}', "", id="not ASCII"),
    ],
)
def test_a_line_is_unambiguous_json(details: str, said: str | None) -> None:
    first = sealed(START, GENESIS)
    data = first + sealed(EVENT + details, json.loads(first)["line_sha256"])
    found = parse_journal(data)
    if said is None:
        assert (found.damage, len(found.lines)) == (None, 2)
        return
    assert found.damage is not None
    assert "line 2 is not understood" in found.damage
    assert said in found.damage


# For each event valid details, and details that its schema refuses.
EVENTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "checked": (
        {"checks": [{"name": "disk", "state": "ok", "text": "room", "free_bytes": 5}]},
        {"checks": ["disk"]},
    ),
    "left_out": ({"leds": [1], "reason": "dead"}, {"leds": ["1"]}),
    "retake": ({"reason": "", "led": None, "file": "D.tif", "failures": 1}, {"led": 1}),
    "no_light_seen": ({"led": 1, "exposure_us": 5.0}, {"led": 1, "exposure_us": 0}),
    "paused": ({"reason": "", "waiting": 5}, {"reason": "", "waiting": -1}),
    "resumed": ({"seconds": 0.5}, {"seconds": "long"}),
    "not_sequenced": ({"reason": ""}, {}),
    "interrupted": ({"reason": "", "leds_confirmed_off": True}, {"leds_confirmed_off": True}),
    "failed": ({"reason": "", "leds_confirmed_off": False}, {"reason": None}),
    "reopened": ({"software_version": "1", "torn": "", "unrecorded": []}, {"torn": ""}),
    "imported": ({"source": "x", "iso": None, "black_levels_dn": [1.0]}, {"iso": 100}),
    "watched": ({"shots": ["L00_E0.tif"], "vendor": ""}, {"shots": [0]}),
    "note": ({}, {}),
}


@pytest.mark.parametrize("event", EVENTS)
def test_events_are_checked_if_the_format_knows_them(event: str) -> None:
    good, bad = EVENTS[event]
    assert details_complaint(event, good, 3) is None
    assert (details_complaint(event, bad, 3) is None) == (event == "note")
    # Details for people never make an older session unreadable.
    assert (details_complaint(event, bad, 2) is None) == (event != "left_out")
    assert details_complaint(event, bad, 1) is None


def test_the_writer_refuses_events_that_readers_refuse(folder: Path) -> None:
    (folder / "COMPLETE").unlink()
    with SessionWriter.reopen(folder) as writer:
        for event, (good, bad) in EVENTS.items():
            if event == "reopened":
                continue
            writer.write_event(event, **good)
            if event != "note":
                with pytest.raises(DataError, match=f"the event '{event}' is invalid"):
                    writer.write_event(event, **bad)
    assert verify_session(folder).ok


# ---------------------------------------------------------------- links


@pytest.mark.parametrize("name", ["session.toml", "journal.jsonl", "COMPLETE", "frames"])
@pytest.mark.parametrize("there", [True, False])
def test_a_part_that_is_a_link_out_of_the_session_is_damage(
    folder: Path, name: str, there: bool
) -> None:
    outside = folder.parent / "outside"
    (folder / name).rename(outside)
    (folder / name).symlink_to(outside)
    if not there:
        (folder / name).unlink()
        (folder / name).symlink_to(folder.parent / "nowhere")
    for reader in (Session.open, read_source, SessionWriter.reopen):
        with pytest.raises(DataError, match=rf"{name}: is a link that leaves the session"):
            reader(folder)
    assert any(name in problem for problem in verify_session(folder).problems)


def test_the_session_itself_may_be_named_by_a_link(folder: Path) -> None:
    (folder.parent / "link").symlink_to(folder)
    assert verify_session(folder.parent / "link").ok


# ---------------------------------------------------------------- lost lines


@pytest.mark.parametrize("gone", [1, 2, 3, 8])
def test_files_without_lines_are_a_hint_that_lines_were_lost(tmp_path: Path, gone: int) -> None:
    folder = Path(shutil.copytree(GOLDEN / "golden_session_2", tmp_path / "s"))
    rows = rows_of(folder)
    frames = [number for number, row in enumerate(rows) if row["kind"] == "frame"]
    seal(folder, rows[: frames[-gone]], complete=False)
    said = f"{gone} files without a line" if gone > 1 else "1 file without a line"
    for warnings in (
        Session.open(folder).warnings,
        read_source(folder).warnings,
        verify_session(folder).warnings,
    ):
        hints = [notice for notice in warnings if said in notice.text]
        assert [notice.where for notice in hints] == [str(folder / "frames")]
        assert [notice.code for notice in hints] == [
            "journal-lines-lost" if gone > 2 else "frames-without-line"
        ]
        lost = "may have lost its last lines: restore journal.jsonl" in str(hints[0])
        assert lost == (gone > 2)
    # A resume loses nothing: the files are kept.
    SessionWriter.reopen(folder).close()
    assert len(list((folder / "derived/unrecorded").iterdir())) == gone
    codes = {notice.code for notice in Session.open(folder).warnings}
    assert codes.isdisjoint({"frames-without-line", "journal-lines-lost"})


# ---------------------------------------------------------------- one value changed


def recorded(folder: Path, *, cut: bool) -> Path:
    """Record a session that exercises every reader."""
    bench = Bench()
    if cut:
        bench.unplug_at(9)
    positions = np.array([[300.0, 0, 300], [0, 300, 300], [200, 200, 300]])
    lights = Lights(positions_mm=positions, ids=("L03", "L00", "L05"))
    checks = [{"name": "disk", "state": "ok", "text": "room", "free_bytes": 5}]
    events = [("checked", {"checks": checks})]
    with rig_on(bench) as rig:
        try:
            record(
                rig,
                PLAN.changed(flats=1),
                folder,
                LABELS,
                events=events,
                calibrations=Calibrations(lights=lights),
            )
        except CameraError:
            assert cut
    return folder


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("models")
    ours = [recorded(root / "whole", cut=False), recorded(root / "cut", cut=True)]
    return [*ours, *(GOLDEN / f"golden_session{end}" for end in ("", "_2", "_3", "_4"))]


def attacked(models: list[Path], root: Path, seed: int, *, by_all: bool = True) -> list[str]:
    """Return what the readers do wrong: all, or with one drawn layout and option of a resume."""
    dice = random.Random(seed)
    folder = root / str(seed)
    folder.mkdir()
    shutil.copytree(dice.choice(models), folder / "s")
    said = mutant(folder / "s", dice)
    drawn: dict[str, Any] = (
        {}
        if by_all
        else {"layouts": [dice.choice(list(LAYOUTS))], "retakes": [dice.random() < 0.5]}
    )
    wrong = [f"seed {seed}, {said}: {line}" for line in read_by_all(folder / "s", folder, **drawn)]
    shutil.rmtree(folder)
    return wrong


@pytest.mark.slow
def test_no_changed_value_breaks_a_reader(models: list[Path], tmp_path: Path) -> None:
    # 184 and 564 rename a stored light, so that no light is that of a frame.
    assert [
        line for seed in (*range(20), 184, 564) for line in attacked(models, tmp_path, seed)
    ] == []


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_no_changed_value_breaks_a_reader_many_seeds(models: list[Path], tmp_path: Path) -> None:
    wrong = [line for seed in range(150) for line in attacked(models, tmp_path, seed, by_all=False)]
    assert wrong == []
