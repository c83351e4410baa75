"""Send the same random items to the virtual board and the firmware, and count the differences.

python benchmarks/board_differential.py [--items 20000] [--seeds 1 2 3] [--board host]

Items are commands in unusual orders, several at once, in pieces, damaged, with repeated numbers,
and silence. Both boards are programs behind ptys whose clocks stop between items. Every reply and
every edge of LEDs and trigger line is compared; tests/rig/differential/difference.py lists the
allowed differences. An item is not judged if an edge was due when a line arrived, because either
may be first.

Exit code 1 if an item differs, or a board is not dark at the end.
"""

import sys
import tempfile
from pathlib import Path

from harness import command_line

from tests.rig.differential.compare import compare
from tests.rig.firmware import builds
from tests.rig.test_board_differential import AVR, AVR_LONGEST, AVR_STEPS, HOST


def main():
    parser = command_line(__doc__)
    parser.add_argument("--items", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--board", choices=("host", "atmega328p", "atmega2560"), default="host")
    parser.add_argument("--show", type=int, default=3, help="number of differing items to print")
    options = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory(prefix="sgp-boards-") as name:
        folder = Path(name)
        if options.board == "host":
            command, more = builds.host(folder), {"tolerance": HOST}
        else:
            command = builds.avr(folder, options.board)
            more = {"tolerance": AVR, "longest": AVR_LONGEST, "bursts": False}
            more["steps"] = AVR_STEPS[options.board]
        for seed in options.seeds:
            result = compare([*command, "stepped"], seed=seed, items=options.items, **more)
            print(
                f"seed {seed}: {result.items} items, {result.replies} replies, {result.raced} not "
                f"judged, {len(result.differing)} differ, {'dark' if result.dark else 'NOT DARK'} "
                "at the end",
                flush=True,
            )
            for number, item, differs in result.differing[: options.show]:
                print(f"  {number}: {item}")
                print(*(f"    {line}" for line in differs), sep="\n")
            failed |= bool(result.differing) or not result.dark
    sys.exit(failed)


if __name__ == "__main__":
    main()
