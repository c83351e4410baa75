"""Simulated recordings say so, whatever the rig file is called."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import sgp.commands.run as sgp_run
from acquisition import Session, read_image, read_source, write_lights
from acquisition.session import CameraRecord, Manifest, RigRecord
from sgp.pictures import source_title
from tests.cases import cases
from tests.quick_sample import quick
from tests.sgp.conftest import ring_lights

GOLDEN = Path(__file__).parents[1] / "acquisition" / "golden_session_3"
CAMERA = {"width": 4, "height": 4, "bit_depth": 12, "vendor": "Maker", "model": "Eye"}
RIG = {"name": "dome", "driver": "bench", "board": "sgp-led-board", "protocol": "2"}
RIG |= {"firmware": "1", "leds": 4}


def manifest(camera=(), rig=(), **others):
    return Manifest.begin(
        "session",
        camera=CAMERA | dict(camera),
        rig=None if rig is None else RigRecord(**(RIG | dict(rig))),
        **others,
    )


@cases(
    ("one", "simulated"),
    {
        "bench": (manifest(), False),
        "imported": (manifest(rig=None), False),
        "a camera of our own": (manifest(camera={"vendor": "sgp"}), False),
        "driver": (manifest(rig={"driver": "simulated"}), True),
        "board": (manifest(rig={"board": "sgp-virtual-board"}), True),
        "camera through GenTL": (manifest({"vendor": "sgp", "model": "virtual camera"}), True),
        "imported from an export": (
            manifest({"vendor": "sgp", "model": "virtual camera in Python (no compiler)"}, None),
            True,
        ),
        "imported, by its origin": (manifest(rig=None, origin="simulated"), True),
    },
)
def test_the_devices_show_whether_a_recording_is_simulated(one, simulated):
    assert one.simulated is simulated


def test_the_simulator_identifies_itself(simulated_rig):
    """The session knows the virtual devices by the names that they report."""
    board, camera = simulated_rig.board.identity, simulated_rig.camera.info
    assert RigRecord(**(RIG | {"board": board.name})).simulated
    assert CameraRecord(**(CAMERA | {"vendor": camera.vendor, "model": camera.model})).simulated


@pytest.mark.parametrize("camera", quick(["inside", "gentl"], every=2))
def test_every_output_says_simulated(sgp, tmp_path, camera):
    rig = tmp_path / "rig.toml"
    rig.write_text(
        'name = "dome one"\ndriver = "simulated"\nleds = 6\n'
        f'[options]\nscene = "coin"\nwidth = 96\nheight = 80\ncamera = "{camera}"\n'
    )
    session, sheet, export, copy = (tmp_path / name for name in ("s", "s.png", "e", "c"))
    mark = "SIMULATED, with a virtual board or camera"
    assert mark in sgp("capture", "run", session, "--rig", rig, "--skip-check").ok().out
    answer = sgp("capture", "info", session, "--sheet", sheet, "--json")
    assert json.loads(answer.out)["metrics"]["simulated"] is True
    # The mark is in the label of each of the eight frames.
    picture = read_image(sheet)[:-26].astype(int)  # without the legend, which is red too
    red = (picture[..., 0] - picture[..., 1] > 90).nonzero()
    assert len({(row // 211, column // 204) for row, column in zip(*red, strict=True)}) == 8
    write_lights(tmp_path / "lights.json", ring_lights(6))
    words = ("--format", "lp", "--lights", tmp_path / "lights.json", "--out", export)
    sgp("capture", "export", session, *words).ok()
    assert sgp("capture", "import", export, "--out", copy).code == 0
    assert mark in sgp("capture", "info", copy).out
    for source in (read_source(session), read_source(copy), read_source(export)):
        assert source_title(source, "owl") == "SIMULATED: owl"
        assert source_title(replace(source, simulated=False), "owl") == "owl"


@pytest.mark.slow
def test_the_overview_says_simulated(sgp, simulated_session, tmp_path, monkeypatch):
    titles = []
    monkeypatch.setattr(sgp_run, "write_overview", lambda path, title, panels: titles.append(title))
    lights = simulated_session / "derived" / "truth" / "lights.json"
    sgp("run", simulated_session, "--lights", lights, "--out", tmp_path / "out").ok()
    assert titles == [f"SIMULATED: {simulated_session.name}"]


def test_a_recording_of_a_bench_says_nothing(sgp):
    assert not Session.open(GOLDEN).manifest.simulated
    assert "SIMULATED" not in sgp("capture", "info", GOLDEN).out
