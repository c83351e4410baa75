"""Settings of the camera in a session, and changes since the camera's last session."""

import re
from dataclasses import replace

import pytest

from acquisition import Session, record, resume
from acquisition.engine import camera_notices
from tests.acquisition.fake_bench import LABELS, PLAN, Bench
from tests.acquisition.interruptions import interrupted

SETTINGS = {"ReadoutMode": "Normal", "BlackLevelClamp": True, "Level": 12, "Slope": 0.5}


def settings(bench, *turned_off, **changes):
    bench.info = replace(Bench.info, turned_off=turned_off, settings={**SETTINGS, **changes})


def stored(folder):
    events = Session.open(folder).events
    return [line.details for line in events if line.event == "camera_settings"]


def test_a_session_states_the_settings_of_its_camera(rig, bench, tmp_path):
    settings(bench, "GammaEnable")
    record(rig, PLAN, tmp_path / "s", LABELS)
    assert stored(tmp_path / "s") == [{"turned_off": ["GammaEnable"], "settings": SETTINGS}]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, None),
        ({"ReadoutMode": "Fast"}, "1 setting of camera 42 changed since .*ReadoutMode was Normal"),
        ({"Level": 13, "Slope": 1}, "2 settings .*Level was 12 and is 13, Slope was 0.5 and is 1"),
        ({"New": 1}, None),
    ],
)
def test_changes_since_the_last_session_are_named(rig, bench, tmp_path, changes, text):
    settings(bench, Level=99)
    record(rig, PLAN, tmp_path / "older", LABELS)
    settings(bench)
    record(rig, PLAN, tmp_path / "last", LABELS)
    settings(bench, **changes)
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "session.toml").write_text("no session")
    notices = camera_notices(rig, tmp_path / "new")
    if text is None:
        assert notices == ()
    else:
        (notice,) = notices
        assert notice.code == "camera-settings-changed"
        assert "since last:" in notice.text
        assert re.search(text, notice.text)


def test_another_camera_is_not_compared(rig, bench, tmp_path):
    settings(bench)
    record(rig, PLAN, tmp_path / "last", LABELS)
    settings(bench, Level=1)
    bench.info = replace(bench.info, serial="43")
    assert camera_notices(rig, tmp_path / "new") == ()


def test_a_resumed_session_is_compared_with_itself(rig, bench, tmp_path):
    settings(bench)
    interrupted(rig, bench, tmp_path / "s", 4)
    settings(bench, Level=1)
    (notice,) = camera_notices(rig, tmp_path / "s")
    assert "Level was 12 and is 1" in notice.text
    resume(rig, tmp_path / "s")
    assert [one["settings"]["Level"] for one in stored(tmp_path / "s")] == [12, 1]
