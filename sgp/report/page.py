"""Assemble the page: style, scripts, data, and the policy that allows nothing else."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Sequence
from functools import cache
from string import Template
from typing import Any

from sgp.report.html import Html, joined, script_json, tag, text
from sgp.report.scripts import asset, libraries, linked


def page(
    title: str,
    body: Iterable[Html],
    report: dict[str, Any],
    planes: Sequence[tuple[str, str]],
    views: tuple[str, ...],
) -> str:
    """Return the page.

    ``report`` is the data for the scripts; ``planes`` are ids of elements and encoded maps;
    ``views`` are the tabs after the one with the light.
    """
    scripts, style = [*libraries(views), linked(views)], asset("style.css")
    policy = "; ".join(
        [
            "default-src 'none'",
            f"script-src {' '.join(map(_hash, scripts))}",
            f"style-src {_hash(style)}",
            "img-src data: blob:",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    return Template(asset("page.html")).substitute(
        policy=text(policy),
        title=text(title),
        style=style,
        body=joined(*body),
        report=script_json(report),
        planes="\n".join(
            tag("script", Html(encoded), type="text/plain", id=name) for name, encoded in planes
        ),
        scripts="\n".join(f"<script>{script}</script>" for script in scripts),
    )


@cache
def colour_maps() -> dict[str, str]:
    """Return the 256 colours of each colour map as base64; all are perceptually uniform."""
    # matplotlib is slow to import.
    from matplotlib import colormaps

    names = {"height": "viridis", "doubt": "magma", "signed": "coolwarm", "plain": "gray"}
    return {
        name: base64.b64encode(
            (colormaps[found].resampled(256)(range(256))[:, :3] * 255 + 0.5).astype("u1").tobytes()
        ).decode()
        for name, found in names.items()
    }


def _hash(content: str) -> str:
    digest = hashlib.sha256(content.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
