"""How much memory a computation may use."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.processes import memory as _memory
from rig.processes import memory_budget, memory_of_computer, memory_size


def test_sizes_of_memory() -> None:
    sizes = {
        "3G": 3 << 30,
        "3 GiB": 3 << 30,
        "3GB": 3_000_000_000,
        "1.5m": 3 << 19,
        "500MB": 500_000_000,
        "2T": 2 << 40,
        "64k": 64 << 10,
    }
    assert {text: memory_size(text) for text in sizes} == sizes
    for text in ("3", "G", "-3G", "3X", "3Gi", "", "nan", "1e9G", "9" * 20 + "G", "3G 4G"):
        with pytest.raises(ValueError, match="give a number and a unit"):
            memory_size(text)


def test_the_default_is_half_of_what_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    meminfo = tmp_path / "meminfo"
    monkeypatch.setattr(_memory, "_MEMINFO", meminfo)
    monkeypatch.setattr(_memory, "_GROUP", tmp_path)
    total, available = memory_of_computer()
    assert available is None
    assert memory_budget() == total // 2
    meminfo.write_text("MemTotal: 9 kB\nMemAvailable:   4000000 kB\n")
    assert memory_of_computer() == (total, 4_096_000_000)
    assert memory_budget() == 2_048_000_000
    assert memory_budget(5) == 5


V2 = ("memory.max", "memory.current", "memory.stat", "inactive_file")
V1 = (
    "memory/memory.limit_in_bytes",
    "memory/memory.usage_in_bytes",
    "memory/memory.stat",
    "total_inactive_file",
)
STATISTICS = """anon 100000
inactive_file 1
total_inactive_file 1
active_file 50000
"""
LIMITED = {
    # limit, in use, contents of files, available on the computer: total, available
    "no limit": ("max", 7, 0, None),
    "larger than the computer": (9223372036854771712, 7, 0, None),
    "without files": (1_000_000, 400_000, 0, (1_000_000, 600_000)),
    "after large files": (1_000_000, 999_000, 899_000, (1_000_000, 900_000)),
    "more than the limit in use": (1_000_000, 1_000_100, 0, (1_000_000, 0)),
    "little left outside": (5_000_000_000, 0, 0, (5_000_000_000, 4_096_000)),
    "no number": ("", 400_000, 0, None),
}


@pytest.mark.parametrize("version", [V2, V1], ids=["v2", "v1"])
def test_limits_of_a_container(
    version: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contents of files that are not in use count as free."""
    maximum, current, statistics, files = version
    meminfo = tmp_path / "meminfo"
    monkeypatch.setattr(_memory, "_MEMINFO", meminfo)
    monkeypatch.setattr(_memory, "_GROUP", tmp_path)
    monkeypatch.setattr(_memory.os, "sysconf", lambda name: 80_000)  # 6.4 GB
    meminfo.write_text("MemAvailable:   4000 kB\n")
    (tmp_path / "memory").mkdir()
    found = {}
    for case, (limit, used, cached, _) in LIMITED.items():
        (tmp_path / maximum).write_text(f"{limit}\n")
        (tmp_path / current).write_text(f"{used}\n")
        text = STATISTICS.replace(f"\n{files} 1\n", f"\n{files} {cached}\n")
        (tmp_path / statistics).write_text(text)
        found[case] = memory_of_computer()
    expected = {case: at or (6_400_000_000, 4_096_000) for case, (*_, at) in LIMITED.items()}
    assert found == expected
    (tmp_path / statistics).unlink()
    (tmp_path / maximum).write_text("1000000\n")
    assert memory_of_computer() == (1_000_000, 600_000)
