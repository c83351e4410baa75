"""The tables of a batch: batch.csv, and index.html with thumbnails."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

import rig
from sgp.batch.state import State
from sgp.cli.terminal import printable
from sgp.results import LABELS

_FIGURES = {
    "images": "images",
    "pixels": "pixels",
    "normal_sigma_deg": "sigma (deg)",
    "residual_relative": "residual",
    "mae_deg": "error (deg)",
}
_COLUMNS = (
    "name",
    "source",
    "status",
    "verdict",
    "seconds",
    "cpu_seconds",
    "attempts",
    "errors",
    "warnings",
)
# What begins a formula in a spreadsheet, also in its wide form, where a cell may begin: some also
# separate cells at semicolons and tabs.
_FORMULA = re.compile(r"(^|[;\t\n])(?=[=+\-@\t\n\uff1d\uff0b\uff0d\uff20])")
# Pages that a result may have, the best one first.
_PAGES = ("report.html", "overview.png")

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src 'self' file:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root {{ color-scheme: light dark; font: 15px/1.4 system-ui, sans-serif; }}
body {{ margin: 1.5rem; }}
table {{ border-collapse: collapse; }}
th, td {{ padding: .35rem .7rem; text-align: left; border-bottom: 1px solid #8885;
 vertical-align: middle; }}
td.number {{ text-align: right; font-variant-numeric: tabular-nums; }}
tr.failed td {{ background: #d0302018; }}
td.good {{ background: #2da44e20; }}
td.check {{ background: #e0a00040; }}
td.do-not-use {{ background: #d0302040; font-weight: 600; white-space: nowrap; }}
img {{ width: 96px; height: 72px; object-fit: contain; display: block; }}
img.chart {{ width: auto; max-width: 100%; height: auto; background: #fff; }}
td.text {{ max-width: 36rem; overflow-wrap: anywhere; }}
</style></head><body>
<h1>{title}</h1>
<p>{counts}</p>{roughness}
<table><thead><tr>{head}</tr></thead><tbody>
{rows}
</tbody></table></body></html>
"""

_ROUGHNESS = """
<p>{limits}: <a href="roughness.csv">table</a></p>
<p><img class="chart" src="roughness.png" alt="Control charts"></p>"""


def csv_table(states: Mapping[str, State]) -> str:
    """Return the table as CSV, one line for each source.

    A text that a spreadsheet would run as a formula begins with an apostrophe.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_COLUMNS, *_FIGURES, "error"])
    for name, state in states.items():
        writer.writerow(
            [
                csv_text(name),
                csv_text(state.source),
                "done" if state.error is None else "failed",
                csv_text(state.verdict),
                state.seconds,
                state.cpu_seconds,
                state.attempts,
                state.notices.get("error", 0),
                state.notices.get("warning", 0),
                *[state.figures.get(key, "") for key in _FIGURES],
                csv_text(state.error or ""),
            ]
        )
    return text.getvalue()


def csv_text(text: str) -> str:
    """Return a text that no spreadsheet runs as a formula."""
    text = text.replace("\r", "\\r")  # it would begin a row: the writer does not quote it
    return _FORMULA.sub(r"\1'", text)


def html_table(
    folder: Path, states: Mapping[str, State], others: int = 0, limits: str | None = None
) -> str:
    """Return the table as a page, the worst sources first; it links to the results in ``folder``.

    ``others`` is the number of results in the folder that are not in the table; ``limits`` says
    which parts exceed limits of roughness, None if it was not measured.
    """
    failed = [name for name, state in states.items() if state.error is not None]
    worst = [*LABELS][::-1]

    def rank(name: str) -> tuple[bool, int, str]:
        verdict = states[name].verdict
        return name not in failed, worst.index(verdict) if verdict in worst else len(worst), name

    order = sorted(states, key=rank)
    head = ["", "name", "verdict", *_FIGURES.values(), "seconds", "errors", "warnings"]
    counts = f"{len(states) - len(failed)} of {len(states)} sources done, {len(failed)} failed"
    if others:
        counts += f"; {other_results(others)}"
    return _PAGE.format(
        title=_text(f"Batch {folder.name}"),
        counts=_text(counts),
        roughness="" if limits is None else _ROUGHNESS.format(limits=_text(limits)),
        head="".join(f"<th>{_text(word)}</th>" for word in head),
        rows="\n".join(_row(folder, name, states[name]) for name in order),
    )


def other_results(count: int) -> str:
    """Return the words about results of sources that were not named."""
    noun = rig.pluralize(count, "result of another source is", "results of other sources are")
    return f"{noun} in this folder; the table has only the sources of the last command"


def _row(folder: Path, name: str, state: State) -> str:
    # A name may be too long for a path; `Path.is_file` would raise an error.
    page = next((one for one in _PAGES if os.path.isfile(folder / name / one)), None)
    picture = folder / "thumbnails" / f"{name}.png"
    image = (
        f'<img src="{_link("thumbnails", picture.name)}" alt="">' if os.path.isfile(picture) else ""
    )
    label = _text(name)
    if page is not None:
        link = _link(name, page)
        label, image = f'<a href="{link}">{label}</a>', image and f'<a href="{link}">{image}</a>'
    numbers: Sequence[float | None] = [
        *[state.figures.get(key) for key in _FIGURES],
        state.seconds,
        state.notices.get("error", 0),
        state.notices.get("warning", 0),
    ]
    cells = [f'<td class="number">{_number(value)}</td>' for value in numbers]
    kind = ""
    if state.error is not None:  # in the place of the figures, which it does not have
        kind, wide = ' class="failed"', len(_FIGURES)
        cells[:wide] = [f'<td class="text" colspan="{wide}">{_text(state.error)}</td>']
    word = LABELS.get(state.verdict, "")
    verdict = f'<td class="{state.verdict}">{word}</td>' if word else "<td></td>"
    return f"<tr{kind}><td>{image}</td><td>{label}</td>{verdict}{''.join(cells)}</tr>"


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:,.0f}" if float(value).is_integer() else f"{value:.3g}"


def _text(text: str) -> str:
    return escape(printable(text))


def _link(*parts: str) -> str:
    return escape("/".join(quote(part, safe="", errors="surrogateescape") for part in parts))
