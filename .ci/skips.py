"""Print the skipped tests of a junit report; exit with 1 if a skip was not expected."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as ET


def main(report: Path) -> int:
    unexpected = 0
    for case in ET.parse(report).iter("testcase"):
        skipped = case.find("skipped")
        if skipped is None:
            continue
        reason = skipped.get("message", "")
        # The real captures are not part of the repository.
        without_data = "SGP_DATA" in reason and not os.environ.get("SGP_DATA")
        # torch takes 5 GB with its CUDA libraries; only the training of networks needs it.
        without_torch = "the extra [learned]" in reason and find_spec("torch") is None
        expected = without_data or without_torch
        unexpected += not expected
        mark = "expected" if expected else "NOT EXPECTED"
        print(f"skipped ({mark}): {case.get('classname')}::{case.get('name')}: {reason}")
    return 1 if unexpected else 0


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
