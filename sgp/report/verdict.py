"""The verdict on a result, at the head of the page."""

from __future__ import annotations

from sgp.report.folder import ResultFolder
from sgp.report.html import Html, tag
from sgp.results import LABELS, good_result, unexplained_text


def verdict_box(folder: ResultFolder, heading: str) -> Html | None:
    """Return the verdict with its causes; None if no record of the folder has one.

    ``heading`` names the result if there are several.
    """
    judged = folder.verdict
    if judged is None:
        return None
    answer, verdict = judged
    word = LABELS[answer].capitalize()
    first = tag("strong", word, heading)
    if answer == "good":
        return tag("div", tag("p", first, ": ", good_result(verdict)), class_=f"verdict {answer}")
    causes = [
        tag("li", cause.described, tag("span", cause.remedy, class_="remedy"))
        for cause in verdict.harmful
    ]
    if left := unexplained_text(verdict):
        causes.append(tag("li", left))
    return tag("div", tag("p", first), tag("ul", causes), class_=f"verdict {answer}")
