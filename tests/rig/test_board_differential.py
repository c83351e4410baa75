"""The virtual board and the firmware agree on every item of a random series."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.differential.compare import compare
from tests.rig.differential.difference import Tolerance
from tests.rig.differential.items import Items
from tests.rig.firmware import builds

# The core checks its watchdog once per millisecond, and reads a line after it has replied to the
# previous ones.
HOST = Tolerance(late_us=2500, pause_us=600, low_us=100)
# It sends 40 characters in 4 ms, and reads its ring of 128 bytes between two of them.
AVR = Tolerance(late_us=10_000, pause_us=3000, low_us=3000, reply_us=10_000)
AVR_LONGEST = 100
# Steps of a sequence that fit into the memory of each processor.
AVR_STEPS = {"atmega328p": 48, "atmega2560": 64}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return builds.built(tmp_path_factory)


def host(folder: Path) -> list[str]:
    return [*builds.host(folder), "stepped"]


def agree(command: list[str], tolerance: Tolerance, *, items: int, **options: int) -> None:
    found = compare(command, items=items, tolerance=tolerance, **options)
    number, item, differs = (found.differing or [(0, None, [])])[0]
    assert not found.differing, f"{len(found.differing)} differ; {number}: {item}: {differs}"
    assert found.items == items
    # Enough items were answered, and only few could not be judged.
    assert found.replies > items
    assert found.raced < 0.03 * items
    assert found.dark


@pytest.mark.slow
def test_virtual_board_and_firmware_agree(folder: Path) -> None:
    agree(host(folder), HOST, items=1000, seed=20)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [1, 2])
def test_virtual_board_and_firmware_agree_on_many_items(folder: Path, seed: int) -> None:
    agree(host(folder), HOST, items=10_000, seed=seed)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("mcu", AVR_STEPS)
def test_virtual_board_and_avr_image_agree(folder: Path, mcu: str) -> None:
    command = [*builds.avr(folder, mcu), "stepped"]
    options = {"longest": AVR_LONGEST, "bursts": False, "steps": AVR_STEPS[mcu]}
    agree(command, AVR, items=500, seed=4, **options)


FAULTS: dict[str, tuple[str, str, str]] = {
    "a second carriage return is ignored": (
        "core/line.cpp",
        "text[length - 1] == '\\r')\n        length--;",
        "text[length - 1] == '\\r')\n        length--;\n"
        "    if (length > 0 && text[length - 1] == '\\r')\n        length--;",
    ),
    "nine digits are refused": ("core/commands.cpp", "word.length <= 9", "word.length <= 8"),
    "the watchdog is slow": (
        "core/light.cpp",
        "heard_at < WATCHDOG_MS * 1000 ||",
        "heard_at < WATCHDOG_MS * 1010 ||",
    ),
    "OFF clears the records of a sequence": (
        "core/light.cpp",
        "    put_out();\n    now_in = IDLE;\n    flash_over = false;",
        "    put_out();\n    now_in = IDLE;\n    flash_over = false;\n    ended = 0;",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_a_fault_in_the_firmware_is_a_difference(
    tmp_path: Path, fault: tuple[str, str, str]
) -> None:
    firmware = builds.changed(tmp_path / "firmware", *fault)
    command = [*builds.host(tmp_path, firmware), "stepped"]
    assert compare(command, items=1000, seed=20, tolerance=HOST).differing


@pytest.mark.slow
def test_items_cover_every_kind() -> None:
    """The random items must include every kind that the comparison should cover."""
    items = [item for item, _ in zip(Items(1, longest=600, bursts=True), range(5000), strict=False)]
    stream = b"".join(item.data for item in items)
    kinds: dict[str, Callable[[], bool]] = {
        "several commands in a write": lambda: any(item.data.count(b"\n") > 3 for item in items),
        "a line in pieces": lambda: any(item.data[-1:] not in (b"", b"\n") for item in items),
        "odd line ends": lambda: b"\r\r\n>" in stream and b"\n\r>" in stream,
        "NUL and 8 bits": lambda: b"\0" in stream and b"\xff" in stream,
        "overlong lines": lambda: any(len(line) > 250 for line in stream.split(b"\n")),
        "lower case": lambda: b" on " in stream and b" flash " in stream,
        "wrap-around": lambda: b">FFFF " in stream and b">0000 " in stream,
        "silence": lambda: any(item.pass_us > 900_000 for item in items),
        "orders": lambda: {"active 0", "active 1", "reset"} <= {item.order for item in items},
        "every verb": lambda: all(
            b" %s" % verb in stream
            for verb in (
                b"ID",
                b"STATUS",
                b"DID",
                b"OFF",
                b"ON",
                b"LEVEL",
                b"FLASH",
                b"STEP",
                b"RUN",
            )
        ),
    }
    assert [kind for kind, has in kinds.items() if not has()] == []
