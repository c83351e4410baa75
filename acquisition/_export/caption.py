"""Texts about a recording in its exported images: plain text fields and XMP."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime
from xml.sax.saxutils import escape

from acquisition._session.manifest import Manifest


@dataclass(frozen=True)
class Caption:
    """Texts for human readers; empty if not known.

    Parameters
    ----------
    title
        Name of the object.
    creator
        Name of the operator.
    place, notes, rights
        The session's entries of the same names.
    taken
        Time at which the recording began.
    simulated
        Whether rig or camera were simulated, which the description then says.
    software
        Name and version of the program that recorded the session.
    exposure_us
        Exposure time of this image, microseconds; None if not known.
    """

    title: str
    creator: str
    place: str
    notes: str
    rights: str
    taken: datetime
    software: str
    exposure_us: float | None = None
    simulated: bool = False

    @classmethod
    def of(cls, manifest: Manifest, exposure_us: float | None = None) -> Caption:
        """Build a caption from the texts of a session."""
        return cls(
            title=manifest.object,
            creator=manifest.operator,
            place=manifest.place,
            notes=manifest.notes,
            rights=manifest.rights,
            taken=manifest.started_utc,
            software=f"{manifest.software.name} {manifest.software.version}",
            exposure_us=exposure_us,
            simulated=manifest.simulated,
        )

    @property
    def description(self) -> str:
        """The notes, after a mark if the recording is simulated."""
        marks = ("SIMULATED",) if self.simulated else ()
        return ": ".join(filter(None, (*marks, self.notes)))

    def texts(self) -> dict[str, str]:
        """Return the non-empty fields by keyword; the keywords are PNG's where PNG defines one."""
        exposure = "" if self.exposure_us is None else f"{self.exposure_us:.10g} us"
        fields = {
            "Title": self.title,
            "Author": self.creator,
            "Description": self.description,
            "Copyright": self.rights,
            "Creation Time": self.taken.isoformat(),
            "Software": self.software,
            "Location": self.place,
            "Exposure": exposure,
        }
        return {keyword: text for keyword, text in fields.items() if text}

    def xmp(self) -> str:
        """Return an XMP packet: Dublin Core, plus IPTC Core for the place and Exif for exposure."""
        nanoseconds = None if self.exposure_us is None else round(self.exposure_us * 1000)
        exposure = "" if nanoseconds is None else f"{nanoseconds}/1000000000"
        lines = [
            _listed("dc:title", "Alt", self.title),
            _listed("dc:creator", "Seq", self.creator),
            _listed("dc:description", "Alt", self.description),
            _listed("dc:rights", "Alt", self.rights),
            _plain("Iptc4xmpCore:Location", self.place),
            _plain("xmp:CreateDate", self.taken.isoformat()),
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
