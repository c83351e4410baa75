"""Feed the virtual board and the firmware the same random items, and count in what they differ.

python benchmarks/board_differential.py [--items 20000] [--seeds 1 2 3] [--board host]

Items are commands in odd orders, several at once, in pieces, damaged, under repeated numbers, and
silence; both boards are programs behind ptys whose clocks stand still between orders. Every reply,
every edge of LEDs and trigger line is compared; tests/rig/differential/difference.py lists what may
differ. An item is not judged where an edge was due as a line arrived: either may come first.

Exit code 1 where an item differs, or a board is not dark at the end.
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
    parser.add_argument("--show", type=int, default=3, help="differing items that are printed")
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
            found = compare([*command, "stepped"], seed=seed, items=options.items, **more)
            print(
                f"seed {seed}: {found.items} items, {found.replies} replies, {found.raced} not "
                f"judged, {len(found.differing)} differ, {'dark' if found.dark else 'NOT DARK'} "
                "at the end",
                flush=True,
            )
            for number, item, differs in found.differing[: options.show]:
                print(f"  {number}: {item}")
                print(*(f"    {line}" for line in differs), sep="\n")
            failed |= bool(found.differing) or not found.dark
    sys.exit(failed)


if __name__ == "__main__":
    main()
