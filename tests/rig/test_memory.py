"""How much memory a computation may use."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig import _memory, memory_budget, memory_of_computer, memory_size


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
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("7\n")
    assert memory_budget() == 2_048_000_000
    (tmp_path / "memory.max").write_text("1000000\n")
    (tmp_path / "memory.current").write_text("400000\n")
    assert memory_of_computer() == (1_000_000, 600_000)
    assert memory_budget() == 300_000
    assert memory_budget(5) == 5
