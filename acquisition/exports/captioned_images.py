"""Images for other programs: marked as linear, with texts about the recording in their metadata."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from acquisition.pixels.images import write_with_attributes
from acquisition.pixels.png_file import SRGB_CHUNKS, chunk, png_pieces, store_png
from acquisition.session.manifest import Manifest
from acquisition.values.transfer_curve import LINEAR, TransferCurve
from rig.arrays import Float32, UInt16


@dataclass(frozen=True)
class Caption:
    """Texts about an image for human readers, from ``session.toml``.

    Parameters
    ----------
    manifest
        Names of object, operator and place, notes, rights, software, and when the recording began.
        The description says if rig or camera were simulated.
    exposure_us
        Exposure time of this image, microseconds; None if not known.
    """

    manifest: Manifest
    exposure_us: float | None = None

    @property
    def description(self) -> str:
        """The notes, after a mark if the recording is simulated."""
        marks = ("SIMULATED",) if self.manifest.simulated else ()
        return ": ".join(filter(None, (*marks, self.manifest.notes)))

    @property
    def software(self) -> str:
        """Name and version of the program that recorded the session."""
        return f"{self.manifest.software.name} {self.manifest.software.version}"

    def texts(self) -> dict[str, str]:
        """Return the non-empty fields by keyword; the keywords are PNG's where PNG defines one."""
        exposure = "" if self.exposure_us is None else f"{self.exposure_us:.10g} us"
        fields = {
            "Title": self.manifest.object,
            "Author": self.manifest.operator,
            "Description": self.description,
            "Copyright": self.manifest.rights,
            "Creation Time": self.manifest.started_utc.isoformat(),
            "Software": self.software,
            "Location": self.manifest.place,
            "Exposure": exposure,
        }
        return {keyword: text for keyword, text in fields.items() if text}

    def xmp(self) -> str:
        """Return an XMP packet: Dublin Core, plus IPTC Core for the place and Exif for exposure."""
        nanoseconds = None if self.exposure_us is None else round(self.exposure_us * 1000)
        exposure = "" if nanoseconds is None else f"{nanoseconds}/1000000000"
        lines = [
            _listed("dc:title", "Alt", self.manifest.object),
            _listed("dc:creator", "Seq", self.manifest.operator),
            _listed("dc:description", "Alt", self.description),
            _listed("dc:rights", "Alt", self.manifest.rights),
            _plain("Iptc4xmpCore:Location", self.manifest.place),
            _plain("xmp:CreateDate", self.manifest.started_utc.isoformat()),
            _plain("xmp:CreatorTool", self.software),
            _plain("exif:ExposureTime", exposure),
        ]
        return _PACKET.format(fields="".join(lines))


_PACKET = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description rdf:about=""
    xmlns:dc="http://purl.org/dc/elements/1.1/"
    xmlns:xmp="http://ns.adobe.com/xap/1.0/"
    xmlns:exif="http://ns.adobe.com/exif/1.0/"
    xmlns:Iptc4xmpCore="http://iptc.org/std/Iptc4xmpCore/1.0/xmlns/">
{fields}  </rdf:Description>
 </rdf:RDF>
</x:xmpmeta>
<?xpacket end="w"?>"""


def _plain(name: str, text: str) -> str:
    return f"   <{name}>{_xml(text)}</{name}>\n" if text else ""


def _listed(name: str, kind: str, text: str) -> str:
    if not text:
        return ""
    language = ' xml:lang="x-default"' if kind == "Alt" else ""
    item = f"<rdf:li{language}>{_xml(text)}</rdf:li>"
    return f"   <{name}><rdf:{kind}>{item}</rdf:{kind}></{name}>\n"


def _xml(text: str) -> str:
    """Escape a text; characters that XML 1.0 does not allow become spaces."""
    return escape(re.sub("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", " ", text))


def write_captioned_png(
    path: Path, pixels: UInt16, caption: Caption, transfer: TransferCurve = LINEAR
) -> None:
    """Write a 16-bit PNG with its gamma in its header and the caption as iTXt fields and XMP.

    Parameters
    ----------
    path
        File to create or replace; it appears complete or not at all.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` RGB uint16, stored unchanged.
    caption
        Texts to store in the file.
    transfer
        Transfer curve of the samples. The header cannot state a table.

    Raises
    ------
    StorageError
        If the file cannot be written, or does not read back as written.
    """
    chunks = _curve_chunks(transfer)
    fields = {**caption.texts(), "XML:com.adobe.xmp": caption.xmp()}
    chunks += [chunk(b"iTXt", _international(*field)) for field in fields.items()]
    store_png(path, png_pieces(pixels, chunks=chunks))


def write_captioned_exr(
    path: Path,
    pixels: Float32,
    caption: Caption,
    attributes: dict[str, Any],
    transfer: TransferCurve = LINEAR,
) -> None:
    """Write a lossless float EXR with the caption and further attributes in its header.

    Parameters
    ----------
    path
        File to create or replace; it appears complete or not at all.
    pixels
        ``(H, W)`` or ``(H, W, 3)`` float32.
    caption
        Texts to store in the file.
    attributes
        Texts, numbers or tuples of three numbers by attribute name.
    transfer
        Transfer curve of the samples.

    Raises
    ------
    StorageError
        If the file cannot be written, or does not read back as written.
    """
    standard = {
        "compression": "zip",
        "oiio:ColorSpace": "linear" if transfer == LINEAR else "",
        "DocumentName": caption.manifest.object,
        "Artist": caption.manifest.operator,
        "ImageDescription": caption.description,
        "Copyright": caption.manifest.rights,
        "DateTime": f"{caption.manifest.started_utc:%Y:%m:%d %H:%M:%S}",
        "Software": caption.software,
        "Location": caption.manifest.place,
        "XMP": caption.xmp(),
        "ExposureTime": None if caption.exposure_us is None else caption.exposure_us / 1e6,
    }
    write_with_attributes(path, pixels, "openexr", {**standard, **attributes})


def _curve_chunks(transfer: TransferCurve) -> list[bytes]:
    """Return the chunks that state a transfer curve: PNG 3, 11.3.2.2 and 11.3.2.5."""
    match transfer.kind:
        case "table":
            return []
        case "srgb":
            return list(SRGB_CHUNKS)
    gamma = round(100_000 / (transfer.exponent or 1.0))
    return [chunk(b"gAMA", struct.pack(">I", gamma))]


def _international(keyword: str, text: str) -> bytes:
    """Return the data of an uncompressed iTXt chunk without a language tag."""
    clean = text.replace("\0", " ").encode("utf-8", "replace")
    return keyword.encode("latin-1") + b"\0\0\0\0\0" + clean
