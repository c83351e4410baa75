"""What results are of: by the files of recordings, and by the records of earlier results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquisition import Identity, Labels, import_frames, read_source, write_png
from sgp import read_record
from sgp.report.sections import identity_list, marked
from sgp.results import Result, recordings_of, write_record

OWL = Identity("owl", "Ada", "storage", "clean", "CC BY", "2026-03-14T09:26:00+00:00")


@pytest.fixture
def session(tmp_path: Path) -> Path:
    write_png(tmp_path / "card.png", np.full((4, 5), 700, np.uint16))
    labels = Labels("Ada", "owl", "storage", "clean", "CC BY")
    return import_frames(read_source(tmp_path / "card.png"), tmp_path / "session", labels).folder


def record(folder: Path, **others: object) -> Path:
    """Write a map and a record that names it; return the map."""
    folder.mkdir()
    values = {"format": "sgp-result", "outputs": {"map": "map.exr"}, **others}
    (folder / "any.json").write_text(json.dumps(values))
    return folder / "map.exr"


def test_a_session_is_known_through_a_chain_of_results(session: Path, tmp_path: Path) -> None:
    inputs = [session / "session.toml", session / "journal.jsonl"]
    for number in range(3):
        folder = tmp_path / f"result-{number}"
        folder.mkdir()
        made = Result(outputs={"map": folder / "map.exr"}, inputs=inputs)
        made.outputs["map"].write_bytes(b"")
        write_record(folder / "any.json", "sgp any", {}, made)
        inputs = [folder / "map.exr"]
    (found,) = read_record(folder / "any.json").recordings
    assert (found.object, found.rights, found.simulated) == ("owl", "CC BY", False)
    assert found.started_utc[:2] == "20"


def test_several_recordings_are_listed_once_each(tmp_path: Path) -> None:
    both = [vars(OWL), {"object": "coin", "simulated": True}]
    maps = [record(tmp_path / "a", recordings=both), record(tmp_path / "b", recordings=both[:1])]
    assert recordings_of(maps) == [OWL, Identity("coin", simulated=True)]


def test_files_of_calibrations_do_not_count(tmp_path: Path) -> None:
    path = record(tmp_path / "a", recordings=[vars(OWL)])
    assert recordings_of([path]) == [OWL]
    for calibration in (path, path.parent):
        assert recordings_of([path], [calibration]) == []


@pytest.mark.parametrize(
    ("others", "found"),
    [
        pytest.param({}, [], id="of an earlier program"),
        pytest.param({"recordings": 3}, [], id="no list"),
        pytest.param({"recordings": [3]}, [Identity()], id="no object"),
        pytest.param(
            {"recordings": [{"object": 5, "simulated": "no", "rights": "x", "more": 1}]},
            [Identity(rights="x")],
            id="other types",
        ),
        pytest.param({"outputs": ["map.exr"], "recordings": [{}]}, [], id="outputs are a list"),
        pytest.param({"format": "other", "recordings": [{}]}, [], id="another format"),
    ],
)
def test_records_may_have_any_content(
    others: dict[str, object], found: list[Identity], tmp_path: Path
) -> None:
    assert recordings_of([record(tmp_path / "a", **others)]) == found


def test_texts_are_escaped_and_keep_their_lines() -> None:
    page = identity_list(Identity("<b>\u202e", notes="one\r\n<i>two", simulated=True))
    assert "&lt;b&gt;\\u202e" in page
    assert "<dd>one<br>&lt;i&gt;two</dd>" in page
    assert "SIMULATED" in page
    assert "Operator" not in page
    assert marked("owl", [OWL]) == "owl"
    assert marked("owl", [OWL, Identity(simulated=True)]) == "SIMULATED: owl"
