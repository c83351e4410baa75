"""``sgp rig selftest`` on simulated rigs: faults are named, and what cannot be excluded."""

import json

import pytest


@pytest.mark.slow
def test_the_rig_without_a_file_is_not_asked_to_change_one(sgp):
    assert "rig file" not in sgp("rig", "selftest", "--rig", "simulated").ok().err


SIMULATED = """
name = "dome"
driver = "simulated"
leds = 12
[options]
width = 160
height = 128
scene = "plane"
{wiring}
"""


@pytest.mark.parametrize(
    ("wiring", "code", "message"),
    [
        pytest.param("", 0, "no faults", id="in order", marks=pytest.mark.slow),
        pytest.param(
            "wiring = {swapped = [[3, 7]]}",
            3,
            "the light of LED 3 is from the place of LED 7",
            id="swapped",
        ),
        pytest.param("lamps = {dead = [5]}", 3, "1 fault", id="dead", marks=pytest.mark.slow),
    ],
)
def test_the_self_test_reports_its_findings(sgp, tmp_path, wiring, code, message):
    file = tmp_path / "rig.toml"
    file.write_text(SIMULATED.format(wiring=wiring))
    answer = sgp("rig", "selftest", "--rig", file)
    assert answer.code == code, answer.err
    assert message in answer.out
    report = json.loads(sgp("rig", "selftest", "--rig", file, "--json").out)
    assert report["ok"] == (code == 0)
    assert report["metrics"]["wires"] == {"trigger": True, "exposure_active": True}
    assert bool([one for one in report["metrics"]["findings"] if one["fault"]]) == (code != 0)


@pytest.mark.slow
def test_the_self_test_says_if_swaps_cannot_be_excluded(sgp, tmp_path):
    """With eight LEDs this swap pulls the fit, so that no LED can be named."""
    file = tmp_path / "rig.toml"
    text = SIMULATED.format(wiring="wiring = {swapped = [[0, 1]]}")
    file.write_text(text.replace("12", "8", 1).replace("plane", "coin"))
    answer = sgp("rig", "selftest", "--rig", file).ok()
    assert "no faults found, but swapped LEDs could not be excluded" in answer.out
    assert "a swap of these or of other LEDs would not be noticed" in answer.err
