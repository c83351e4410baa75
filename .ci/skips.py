"""Print the skipped tests of a junit report; exit 1 for one that no expected reason covers."""

import os
import sys
from pathlib import Path
from xml.etree import ElementTree as ET


def main(report: Path, expected: Path) -> int:
    lines = (line.strip() for line in expected.read_text(encoding="utf-8").splitlines())
    reasons = [line for line in lines if line and not line.startswith("#")]
    if not os.environ.get("SGP_DATA"):
        reasons.append("SGP_DATA")
    surprises = 0
    for case in ET.parse(report).iter("testcase"):
        skipped = case.find("skipped")
        if skipped is None:
            continue
        reason = skipped.get("message", "")
        known = any(part in reason for part in reasons)
        surprises += not known
        mark = "expected" if known else "NOT EXPECTED"
        print(f"skipped ({mark}): {case.get('classname')}::{case.get('name')}: {reason}")
    return 1 if surprises else 0


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2])))
