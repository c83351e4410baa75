"""Export of a session for other programs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from acquisition._errors import DataError
from acquisition.exports.captioned_images import Caption, write_captioned_exr, write_captioned_png
from acquisition.exports.notes import (
    CAMERA_FILE,
    LIGHTS_FILE,
    Layout,
    Pair,
    exr_attributes,
    layout_remarks,
    recording_notes,
)
from acquisition.exports.tables import (
    write_alicevision_lights,
    write_diligent_tables,
    write_lp_table,
)
from acquisition.exports.values import Samples
from acquisition.files.staging import staged
from acquisition.pixels.mask_files import write_mask
from acquisition.session.session import Session
from acquisition.source.reader import read_source
from acquisition.source.recording_json import (
    ExportedFrame,
    RecordingNotes,
    Values,
    write_recording_notes,
)
from acquisition.source.source import Frame, Source
from acquisition.value_files.camera import write_camera
from acquisition.value_files.lights import write_lights
from acquisition.values.lights import Lights
from rig import Notice, Progress, no_progress, pluralize


@dataclass(frozen=True, eq=False)
class Export:
    """A session that is ready to be exported; nothing has been written yet.

    Parameters
    ----------
    session
        Session to export.
    layout, values
        Layout of the files and kind of sample values; see `prepare_export`.
    notes
        Content of ``recording.json``.
    warnings
        One notice for each thing that the layout cannot hold and for each assumption.
    inputs
        Files that are read.
    """

    session: Session
    layout: Layout
    values: Values
    notes: RecordingNotes
    warnings: tuple[Notice, ...]
    inputs: tuple[Path, ...]
    _source: Source
    _frames: tuple[Frame, ...]
    _samples: Samples
    _lights: Lights | None

    def __repr__(self) -> str:
        images = pluralize(len(self._frames), "image")
        return f"Export({self.session.folder}, {self.layout}, {self.values}, {images})"

    def write(
        self,
        out: Path,
        *,
        on_progress: Progress = no_progress,
        replaced: Iterable[Path] = (),
    ) -> tuple[Path, ...]:
        """Write all files into a folder and return their paths.

        The files are written to a hidden folder first and appear together. After an error, or if
        the process is killed, there are no files, or `read_source` refuses the folder.

        Parameters
        ----------
        out
            Output folder, created if it does not exist. Files of the same names are replaced.
        on_progress
            Receives the stage ``exporting``, one step per image.
        replaced
            Files of an earlier export, removed when the new files are complete and before they
            appear.

        Raises
        ------
        DataError
            If a frame is damaged.
        StorageError
            If a file cannot be written.
        """
        with staged(out, replaced) as place:
            files = self.write_into(place, on_progress=on_progress)
        return tuple(out / file.name for file in files)

    def write_into(self, place: Path, *, on_progress: Progress = no_progress) -> tuple[Path, ...]:
        """Write all files one by one into an existing folder that no reader uses yet.

        For folders that the caller has `staged`; parameters and errors are those of `write`.
        """
        files = []
        pairs = list(zip(self._frames, self.notes.frames, strict=True))
        for number, (frame, noted) in enumerate(pairs, 1):
            files.append(place / noted.file)
            self._write_image(files[-1], frame, noted)
            on_progress("exporting", number, len(pairs))
        files += self._write_tables(place)
        files.append(write_recording_notes(place, self.notes))
        return tuple(files)

    def _write_image(self, path: Path, frame: Frame, noted: ExportedFrame) -> None:
        caption = Caption(self.session.manifest, noted.exposure_us)
        if self.layout == "exr":
            attributes = exr_attributes(self.notes, noted, self._lights, frame.light_id)
            write_captioned_exr(
                path, self._samples.floats(frame), caption, attributes, self._samples.transfer
            )
        else:
            pixels = self._samples.whole_numbers(frame)
            write_captioned_png(path, pixels, caption, self._samples.transfer)

    def _write_tables(self, out: Path) -> list[Path]:
        names = [frame.file for frame in self.notes.frames]
        mask, lights = self._source.mask, self._lights
        files = []
        if mask is not None:
            files.append(out / "mask.png")
            write_mask(files[-1], mask)
        if self._source.calibrated_camera is not None:
            files.append(out / CAMERA_FILE)
            write_camera(files[-1], self._source.calibrated_camera)
        if lights is None:
            return files
        full = lights
        if self.layout != "exr":
            full = replace(lights, ids=tuple(Path(name).stem for name in names))
        write_lights(out / LIGHTS_FILE, full, {"source": self.session.manifest.object})
        files.append(out / LIGHTS_FILE)
        as_exposed = _as_exposed(full, self.notes.frames)
        match self.layout:
            case "diligent":
                truth = self._source.normals_truth
                files += write_diligent_tables(out, names, as_exposed, truth)
            case "lp":
                files.append(write_lp_table(out, names, full))
            case "alicevision":
                views = [frame.led or 0 for frame in self.notes.frames]
                files.append(write_alicevision_lights(out, views, as_exposed))
        return files


def prepare_export(
    folder: str | Path,
    layout: Layout,
    *,
    values: Values = "raw",
    bracket: int = 0,
    lights: Lights | None = None,
    mask_path: Path | None = None,
) -> Export:
    """Read a session and prepare its export.

    Parameters
    ----------
    folder
        Session folder, complete or not.
    layout
        ``diligent``: 16-bit PNGs, filenames.txt, light_directions.txt, light_intensities.txt,
        mask.png, and Normal_gt.mat if the true normals are known. ``lp``: 16-bit PNGs and
        lights.lp. ``alicevision``: 16-bit PNGs and alicevision_lights.json, with the LED number as
        view id. These three layouts have one image per light. ``exr``: every frame that counts,
        dark frames included, as float. All layouts have recording.json and, if the lights and the
        camera are known, lights.json and camera.json.
    values
        ``raw``: samples as recorded, black level included; ``recording.json`` and the images state
        their transfer curve. ``linear``: the transfer curve is removed; the mean of the ambient
        frames of the same exposure is subtracted, or that of its dark frames, or the black level,
        in this order of preference; the white level becomes 65535, or 1 in EXR, where values are
        not clipped.
    bracket
        Index of the exposure to export, for layouts with one image per light.
    lights, mask_path
        Lights and mask file to use instead of the session's.

    Returns
    -------
    Export
        Export that is ready to be written.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If the folder is not a session or is damaged, the layout needs lights and none are known,
        no light was recorded with that bracket, or the lights do not match the frames.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition import import_frames, read_source, write_png
    >>> from acquisition.exports import prepare_export
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16))
    >>> session = import_frames(read_source("card.png"), "session")
    >>> export = prepare_export(session.folder, "exr")
    >>> sorted(path.name for path in export.write(Path("exported")))
    ['L00_E0.exr', 'recording.json']
    """
    session = Session.open(folder)
    source = read_source(folder, lights=lights, mask_path=mask_path)
    warnings = list(source.warnings)
    recorded = (frame for frame in session.frames if frame.role != "repeat")
    pairs = list(zip(recorded, source.frames, strict=True))
    if layout != "exr":
        if source.lights is None:
            raise DataError(
                f"{folder}: no lights are known, but layout {layout} needs them: give the lights"
            )
        pairs = _one_of_each_light(session, pairs, bracket, warnings)
    elif values == "linear":
        pairs = [pair for pair in pairs if pair[1].role in ("light", "flat")]
        if not pairs:
            raise DataError(
                f"{folder}: the session has no light or flat frames: export the raw values"
            )
    frames = [frame for _, frame in pairs]
    samples = Samples(source, values)
    notes = recording_notes(session, source, pairs, layout, samples)
    warnings += layout_remarks(session, source, pairs, layout, samples)
    warnings += samples.warnings(frames)
    return Export(
        session=session,
        layout=layout,
        values=values,
        notes=notes.model_copy(update={"remarks": tuple(map(str, warnings))}),
        warnings=tuple(warnings),
        inputs=source.files,
        _source=source,
        _frames=tuple(frames),
        _samples=samples,
        _lights=_lights_of(source, frames),
    )


def _one_of_each_light(
    session: Session, pairs: list[Pair], bracket: int, warnings: list[Notice]
) -> list[Pair]:
    lit = [pair for pair in pairs if pair[0].role == "light"]
    of_bracket = [pair for pair in lit if pair[0].bracket == bracket]
    if not of_bracket:
        available = ", ".join(map(str, sorted({pair[0].bracket for pair in lit}))) or "none"
        raise DataError(
            f"{session.folder}: no light was recorded with bracket {bracket}: "
            f"the brackets are {available}"
        )
    chosen: dict[str, Pair] = {}
    for pair in sorted(of_bracket, key=lambda pair: pair[0].line.repeat):
        chosen.setdefault(pair[1].light_id, pair)
    counts = {
        "of other brackets": len(lit) - len(of_bracket),
        "repeats": len(of_bracket) - len(chosen),
        "dark, ambient or flat": len(pairs) - len(lit),
    }
    left_out = ", ".join(f"{number} {what}" for what, number in counts.items() if number)
    if left_out:
        text = f"frames not exported because the layout has one image per light: {left_out}"
        warnings.append(Notice("export-frames-left-out", text, severity="info"))
    # Keep the order of the session, which is that of its plan.
    return [pair for pair in lit if chosen.get(pair[1].light_id) is pair]


def _lights_of(source: Source, frames: Sequence[Frame]) -> Lights | None:
    """Return the light of each light id among the frames, in the order of the frames."""
    if source.lights is None:
        return None
    ids = dict.fromkeys(frame.light_id for frame in frames if frame.role == "light")
    return source.lights.take([source.lights.ids.index(light) for light in ids]) if ids else None


def _as_exposed(lights: Lights, frames: Sequence[ExportedFrame]) -> Lights:
    """Scale the intensities of lights by the exposure of their images, relative to the longest."""
    exposures = [frame.exposure_us for frame in frames]
    exposures_us = np.array([exposure for exposure in exposures if exposure is not None])
    if len(exposures_us) != len(lights) or not np.ptp(exposures_us):
        return lights
    strengths = np.asarray(lights.intensities) * (exposures_us / exposures_us.max())[:, None]
    # Files with these intensities have no errors of the lights.
    return replace(lights, intensities=strengths, errors=None)
