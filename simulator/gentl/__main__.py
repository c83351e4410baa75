"""Build the virtual camera's library if needed and print its path."""

import sys

from rig import RigError
from simulator.gentl import build


def main() -> int:
    """Print the path of the ``.cti``; if it cannot be built, print one line and return 3."""
    try:
        path = build()
    except RigError as error:
        sys.stderr.write(f"{error}\n")
        return 3
    sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
