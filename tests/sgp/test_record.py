"""Records of results: written as docs/result-format.md says, and read back or refused by name."""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from acquisition import DataError, MissingPathError
from rig import Notice
from sgp import read_record
from sgp.results import Result, check_metrics, plain, write_record

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
    "images": 8,
    "lights": "distant",
    "pixels": 12,
    "coverage": 0.75,
    "residual_rms": null
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
  ],
  "files": {
    "normals.exr": {
      "bytes": 3,
      "sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    }
  },
  "record_sha256": "SEAL"
}
"""


METRICS = {
    "images": 8,
    "lights": "distant",
    "pixels": np.int64(12),
    "coverage": np.float64(0.75),
    "residual_rms": math.nan,
}
NOTICES = (
    Notice("mask-missing", "the mask is missing", "in.png"),
    Notice("one-part", "one part", severity="info"),
)


@pytest.fixture
def record(tmp_path: Path) -> Path:
    source = tmp_path / "in.png"
    source.write_bytes(b"abc")
    (tmp_path / "normals.exr").write_bytes(b"abc")
    result = Result(
        outputs={"normals": tmp_path / "normals.exr", "elsewhere": Path("/x/y.exr")},
        metrics=METRICS,
        warnings=list(NOTICES),
        inputs=[source],
    )
    path = tmp_path / "normals.json"
    write_record(path, "sgp normals", {"source": source, "order": 8, "mask": None}, result)
    return path


def refused(path: Path, complaint: str) -> None:
    with pytest.raises(DataError, match=complaint) as caught:
        read_record(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_record_is_written_as_documented(record: Path) -> None:
    written = record.read_text()
    values = json.loads(written)
    version = values["software"]["version"]
    expected = GOLDEN.replace("INPUT", str(record.parent / "in.png")).replace("VERSION", version)
    known = values.pop("record_sha256")
    assert written == expected.replace("SEAL", known)
    assert known == hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def test_a_record_reads_back(record: Path) -> None:
    found = read_record(record)
    assert found.command == "sgp normals"
    assert found.outputs == {"normals": "normals.exr"}
    assert found.metrics == METRICS | {"residual_rms": None}
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
    refused(record, complaint)


TRANSFER = {
    **{f"{part}_mae_deg{by}": 1.5 for part in ("shape", "detail") for by in ("", "_paper")},
    **{f"{part}_ssim{by}": 1 for part in ("shape", "detail") for by in ("", "_paper")},
    "pixels": 9,
}
STAGES = {
    "normals": METRICS,
    "detail": {"separability_deg": 0.5},
    "surface": {"unit": "px", "height_range": 2.5, "vertices": 9, "parts": 1, "iterations": 3},
}
RUN = STAGES | {"seconds": {"normals": 0.5}}


@pytest.mark.parametrize(
    ("command", "metrics"),
    [
        pytest.param("sgp normals", METRICS | {"mae_deg": 3, "median_deg": 2.5}, id="truth"),
        pytest.param("sgp detail transfer", TRANSFER, id="no optional figure"),
        pytest.param(
            "sgp detail transfer",
            TRANSFER | {"source_window": (0, 0, 3, 3), "tiles": (1, 2), "height_rms_px": 0.5},
            id="global transfer",
        ),
        pytest.param(
            "sgp detail transfer",
            TRANSFER | dict.fromkeys(["seam_step_deg", "interior_step_deg", "seam_ratio"]),
            id="local transfer without a seam",
        ),
        pytest.param("sgp run", RUN, id="run"),
        pytest.param("sgp run", RUN | {"normals_mae_deg": 3.5}, id="run with truth"),
        *(pytest.param("sgp run", STAGES[name], id=f"{name} of run") for name in STAGES),
        pytest.param("sgp new", {"anything": [None, "x"]}, id="a command of a newer program"),
        pytest.param("sgp normals", METRICS | {"new": [1, "x"]}, id="a figure of a newer program"),
        pytest.param(
            "sgp run",
            RUN | {"surface": STAGES["surface"] | {"new": None}},
            id="a figure of a newer program in a stage",
        ),
    ],
)
def test_figures_read_back(tmp_path: Path, command: str, metrics: dict[str, object]) -> None:
    path = tmp_path / "record.json"
    write_record(path, command, {}, Result(metrics=metrics))
    assert read_record(path).metrics == json.loads(path.read_text())["metrics"]


@pytest.mark.parametrize(
    ("command", "metrics", "complaint"),
    [
        ("sgp normals", {"images": 8}, "the key 'metrics.lights' is missing"),
        ("sgp normals", METRICS | {"images": 8.0}, "'metrics.images': .*integer, not 8.0"),
        ("sgp normals", METRICS | {"images": True}, "'metrics.images': .*integer, not True"),
        ("sgp normals", METRICS | {"coverage": "1"}, "'metrics.coverage': .*number, not '1'"),
        ("sgp normals", METRICS | {"coverage": math.nan}, "'metrics.coverage': .*number"),
        ("sgp normals", METRICS | {"lights": "far"}, "'metrics.lights': .*'near' or 'distant'"),
        ("sgp detail transfer", TRANSFER | {"tiles": [1]}, "'metrics.tiles.1' is missing"),
        ("sgp run", STAGES, "the key 'metrics.seconds' is missing"),
        ("sgp run", RUN | {"detail": {}}, "the key 'metrics.detail.separability_deg' is missing"),
        ("sgp run", STAGES["surface"] | {"parts": None}, "'metrics.parts': .*integer"),
        ("sgp run", RUN | {"seconds": {"x": "1"}}, "'metrics.seconds.x': .*number, not '1'"),
    ],
)
def test_other_figures_are_refused(
    tmp_path: Path, command: str, metrics: dict[str, object], complaint: str
) -> None:
    path = tmp_path / "record.json"
    write_record(path, command, {}, Result(metrics=metrics))
    refused(path, complaint)


@pytest.mark.parametrize(
    ("command", "metrics", "complaint"),
    [
        ("sgp normals", METRICS | {"pixel": 3}, "metrics.pixel"),
        ("sgp run", RUN | {"detail": {"separability_deg": 0.5, "x": 1}}, "metrics.detail.x"),
    ],
)
def test_this_program_has_only_figures_that_are_declared(
    command: str, metrics: dict[str, Any], complaint: str
) -> None:
    """The fixture `sgp` checks this for every command that it runs."""
    metrics = json.loads(json.dumps(plain(metrics)))
    check_metrics(command, metrics)
    with pytest.raises(ValidationError, match=complaint):
        check_metrics(command, metrics, declared_only=True)


def test_a_figure_that_is_not_finite_is_refused(record: Path) -> None:
    record.write_text(record.read_text().replace("0.75", "Infinity"))
    refused(record, r"metrics.coverage.*finite number")


@pytest.mark.parametrize("text", ["", "[]", "{", "null", '"x"'])
def test_what_is_not_a_record_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "normals.json"
    path.write_text(text)
    refused(path, r"normals\.json")


def test_a_missing_record(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match="no such file"):
        read_record(tmp_path / "normals.json")


def test_parameters_with_default_values_are_named(tmp_path: Path) -> None:
    path = tmp_path / "normals.json"
    given = {"method": "best", "order": 8, "crop": None, "white": np.ones(3)}
    defaults = {"method": "best", "order": 4, "crop": None}
    write_record(path, "sgp any", given, Result(), defaults=defaults)
    assert read_record(path).defaults == ("method", "crop")
