"""Commands refuse to run without a rig, unless the user configured one."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import rig.board.ports
from acquisition import Session
from rig.config import rig_names
from sgp.app import build
from sgp.rigs import config_path
from tests.cases import cases
from tests.sgp.small_rig import WORLD_RIG

GOLDEN = Path(__file__).parents[1] / "acquisition" / "golden_session_3"


@pytest.fixture
def config(tmp_path, monkeypatch):
    """Write the user's configuration file."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    path = tmp_path / "config" / "sgp" / "config.toml"
    path.parent.mkdir(parents=True)

    def write(text):
        path.write_text(text)
        return path

    return write


def with_rig_option(app, words=()):
    for name in app:
        if name.startswith("-"):
            continue
        one = app[name]
        if one.default_command is None:
            yield from with_rig_option(one, (*words, name))
        else:
            options = {argument.name for argument in one.assemble_argument_collection()}
            if "--rig" in options:
                yield (*words, name)


# What the commands need besides a rig.
NEEDED = {
    ("capture", "run"): ["out"],
    ("capture", "resume"): ["."],
    ("capture", "check"): ["out"],
    ("rig", "light"): ["0"],
    ("rig", "snap"): ["--out", "new/frame.tif"],
}
# These only describe a plan, or compare calibrated lights with the positions in a rig file.
WITHOUT = {
    ("capture", "plan"),
    ("calibrate", "check"),
    ("calibrate", "spheres"),
    ("run",),
    ("normals",),
    ("inspect",),
}
COMMANDS = sorted(set(with_rig_option(build())) - WITHOUT)


def test_all_commands_with_a_rig_are_known():
    bare = {("capture", "preview"), ("rig", "check"), ("rig", "off"), ("rig", "selftest")}
    assert set(NEEDED) | bare == set(COMMANDS)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_without_a_rig_a_command_refuses_and_lists_the_rigs(sgp, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = sgp(*words, *NEEDED.get(words, ())).error_line(2)
    assert line.startswith("error: --rig is missing: give a rig file (.toml) or one of ")
    assert ", ".join(rig_names()) in line
    assert "SGP_RIG" in line
    assert str(config_path()) in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rig", [[], ["--rig", "dome"], ["--rig", "dome.toml"]], ids=str)
def test_the_refusal_imports_no_library(rig):
    code = (
        f"import sys; from sgp.app import build, run; words = {['rig', 'off', *rig]}; "
        "code = run(build(words), words); "
        "found = {'numpy', 'cv2', 'pydantic', 'serial', 'harvesters'} & set(sys.modules); "
        "sys.exit(str(found) if found else code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2, done.stderr


def names(sgp, *words):
    """Return the rig that a command opened."""
    return sgp("rig", "check", "--json", *words).figures()["rig"]


@pytest.mark.usefixtures("simulated_world")
def test_option_then_variable_then_file(sgp, config, tmp_path, monkeypatch):
    for name in ("option", "variable", "configured"):
        place = tmp_path / ("config/sgp" if name == "configured" else ".") / f"{name}.toml"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(WORLD_RIG.replace("small", name))
    config('rig = "configured.toml"\n')
    monkeypatch.chdir(tmp_path)
    assert names(sgp) == "configured"
    monkeypatch.setenv("SGP_RIG", "variable.toml")
    assert names(sgp) == "variable"
    assert names(sgp, "--rig", "option.toml") == "option"


@pytest.mark.usefixtures("simulated_world")
def test_a_path_in_the_file_is_relative_to_it_and_a_name_is_a_name(sgp, config, tmp_path):
    path = config('rig = "../bench.toml"\n')
    bench = path.parent.parent / "bench.toml"
    bench.write_text(WORLD_RIG)
    assert names(sgp) == "small"
    config(f"rig = '{bench}'\n")
    assert names(sgp) == "small"


def listed(sgp, monkeypatch):
    monkeypatch.setattr(rig.host.lines, "ports", dict)
    default = json.loads(sgp("rig", "list", "--json").out)["metrics"]["default_rig"]
    return default, sgp("rig", "list").out


def test_the_list_shows_the_default_and_its_origin(sgp, config, monkeypatch):
    default, text = listed(sgp, monkeypatch)
    assert default is None
    assert "default  none: give --rig; for a default, set SGP_RIG, or write rig" in text
    path = config('rig = "simulated"\n')
    default, text = listed(sgp, monkeypatch)
    assert default == {"name": "simulated", "origin": str(path)}
    assert f"default  simulated, from {path}" in text
    monkeypatch.setenv("SGP_RIG", "bench")
    default, text = listed(sgp, monkeypatch)
    assert default == {"name": "bench", "origin": "SGP_RIG"}
    assert "default  bench, from SGP_RIG" in text


@cases(
    ("text", "message"),
    {
        "not TOML": ("rig = 'a", "is not TOML"),
        "unknown": ("rgi = 'a'", "unknown key 'rgi'; known are operator, rig"),
        "number": ("rig = 3", 'rig is not a text: write rig = "..."'),
        "empty": ("rig = ''", "rig is not a text"),
        "no such": ("rig = 'dome'", "config.toml names the rig dome, which is"),
        "NUL": ("rig = '\\u0000'", "names the rig"),
        "nested": ("x = " + "[" * 999, "nested"),
    },
)
def test_a_faulty_configuration_gets_one_line(sgp, config, text, message):
    path = config(text.replace("'", '"'))
    line = sgp("rig", "off").error_line(2)
    assert message in line
    assert str(path) in line or "NUL" in message


def test_a_faulty_configuration_does_not_hide_damage(sgp, config, tmp_path):
    config("rigg = 3")
    shutil.copytree(GOLDEN, tmp_path / "s")
    frame = next((tmp_path / "s" / "frames").glob("*.tif"))
    frame.write_bytes(frame.read_bytes()[:-1] + b"x")
    answer = sgp("capture", "verify", tmp_path / "s")
    assert answer.code == 4
    assert frame.name in answer.out + answer.err


def test_a_path_with_a_dot_is_not_the_name_of_an_installed_rig(sgp, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = sgp("capture", "plan", "--rig", "./simulated").error_line(2)
    assert str(tmp_path / "simulated") in line
    assert sgp("capture", "plan", "--rig", "simulated").code == 0


def test_a_folder_in_place_of_the_file(sgp, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "sgp" / "config.toml").mkdir(parents=True)
    assert "config.toml: a folder, not a file" in sgp("rig", "off").error_line(2)


def test_a_variable_that_names_no_rig(sgp, monkeypatch):
    monkeypatch.setenv("SGP_RIG", "dome.toml")
    line = sgp("rig", "off").error_line(2)
    assert "SGP_RIG names the rig dome.toml, which is neither a rig file nor one of" in line


def test_an_empty_variable_does_not_count(sgp, monkeypatch):
    monkeypatch.setenv("SGP_RIG", "")
    assert "--rig is missing" in sgp("rig", "off").error_line(2)


@pytest.mark.usefixtures("simulated_world")
def test_with_the_option_the_file_is_not_read(sgp, config, tmp_path):
    config("not TOML")
    (tmp_path / "rig.toml").write_text(WORLD_RIG)
    assert sgp("rig", "off", "--rig", tmp_path / "rig.toml").code == 0


@pytest.mark.usefixtures("simulated_world")
def test_the_operator_is_configured_too(sgp, config, tmp_path, recording):
    (tmp_path / "rig.toml").write_text(WORLD_RIG)
    config(f"operator = 'Ada'\nrig = '{tmp_path / 'rig.toml'}'\n")
    for name, words, operator in (("a", (), "Ada"), ("b", ("--operator", "Eve"), "Eve")):
        sgp("capture", "run", tmp_path / name, "--skip-check", *words).ok()
        assert Session.open(tmp_path / name).manifest.operator == operator
    # Photographs are from an unknown photographer.
    assert sgp("capture", "import", recording, "--out", tmp_path / "c").code == 0
    assert Session.open(tmp_path / "c").manifest.operator == ""


@cases(
    ("platform", "variables", "expected"),
    {
        "Linux": ("linux", {}, "{home}/.config/sgp/config.toml"),
        "relative": ("linux", {"XDG_CONFIG_HOME": "relative"}, "{home}/.config/sgp/config.toml"),
        "XDG": ("linux", {"XDG_CONFIG_HOME": "/x"}, "/x/sgp/config.toml"),
        "macOS": ("darwin", {}, "{home}/Library/Application Support/sgp/config.toml"),
        "Windows": ("win32", {"APPDATA": "/roaming"}, "/roaming/sgp/config.toml"),
    },
)
def test_the_folder_of_the_configuration(tmp_path, monkeypatch, platform, variables, expected):
    for name in ("XDG_CONFIG_HOME", "APPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": str(tmp_path), **variables}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "platform", platform)
    assert config_path() == Path(expected.format(home=tmp_path))


def test_tests_do_not_see_the_users_configuration():
    assert not config_path().exists()
    assert "SGP_RIG" not in os.environ
