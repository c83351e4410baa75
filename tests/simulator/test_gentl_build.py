"""Build the producer with the installed compiler."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from rig import RigError
from simulator.gentl import CompilerError, build

ROOT = Path(__file__).parents[2]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def compiler(folder: Path, script: str) -> str:
    """Write a shell script that stands in for a C compiler."""
    path = folder / "mycc"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


@pytest.mark.slow
def test_the_library_is_built_once_in_the_cache(cache):
    path = build()
    assert path.is_relative_to(cache / "sgp")
    assert path.suffix == ".cti"
    built = path.stat().st_mtime_ns
    assert build() == path
    assert path.stat().st_mtime_ns == built
    assert os.listdir(path.parent) == [path.name]


@pytest.mark.slow
def test_the_sources_compile_without_a_warning(cache, monkeypatch):
    monkeypatch.setenv("CC", f"{os.environ.get('CC', 'cc')} -Werror -Wshadow")
    assert build().exists()


@pytest.mark.slow
def test_another_compiler_builds_another_library(cache, tmp_path, monkeypatch):
    before = build()
    monkeypatch.setenv("CC", compiler(tmp_path, 'exec cc "$@"'))
    assert build() != before


def test_without_a_compiler_the_message_names_what_to_install(cache, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(cache))
    with pytest.raises(CompilerError, match="cc, gcc or clang was not found; install one"):
        build()


def test_a_missing_compiler_is_named(cache, monkeypatch):
    monkeypatch.setenv("CC", "nosuchcc -m32")
    with pytest.raises(CompilerError, match="nosuchcc"):
        build()


@pytest.mark.parametrize(
    ("script", "message"),
    [
        pytest.param(
            'echo "x.c:1: warning: old" >&2; echo "x.c:2: fatal error: dlfcn.h: none" >&2; exit 1',
            r"x\.c:2: fatal error: dlfcn\.h: none",
            id="an error among warnings",
        ),
        pytest.param("exit 1", "no reason given", id="no reason"),
    ],
)
def test_the_error_of_the_compiler_is_quoted_in_one_line(
    cache, tmp_path, monkeypatch, script, message
):
    version = 'test "$1" = --version && exit 0;'
    monkeypatch.setenv("CC", compiler(tmp_path, version + script))
    with pytest.raises(CompilerError, match=message) as caught:
        build()
    assert isinstance(caught.value, RigError)
    assert "\n" not in str(caught.value)
    assert not list(cache.rglob("*.cti"))


def test_a_cache_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(CompilerError, match=r"set XDG_CACHE_HOME"):
        build()


@pytest.mark.slow
def test_processes_that_build_at_the_same_time_get_the_same_complete_file(cache):
    command = [sys.executable, "-m", "simulator.gentl"]
    both = [
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    paths = [process.communicate(timeout=120)[0].strip() for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert paths[0] == paths[1] == str(build())
    assert os.listdir(Path(paths[0]).parent) == [Path(paths[0]).name]


def test_the_command_reports_an_error_in_one_line(cache):
    ran = subprocess.run(
        [sys.executable, "-m", "simulator.gentl"],
        cwd=ROOT,
        env={**os.environ, "CC": "nosuchcc"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert (ran.returncode, ran.stdout) == (3, "")
    assert ran.stderr.count("\n") == 1
    assert "nosuchcc" in ran.stderr
