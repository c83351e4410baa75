"""Contact sheet of a session: every frame that counts, small, upright and with its name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

import acquisition
from rig.arrays import UInt8

_WIDTH_PX: Final = 200
_LINE_PX: Final = 18
_TEXT_PX: Final = 2 * _LINE_PX + 4  # name and exposure
_LEGEND_PX: Final = 26
_GAP_PX: Final = 4
_COLUMNS: Final = 6
_GAMMA: Final = 1 / 2.2
_CLIPPED_RGB: Final = (255, 60, 60)
_SWATCH_PX: Final = 12
_MARK_PX: Final = 66  # width of the mark of simulated frames
_MARK_RGB: Final = (190, 0, 0)
_UNLIT: Final = ("dark", "ambient")
_ORDER: Final = ("light", "repeat", "flat", "dark", "ambient")


def write_session_sheet(path: Path, session: acquisition.Session) -> None:
    """Draw the frames of a session; pixels at the white level are red, and a legend says so.

    Lights come first, in the order of their LEDs and brackets, then flats and reference frames.
    Each picture has its name, its exposure time, its share of clipped pixels and, if the recording
    is simulated, a mark that says so.

    All lights of one bracket share one brightness scale, so that a weak light looks weak. Frames
    without light use the scale of all lights, so that they look dark.

    Parameters
    ----------
    path
        File to write (.png).
    session
        Session with at least one frame that counts.

    Raises
    ------
    DataError
        If a frame is damaged.
    StorageError
        If the file cannot be written.
    """
    frames = in_order(session.frames)
    unlit = [frame.line for frame in frames if frame.role in _UNLIT]
    black_dn = session.manifest.camera.black_level_dn
    if unlit:
        black_dn = max(black_dn, min(line.percentiles_dn["50"] for line in unlit))
    tiles = [_tile(session, frame, black_dn, _bright_dn(frame, frames)) for frame in frames]
    height, width = tiles[0].shape[:2]
    rows = -(-len(tiles) // _COLUMNS)
    columns = min(len(tiles), _COLUMNS)
    size = rows * (height + _GAP_PX) + _LEGEND_PX, columns * (width + _GAP_PX), 3
    sheet = np.full(size, 255, np.uint8)
    for place, tile in enumerate(tiles):
        row, column = divmod(place, _COLUMNS)
        top, left = row * (height + _GAP_PX), column * (width + _GAP_PX)
        sheet[top : top + height, left : left + width] = tile
    _add_legend(sheet[-_LEGEND_PX:], session)
    acquisition.write_png(path, sheet)


def in_order(
    frames: Sequence[acquisition.session.SessionFrame],
) -> list[acquisition.session.SessionFrame]:
    """Return frames in the order of the sheet: lights by LED and bracket, then the others."""
    return sorted(
        frames,
        key=lambda one: (_ORDER.index(one.role), -1 if one.led is None else one.led, one.bracket),
    )


def _add_legend(strip: UInt8, session: acquisition.Session) -> None:
    """Explain the colour of clipped pixels."""
    top = (_LEGEND_PX - _SWATCH_PX) // 2
    strip[top : top + _SWATCH_PX, 2 : 2 + _SWATCH_PX] = _CLIPPED_RGB
    camera = session.manifest.camera
    # One column is too narrow for the complete sentence.
    narrow = strip.shape[1] < 2 * _WIDTH_PX
    text = "clipped" if narrow else f"clipped: raw value {camera.white_dn:g} or more"
    _write(strip, text, 8 + _SWATCH_PX, top + _SWATCH_PX - 1, 0.42, (0, 0, 0))


def _bright_dn(
    frame: acquisition.session.SessionFrame, frames: Sequence[acquisition.session.SessionFrame]
) -> int:
    """Return the raw value that is drawn white."""
    lit = [other for other in frames if other.role not in _UNLIT]
    if frame in lit:
        lit = [other for other in lit if other.bracket == frame.bracket]
    return max(other.line.percentiles_dn["99.9"] for other in lit or [frame])


def _tile(
    session: acquisition.Session,
    frame: acquisition.session.SessionFrame,
    black_dn: float,
    bright_dn: float,
) -> UInt8:
    camera = session.manifest.camera
    raw = frame.read()
    clipped = np.atleast_3d(raw).max(axis=2) >= camera.white_dn
    upright = session.manifest.mounting.upright(raw)
    size = (_WIDTH_PX, max(1, round(_WIDTH_PX * upright.shape[0] / upright.shape[1])))
    small = cv2.resize(upright, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    shade = np.clip((small - black_dn) / max(bright_dn - black_dn, 1.0), 0, 1) ** _GAMMA
    grey = np.rint(255 * shade).astype(np.uint8)
    picture = grey if grey.ndim == 3 else np.repeat(grey[..., None], 3, axis=2)
    # A single clipped pixel colours its pixel in the small picture.
    share = session.manifest.mounting.upright(clipped.astype(np.float32))
    picture[cv2.resize(share, size, interpolation=cv2.INTER_AREA) > 0] = _CLIPPED_RGB
    label = np.full((_TEXT_PX, _WIDTH_PX, 3), 255, np.uint8)
    _write(label, frame.path.stem, 2, 16, 0.45, (0, 0, 0))
    _write(label, _facts(frame, float(clipped.mean())), 2, 16 + _LINE_PX, 0.38, (90, 90, 90))
    if session.manifest.simulated:
        _write(label, "SIMULATED", _WIDTH_PX - _MARK_PX, 16, 0.35, _MARK_RGB)
    return np.concatenate([picture, label])


def _facts(frame: acquisition.session.SessionFrame, clipped: float) -> str:
    exposure = "exposure unknown" if frame.exposure_us is None else f"{frame.exposure_us:g} us"
    if frame.exposure_us is not None and frame.exposure_us >= 1000:
        exposure = f"{frame.exposure_us / 1000:.4g} ms"
    return f"{exposure}, clipped {100 * clipped:.2g} %" if clipped else exposure


def _write(
    label: UInt8, text: str, left: int, baseline: int, scale: float, rgb: tuple[int, int, int]
) -> None:
    cv2.putText(label, text, (left, baseline), cv2.FONT_HERSHEY_SIMPLEX, scale, rgb, 1, cv2.LINE_AA)
