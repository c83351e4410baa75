"""Full and read-only disks: every command that writes exits with 3 and one line with the reason."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition import Session, verify_session, write_mask
from sgp.app import build, run

PROGRAM = Path(__file__).with_name("refusing_disk.py")


def _mounts() -> bool:
    try:
        return subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode == 0
    except OSError:
        return False


pytestmark = pytest.mark.skipif(not _mounts(), reason="mounting in a user namespace is not allowed")


def called(kind: str, disk: Path, commands: list[str]) -> list[tuple[str, int, str, str]]:
    """Run command lines on such a disk; return command, exit code, stdout and stderr of each."""
    lines = json.dumps([line.split() for line in commands])
    words = ["unshare", "-rm", sys.executable, PROGRAM, kind, disk, lines]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stderr
    return [tuple(end) for end in json.loads(done.stdout)]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated session, and results computed from it."""
    root = tmp_path_factory.mktemp("made")
    lights = f"--lights {root}/sim/derived/truth/lights.json"
    (root / "grey.toml").write_text(
        'name = "grey"\ndriver = "simulated"\nleds = 1\n[options]\nscene = "white-plane"\n'
        'width = 80\nheight = 64\ncamera = "inside"\nrealtime = false\n',
        encoding="utf-8",
    )
    (root / "series.toml").write_text(
        f'leds = "0-0"\nexposures_us = {[500 * n for n in range(1, 82, 8)]}\nrepeats = 2\n',
        encoding="utf-8",
    )
    series = f"--rig {root}/grey.toml --plan {root}/series.toml --skip-check"
    for line in (
        f"capture run {root}/grey {series}",
        f"simulate coin --out {root}/sim --size 64x52 --led-count 6",
        f"simulate white-plane --out {root}/card --size 64x52 --led-count 6",
        f"normals {root}/sim {lights} --out {root}/normals",
        f"surface {root}/normals --out {root}/surface",
        f"capture export {root}/sim {lights} --format lp --out {root}/lp",
    ):
        assert run(build(), line.split()) == 0
    holes = np.zeros((52, 64), np.bool_)
    holes[24:30, 30:36] = True
    write_mask(root / "holes.png", holes)
    (root / "rig.toml").write_text(
        'name = "small"\ndriver = "simulated"\nleds = 2\n[options]\nwidth = 64\nheight = 52\n',
        encoding="utf-8",
    )
    (root / "plan.toml").write_text("leds = [0, 1]\nexposures_us = [5000]\n", encoding="utf-8")
    return root


def writers(made: Path, disk: Path) -> list[str]:
    """Return a command line for each writer, with its output on the disk."""
    lights = f"--lights {made}/sim/derived/truth/lights.json"
    rig = f"--rig {made}/rig.toml"
    return [
        *(
            f"capture export {made}/sim {lights} --format {layout} --out {disk}/{layout}"
            for layout in ("exr", "diligent", "lp", "alicevision")
        ),
        f"capture import {made}/lp --out {disk}/imported",
        f"capture run {disk}/run {rig} --plan {made}/plan.toml --skip-check",
        f"capture info {made}/sim --sheet {disk}/sheet.png",
        f"simulate coin --out {disk}/sim --size 64x52 --led-count 4",
        f"simulate coin --out {disk}/plain --size 64x52 --led-count 4 --format diligent",
        f"run {made}/sim {lights} --out {disk}/result",
        f"normals {made}/sim {lights} --out {disk}/normals",
        f"surface {made}/normals --out {disk}/surface --glb",
        f"curvature {made}/normals --out {disk}/curvature",
        f"export {made}/normals --out {disk}/rti",
        f"report {made}/normals --out {disk}/report.html",
        f"detail separate {made}/normals --out {disk}/parts",
        f"detail combine {made}/normals {made}/normals --out {disk}/back",
        f"detail transfer {made}/normals {made}/normals --out {disk}/transfer",
        f"detail properties {made}/normals --out {disk}/properties",
        f"detail synthesize {made}/normals --size 60x60 --patch 12 --out {disk}/sheet",
        f"detail fill {made}/normals --patch 9 --holes {made}/holes.png --out {disk}/filled",
        f"detail superres {made}/normals --scale 2 --method bicubic --out {disk}/large",
        f"compare {made}/normals {made}/normals --out {disk}/compare",
        f"project {made}/surface/surface.ply --out {disk}/project",
        f"calibrate intensities {made}/sim {lights} --out {disk}/card.json",
        f"calibrate flat {made}/card {lights} --out {disk}/flat",
        f"calibrate sensor {made}/grey --out {disk}/sensor",
        f"rig snap {rig} --led 1 --out {disk}/snap.tif",
        f"demo --out {disk}/demo",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "reason", "remedy"),
    [
        pytest.param("full", "No space left on device", "free space on this disk"),
        pytest.param(
            "read-only",
            "Read-only file system",
            "mount it writable or choose another folder",
        ),
    ],
)
def test_every_writer_reports_the_disk_error(
    made: Path, tmp_path: Path, kind: str, reason: str, remedy: str
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    for what, code, out, err in called(kind, disk, writers(made, disk)):
        errors = [line for line in err.splitlines() if line.startswith("error: ")]
        assert (what, code, out, len(errors)) == (what, 3, "", 1), err
        assert str(disk) in errors[0], errors
        assert reason in errors[0], errors
        assert remedy in errors[0], errors
        assert "[Errno" not in err


@pytest.mark.slow
def test_a_read_only_session_is_read_and_its_state_is_reported(made: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    for name in ("whole", "compact", "cut"):
        shutil.copytree(made / "sim", disk / name)
    assert run(build(), ["capture", "compact", str(disk / "compact")]) == 0
    (disk / "cut" / "COMPLETE").unlink()
    commands = [
        f"capture verify {disk}/whole",
        f"capture info {disk}/compact",
        f"capture compact {disk}/compact",
        f"capture compact {disk}/whole",
        f"capture compact {disk}/cut",
        f"normals {disk}/whole --out {disk}/whole/derived/normals "
        f"--lights {made}/sim/derived/truth/lights.json",
    ]
    verify, info, again, *refused = called("read-only", disk, commands)
    assert [end[1] for end in (verify, info, again)] == [0, 0, 0], again
    for _, code, _, err in refused:
        assert code == 3, err
        assert "Read-only file system; the disk is read-only: mount it writable" in err
        assert "compact it again" not in err
        assert "[Errno" not in err
    assert "whole: the compaction changed nothing" in refused[0][3]
    assert verify_session(disk / "whole").complete
    assert not Session.open(disk / "cut").complete
