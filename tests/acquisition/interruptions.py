"""Recordings that the camera interrupts, and their sessions in older formats."""

from __future__ import annotations

import tomllib
from pathlib import Path

import tomli_w

from acquisition import Calibrations, NoiseModel, Session
from acquisition.session.manifest import _ADDED
from rig import CameraError, Rig
from tests.acquisition.fake_bench import Bench, cut
from tests.acquisition.mutants import rows_of, seal


def interrupted(
    rig: Rig, bench: Bench, folder: Path, at: int, sensor: NoiseModel | None = None
) -> Session:
    """Record until the camera fails at a given frame."""
    return Session.open(cut(rig, bench, folder, at, calibrations=Calibrations(sensor=sensor)))


def fail_after(number: int, last: int) -> None:
    if number > last:
        raise CameraError("the camera was unplugged")


def make_older(folder: Path, version: int) -> None:
    """Rewrite ``session.toml`` and every line in an older format version."""
    path = folder / "session.toml"
    manifest = tomllib.loads(path.read_text(encoding="utf-8"))
    manifest["format_version"] = version
    for tables in (each for since, each in _ADDED.items() if version < since):
        for table, keys in tables.items():
            for key in keys:
                (manifest.get(table, {}) if table else manifest).pop(key, None)
    path.write_text(tomli_w.dumps(manifest), encoding="utf-8")
    rows = rows_of(folder)
    for row in rows:
        if version == 1 and row["kind"] == "frame":
            del row["mean_dn"], row["above_dark"]
            if row["echo"]:
                del row["echo"]["lit_us"], row["echo"]["active_us"]
    seal(folder, rows)
