"""Programs whose stderr cannot be written still record, and end with the right exit code."""

import json
import os
import subprocess
import sys

import pytest

from acquisition import Session
from tests.sgp.small_rig import CAPTURE


@pytest.fixture(
    params=[
        "a full disk",
        *(
            pytest.param(kind, marks=pytest.mark.slow)
            for kind in ("a reader that has exited", "none")
        ),
    ]
)
def deaf(request):
    """A stderr that cannot be written, as an argument of `subprocess.run`."""
    if sys.platform == "win32":
        pytest.skip("has neither /dev/full nor descriptors that a child inherits closed")
    if request.param == "none":
        yield {"preexec_fn": lambda: os.close(2)}
        return
    if request.param == "a full disk":
        descriptor = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, descriptor = os.pipe()
        os.close(reader)
    yield {"stderr": descriptor}
    os.close(descriptor)


@pytest.mark.slow
def test_a_recording_does_not_end_because_its_log_cannot_be_written(deaf, real_rig, plan, tmp_path):
    out = tmp_path / "session"
    words = ("run", out, "--rig", real_rig, "--plan", plan(5000.0), "--json")
    ended = subprocess.run([*CAPTURE, *words], stdout=subprocess.PIPE, check=False, **deaf)
    assert ended.returncode == 0
    assert json.loads(ended.stdout)["ok"] is True
    assert Session.open(out).complete


def test_the_exit_code_of_an_error_is_right_even_if_it_cannot_be_printed(deaf, tmp_path):
    words = ("verify", tmp_path / "none", "--json")
    ended = subprocess.run([*CAPTURE, *words], stdout=subprocess.PIPE, check=False, **deaf)
    report = json.loads(ended.stdout)
    assert (report["ok"], report["exit_code"], ended.returncode) == (False, 2, 2)


@pytest.mark.skipif(sys.platform == "win32", reason="has no /dev/full")
@pytest.mark.parametrize("form", [(), ("--json",)], ids=["text", "json"])
def test_a_full_standard_output_is_named(form, tmp_path):
    """Before, text ended with ". : cannot use it", and JSON with a stack trace."""
    (tmp_path / "lights.json").write_text('{"provenance": {"command": "x", "inputs": {}}}')
    words = [sys.executable, "-m", "sgp", "verify", tmp_path, *form]
    with open("/dev/full", "w") as full:
        ended = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, check=False, text=True)
    assert ended.returncode == 3
    assert ended.stderr.startswith("error: standard output: cannot use it: No space left")
    assert "Traceback" not in ended.stderr
