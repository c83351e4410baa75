"""``sgp report``: one page that shows results under a light that you turn."""

from __future__ import annotations

from pathlib import Path

import acquisition
import rig
from sgp.cli.options import Input, OptionalInput, Pixels
from sgp.report import make_report
from sgp.results import ReportMetrics, Result, check_file


def report(
    folder: Input,
    *others: Input,
    out: Path = Path("report.html"),
    full: bool = False,
    check: OptionalInput = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Write one HTML page that shows results under a light that you turn by hand.

    The page needs no server and no network: it contains the maps, at most 8 MB by default, reduced
    if necessary, and opens in any browser. It also shows the recording, if it is still there and
    unchanged, and the records of the results: notices, figures, parameters and input hashes. The
    normal maps that a result was computed from are shown next to it. A result of sgp roughness has
    a certificate to print.

    For example:

        sgp report result --out report.html
        sgp report before after --out comparison.html
        sgp report result --full --out large.html
        sgp report measured --check drift --out certificate.html

    Parameters
    ----------
    folder
        Result folder: of sgp run, normals, detail, surface, curvature, roughness, compare or demo;
        or a recording that has no result yet.
    others
        More result folders, to compare them with the first.
    out
        The page, an .html file.
    full
        Embed the maps at full resolution, too, whatever the size of the page.
    check
        Folder of sgp calibrate check --out: the certificate states the drift of the lights. Its
        calibrations must contain the lights of the result.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Replace an existing file.
    """
    check_file(out, ".html", force=force)
    made = make_report([folder, *others], max_pixels=max_pixels, full=full, check=check)
    content = made.html.encode()
    acquisition.write_durably(out, content)
    return Result(
        outputs={"report": out},
        metrics=ReportMetrics(
            results=len(others) + 1, bytes=len(content), reduction=made.reduction
        ),
        warnings=made.notices,
        summary=[
            f"open {out} in a browser ({len(content) / 1e6:.1f} MB)",
            *(f"{text}; --full adds all pixels" for text in made.reduced),
        ],
    )
