"""A short run of the committed harness that damages files for every reader."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HARNESS = Path(__file__).parents[2] / "benchmarks" / "fuzz_readers.py"

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="forks processes")


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=250,
        env=os.environ | {"SGP_DATA": "", "PYTHONPATH": str(HARNESS.parent)},
    )


@pytest.mark.slow
def test_damaged_files_are_read_or_refused() -> None:
    ended = run(str(HARNESS), "--files", "90", "--seed", "1")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.endswith("90 files, seed 1: 0 read badly\npassed\n")


PLANTED = """
import os, sys, time
import fuzz_readers
from fuzz_readers import READERS, Reader

def undeclared(path): raise KeyError("x")
def several(path): raise fuzz_readers.DataError("two\\nlines")
def crashed(path): os.abort()
def large(path): bytearray(b"x") * (1200 << 20)
def slow(path): time.sleep(90)
def fine(path): raise fuzz_readers.MissingPathError("gone")

fuzz_readers._PATIENCE_S = 15
fuzz_readers._warm = lambda *_: None
READERS.clear()
READERS.update({
    reader.__name__: Reader(reader, "plan")
    for reader in (undeclared, several, crashed, large, slow, fine)
})
sys.exit(fuzz_readers.run(list(READERS), 6, 0))
"""


@pytest.mark.slow
def test_the_harness_detects_bad_readers(tmp_path: Path) -> None:
    """Readers that fail in all ways that the harness detects, and one that does not fail."""
    (tmp_path / "planted.py").write_text(PLANTED)
    ended = run(str(tmp_path / "planted.py"))
    assert ended.returncode == 1, ended.stdout + ended.stderr
    for verdict in ("undeclared", "crashed", "large", "slow"):
        assert f"{verdict}/0: {verdict}, plan.toml" in ended.stdout
    assert "several/0: undeclared" in ended.stdout
    assert "fine/0" not in ended.stdout
    assert ended.stdout.endswith("6 files, seed 0: 5 read badly\nfailed\n")
