"""``sgp doctor``: one line for each finding, each with its remedy; no check can crash it."""

import json
import os
import shutil
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

import sgp.commands.doctor as doctor


@pytest.fixture
def examine(sgp, monkeypatch):
    """Run only some checks; return the exit code and the findings."""

    def run(*names):
        chosen = {name: doctor._CHECKS[name] for name in names}
        monkeypatch.setattr(doctor, "_CHECKS", chosen)
        answer = sgp("doctor", "--json")
        report = json.loads(answer.out)
        assert report["ok"] == (answer.code == 0)
        return answer.code, [(one["state"], one["text"]) for one in report["metrics"]["checks"]]

    return run


def test_every_check_reports_on_this_computer(sgp, monkeypatch):
    def touched(*_):
        raise AssertionError("a port was opened")

    monkeypatch.setattr("serial.Serial.open", touched)
    answer = sgp("doctor")
    assert "cannot be checked" not in answer.out
    *printed, last = answer.out.splitlines()
    assert max(map(len, printed)) <= 80
    lines = [line for line in printed if not line.startswith(" ")]
    assert {line.split()[1] for line in lines} == set(doctor._CHECKS)
    states = {line.split()[0] for line in lines}
    assert states <= {"ok", "warning", "error"}
    assert answer.code == (3 if "error" in states else 0)
    assert "numpy 2" in " ".join(answer.out.split())
    assert (last == "nothing needs attention") == (states == {"ok"})


LONG_PATHS = {
    "as long as the column": ("/home/", 60),
    "longer than the column": ("/home/", 61),
    "longer than two lines": ("/media/", 150),
    "a name of 255 characters": ("", 255),
    "a path of 4000 characters": ("/mnt/x/", 4000),
}


@pytest.mark.parametrize(("start", "length"), LONG_PATHS.values(), ids=LONG_PATHS)
@pytest.mark.parametrize("text", ["{}", "{}: is not a producer", "the folder {} is full, see {}"])
def test_long_paths_are_broken(sgp, monkeypatch, start, length, text):
    path = start.ljust(length, "x")
    monkeypatch.setattr(
        doctor, "_CHECKS", {"gentl": lambda: iter([("warning", text.replace("{}", path))])}
    )
    *lines, _ = sgp("doctor").out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("warning  gentl      ")
    assert all(line.startswith(" " * 20) for line in lines[1:])
    assert path in "".join(line[20:] for line in lines)


def test_a_check_that_fails_itself_does_not_stop_the_others(examine, monkeypatch):
    def broken():
        yield "ok", "half"
        raise ZeroDivisionError("by\nzero")

    monkeypatch.setitem(doctor._CHECKS, "disk", broken)
    code, found = examine("disk", "memory")
    assert code == 0
    assert found[:2] == [("ok", "half"), ("warning", "cannot be checked (by zero)")]
    assert len(found) == 3


def test_packages_that_are_missing_or_old(examine, monkeypatch):
    required = ["numpy>=99.1", "no-such-package>=2; python_version > '3'", "x>=9; extra == 'dev'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda name: required)
    code, found = examine("versions")
    assert code == 3
    errors = [text for state, text in found if state == "error"]
    assert len(errors) == 2
    assert errors[0].endswith("is too old: pip install 'numpy>=99.1'")
    assert errors[1] == (
        "no-such-package is missing: install it (pip install 'no-such-package>=2')"
    )


def test_another_distribution_with_our_names(examine, monkeypatch):
    provided = {"rig": ["surface-geometry-processing", "rigging"], "sgp": ["sgp4"]}
    monkeypatch.setattr("importlib.metadata.packages_distributions", lambda: provided)
    code, found = examine("names")
    assert code == 0
    texts = [text for state, text in found if state == "warning"]
    assert "the package rigging also contains rig: uninstall it" in texts[0]
    assert "the package sgp4 also contains sgp" in texts[1]


def test_another_program_with_our_name(examine, monkeypatch, tmp_path):
    ours, other = tmp_path / "ours", tmp_path / "other"
    for folder in (ours, other):
        folder.mkdir()
        (folder / "capture").write_text("#!/bin/sh\n")
        (folder / "capture").chmod(0o755)
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(ours))
    monkeypatch.setenv("PATH", str(other))
    _, found = examine("names")
    expected = f"capture on the path is {other / 'capture'}: put {ours} first in PATH"
    assert found == [("warning", expected)]
    monkeypatch.setenv("PATH", str(tmp_path))
    _, found = examine("names")
    assert found == [("warning", f"capture is not on the path: add {ours} to PATH")]
    monkeypatch.setenv("PATH", str(ours))
    assert examine("names")[1] == [("ok", "no other package or program has our names")]


def test_without_a_compiler(examine, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    code, ((state, text),) = examine("compiler")
    assert (code, state) == (0, "warning")
    assert "no-such-compiler was not found; install one" in text


def test_producers_are_listed_and_not_loaded(examine, monkeypatch, tmp_path):
    good, bad = tmp_path / "a" / "good.cti", tmp_path / "a" / "bad.cti"
    good.parent.mkdir()
    good.write_bytes(b"\x7fELF GCInitLib\0")
    bad.write_bytes(b"text")
    monkeypatch.setenv("GENICAM_GENTL64_PATH", f"{tmp_path / 'none'}{os.pathsep}{good.parent}")
    _, found = examine("gentl")
    assert [state for state, _ in found] == ["warning", "warning", "ok"]
    assert "none, which is not a folder: install the camera's driver again" in found[0][1]
    assert found[1][1] == f"{bad}: is not a GenTL producer: install the driver again"
    assert found[2][1].startswith(f"{good}: ")
    monkeypatch.delenv("GENICAM_GENTL64_PATH")
    ((state, text),) = examine("gentl")[1]
    assert state == "warning"
    assert "is not set: install the driver of the camera" in text


@pytest.mark.parametrize(("vid", "state"), [(0x2341, "error"), (None, "warning")])
def test_ports_without_the_right_to_open_them(examine, monkeypatch, vid, state):
    port = SimpleNamespace(device="/dev/null", description="Arduino", vid=vid)
    monkeypatch.setattr(list_ports, "comports", lambda: [port])
    assert examine("serial")[1] == [("ok", "/dev/null: Arduino")]
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(doctor, "_how_to_open", lambda device: "join its group")
    code, found = examine("serial")
    assert code == (3 if vid else 0)
    assert found == [(state, "/dev/null: no right to open it: join its group")]


def test_the_group_of_a_port_is_named(tmp_path, monkeypatch):
    port = tmp_path / "ttyUSB0"
    port.touch(mode=0o660)
    group = SimpleNamespace(gr_name="dialout")
    monkeypatch.setattr("grp.getgrgid", lambda number: group)
    port.chmod(0o660)
    assert doctor._how_to_open(str(port)) == (
        "run `sudo usermod -aG dialout $USER`, then log in again"
    )
    port.chmod(0o600)
    assert "udev rule" in doctor._how_to_open(str(port))


def test_the_default_rig(examine, monkeypatch, tmp_path):
    assert examine("rig")[1][0][0] == "ok"
    rig = tmp_path / "rig.toml"
    rig.write_text('name = "x"\ndriver = "bench"\n[options]\ncti = "/none/maker.cti"\n')
    monkeypatch.setenv("SGP_RIG", str(rig))
    code, ((state, text),) = examine("rig")
    assert (code, state) == (3, "error")
    assert "/none/maker.cti: cannot be read" in text
    rig.write_text('name = "x"\ndriver = "bench"\nleds = 24\n')
    assert examine("rig")[1] == [("ok", f"{rig}, from SGP_RIG: driver bench, 24 LEDs")]
    rig.write_text("nonsense")
    assert "rig.toml: is not TOML" in examine("rig")[1][0][1]


@pytest.mark.parametrize(
    ("free", "state"), [(2e8, "error"), (2e9, "warning"), (2e11, "ok")], ids=["full", "low", "ok"]
)
def test_the_disk(examine, monkeypatch, free, state):
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=free))
    code, found = examine("disk")
    assert code == (3 if state == "error" else 0)
    assert {one for one, _ in found} == {state}
    assert all(("record to another disk" in text) == (state != "ok") for _, text in found)


@pytest.mark.parametrize(
    ("memory", "state", "message"),
    [
        pytest.param((2e9, 1.5e9), "warning", "large images need more", id="small"),
        pytest.param((16e9, 5e8), "warning", "close other programs", id="used"),
        pytest.param((16e9, 9e9), "ok", "9.0 GB available", id="enough"),
        pytest.param((16e9, None), "ok", "16.0 GB", id="unknown use"),
        pytest.param((None, None), "ok", "not known", id="unknown"),
    ],
)
def test_the_memory(examine, monkeypatch, memory, state, message):
    monkeypatch.setattr(doctor.rig.processes, "memory_of_computer", lambda: memory)
    ((found, text),) = examine("memory")[1]
    assert (found, message in text) == (state, True)
