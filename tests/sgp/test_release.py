"""The version is typed once; what repeats it agrees."""

import re
from pathlib import Path

import sgp

ROOT = Path(__file__).parents[2]


def test_the_changelog_and_the_citation_have_the_version_and_its_date():
    latest = re.search(r"(?m)^## (\S+) \((\S+)\)$", (ROOT / "CHANGELOG.md").read_text())
    citation = dict(
        re.findall(r"(?m)^(version|date-released): (\S+)$", (ROOT / "CITATION.cff").read_text())
    )
    assert latest is not None
    assert sgp.__version__.startswith(latest[1] + ".")
    assert citation == {"version": sgp.__version__, "date-released": latest[2]}
