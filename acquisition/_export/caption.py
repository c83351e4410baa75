"""What is said of a recording in the images made from it: as plain text fields and as XMP."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime
from xml.sax.saxutils import escape

from acquisition._session.manifest import Manifest


@dataclass(frozen=True)
class Caption:
    """Texts for people, empty where not known.

    Parameters
    ----------
    title
        The object.
    creator
        The operator.
    place, notes, rights
        As in the session.
    taken
        When the recording began.
    software
        Name and version of the program that recorded it.
    exposure_us
        Exposure of this image, microseconds; None where not known.
    """

    title: str
    creator: str
    place: str
    notes: str
    rights: str
    taken: datetime
    software: str
    exposure_us: float | None = None

    @classmethod
    def of(cls, manifest: Manifest, exposure_us: float | None = None) -> Caption:
        """Take the texts of a session."""
        return cls(
            title=manifest.object,
            creator=manifest.operator,
            place=manifest.place,
            notes=manifest.notes,
            rights=manifest.rights,
            taken=manifest.started_utc,
            software=f"{manifest.software.name} {manifest.software.version}",
            exposure_us=exposure_us,
        )

    def texts(self) -> dict[str, str]:
        """Return the fields that are known, under the keywords of PNG where it has one."""
        exposure = "" if self.exposure_us is None else f"{self.exposure_us:.10g} us"
        fields = {
            "Title": self.title,
            "Author": self.creator,
            "Description": self.notes,
            "Copyright": self.rights,
            "Creation Time": self.taken.isoformat(),
            "Software": self.software,
            "Location": self.place,
            "Exposure": exposure,
        }
        return {keyword: text for keyword, text in fields.items() if text}

    def xmp(self) -> str:
        """Return an XMP packet: Dublin Core, IPTC Core for the place, Exif for the exposure."""
        nanoseconds = None if self.exposure_us is None else round(self.exposure_us * 1000)
        exposure = "" if nanoseconds is None else f"{nanoseconds}/1000000000"
        lines = [
            _listed("dc:title", "Alt", self.title),
            _listed("dc:creator", "Seq", self.creator),
            _listed("dc:description", "Alt", self.notes),
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
    """Escape a text; characters that XML 1.0 cannot hold become blanks."""
    return escape(re.sub("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", " ", text))
