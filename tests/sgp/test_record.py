"""Records of results: written as docs/result-format.md says, and read back or refused by name."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import DataError, MissingPathError
from rig import Notice
from sgp import read_record
from sgp._output import write_record
from sgp._result import Result

GOLDEN = """{
  "format": "sgp-result",
  "version": 1,
  "command": "sgp normals",
  "software": {
    "name": "surface-geometry-processing",
    "version": "VERSION"
  },
  "parameters": {
    "source": "INPUT",
    "order": 8,
    "mask": null
  },
  "inputs": {
    "INPUT": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
  },
  "outputs": {
    "normals": "normals.exr"
  },
  "metrics": {
    "pixels": 12,
    "error_deg": null,
    "worst_deg": [
      0.5,
      1.5
    ]
  },
  "warnings": [
    "in.png: the mask is missing",
    "one part"
  ],
  "notices": [
    {
      "code": "mask-missing",
      "text": "the mask is missing",
      "where": "in.png",
      "severity": "warning"
    },
    {
      "code": "one-part",
      "text": "one part",
      "where": "",
      "severity": "info"
    }
  ]
}
"""


NOTICES = (
    Notice("mask-missing", "the mask is missing", "in.png"),
    Notice("one-part", "one part", severity="info"),
)


@pytest.fixture
def record(tmp_path: Path) -> Path:
    source = tmp_path / "in.png"
    source.write_bytes(b"abc")
    result = Result(
        outputs={"normals": tmp_path / "normals.exr", "elsewhere": Path("/x/y.exr")},
        metrics={"pixels": 12, "error_deg": math.nan, "worst_deg": np.array([0.5, 1.5])},
        warnings=list(NOTICES),
        inputs=[source],
    )
    path = tmp_path / "normals.json"
    write_record(path, "sgp normals", {"source": source, "order": 8, "mask": None}, result)
    return path


def test_a_record_is_written_as_documented(record: Path) -> None:
    written = record.read_text()
    version = json.loads(written)["software"]["version"]
    expected = GOLDEN.replace("INPUT", str(record.parent / "in.png")).replace("VERSION", version)
    assert written == expected


def test_a_record_reads_back(record: Path) -> None:
    found = read_record(record)
    assert found.command == "sgp normals"
    assert found.outputs == {"normals": "normals.exr"}
    assert found.metrics == {"pixels": 12, "error_deg": None, "worst_deg": [0.5, 1.5]}
    assert found.warnings == ("in.png: the mask is missing", "one part")
    assert found.notices == NOTICES


def test_json_has_the_lines_and_the_notices() -> None:
    printed = json.loads(Result(warnings=list(NOTICES)).to_json())
    assert printed["warnings"] == ["in.png: the mask is missing", "one part"]
    assert printed["notices"] == [
        {
            "code": "mask-missing",
            "text": "the mask is missing",
            "where": "in.png",
            "severity": "warning",
        },
        {"code": "one-part", "text": "one part", "where": "", "severity": "info"},
    ]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        pytest.param({"version": 2}, "has version 2 of sgp-result", id="newer"),
        pytest.param({"version": None}, "has version None of sgp-result", id="no version"),
        pytest.param({"format": "other"}, "not the record of a result", id="another format"),
        pytest.param({"extra": 1}, "extra", id="unknown key"),
        pytest.param({"metrics": None}, "metrics", id="wrong type"),
        pytest.param({"inputs": {"a": "12"}}, "inputs", id="not a hash"),
        pytest.param({"command": 3}, "command", id="a number for a text"),
        pytest.param({"notices": [{"code": "A", "text": ""}]}, "kebab case", id="not a code"),
        pytest.param({"notices": [{"code": "a", "text": "", "x": 1}]}, "x", id="key in a notice"),
    ],
)
def test_other_records_are_refused(record: Path, changes: dict[str, Any], complaint: str) -> None:
    record.write_text(json.dumps(json.loads(record.read_text()) | changes))
    with pytest.raises(DataError, match=complaint) as caught:
        read_record(record)
    assert str(record) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "[]", "{", "null", '"x"'])
def test_what_is_not_a_record_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "normals.json"
    path.write_text(text)
    with pytest.raises(DataError, match=r"normals\.json"):
        read_record(path)


def test_a_missing_record(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match="no such file"):
        read_record(tmp_path / "normals.json")
