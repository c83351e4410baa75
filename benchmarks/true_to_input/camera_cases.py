"""Settings that a camera keeps from an earlier program, frame numbers that wrap, and metering."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from true_to_input.case import Case, Outcome, sgp

_HEAD = (
    '<?xml version="1.0" encoding="utf-8"?><RegisterDescription ModelName="M" VendorName="V" '
    'StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1" '
    'SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ToolTip="" '
    'ProductGuid="1F3C6A72-7842-4edd-9130-E2E90A2058BA" '
    'VersionGuid="1F3C6A72-7842-4edd-9130-E2E90A2058BB" '
    'xmlns="http://www.genicam.org/GenApi/Version_1_1">'
)
_LOCKED = "<ImposedAccessMode>RO</ImposedAccessMode>"

# XML of a node, its name, its neutral value if it alters samples, and whether it selects others.
Node = tuple[str, str, Any]


def _number(name: str, value: float, low: float, high: float, off: float | None = None) -> Node:
    xml = f"<Value>{value}</Value><Min>{low}</Min><Max>{high}</Max>"
    return f'<Float Name="{name}">{xml}</Float>', name, off


def _integer(name: str, value: int, low: int, high: int, off: int | None = None) -> Node:
    xml = f"<Value>{value}</Value><Min>{low}</Min><Max>{high}</Max>"
    return f'<Integer Name="{name}">{xml}</Integer>', name, off


def _flag(name: str, value: int, off: bool | None = None, lock: str = "") -> Node:
    xml = f"{lock}<Value>{value}</Value><OnValue>1</OnValue><OffValue>0</OffValue>"
    return f'<Boolean Name="{name}">{xml}</Boolean>', name, off


def _choice(name: str, options: str, current: str, off: str | None = None) -> Node:
    symbols = options.split()
    entries = "".join(
        f'<EnumEntry Name="{one}"><Value>{i}</Value></EnumEntry>' for i, one in enumerate(symbols)
    )
    xml = f"{entries}<Value>{symbols.index(current)}</Value>"
    return f'<Enumeration Name="{name}">{xml}</Enumeration>', name, off


def _switch(name: str) -> Node:
    return _choice(name, "Off On", "On", "Off")


def _per_entry(name: str, selector: str, entries: str) -> Node:
    """Return a switch that is on for every entry of its selector."""
    symbols = entries.split()
    chosen = "".join(
        f'<EnumEntry Name="{one}"><Value>{i}</Value></EnumEntry>' for i, one in enumerate(symbols)
    )
    values = "".join(
        f'<pValueIndexed Index="{i}">{name}{i}</pValueIndexed>' for i in range(len(symbols))
    )
    stored = "".join(
        f'<Integer Name="{name}{i}"><Value>1</Value></Integer>' for i in range(len(symbols))
    )
    xml = (
        f'<Enumeration Name="{selector}">{chosen}<Value>0</Value><pSelected>{name}</pSelected>'
        f'</Enumeration><Boolean Name="{name}"><pValue>{name}All</pValue></Boolean>'
        f'<Integer Name="{name}All"><pIndex>{selector}</pIndex>{values}'
        f"<pValueDefault>{name}0</pValueDefault></Integer>{stored}"
    )
    return xml, name, None


def _map(nodes: list[Node]) -> Any:
    from genicam import genapi

    names = [name for xml, _, _ in nodes for name in re.findall(r'Name="(\w+)"', xml)]
    entries = {name for xml, _, _ in nodes for name in re.findall(r'EnumEntry Name="(\w+)"', xml)}
    features = "".join(f"<pFeature>{n}</pFeature>" for n in names if n not in entries)
    node_map = genapi.NodeMap()
    node_map.load_xml_from_string(
        f'{_HEAD}<Category Name="Root">{features}</Category>'
        f"{''.join(xml for xml, _, _ in nodes)}</RegisterDescription>"
    )
    return node_map


def _turned_off(nodes: list[Node]) -> Outcome:
    """Judge: what alters samples has its neutral value, and every other setting is recorded."""
    from rig import CameraError
    from rig.genicam import automatics
    from rig.genicam.nodes import Nodes

    node_map = _map(nodes)
    camera = Nodes(node_map, "test")
    try:
        automatics.turn_off_automatics(camera)
    except CameraError as error:
        return Outcome("refused by name", str(error))
    left = [
        f"{name}={node_map.get_node(name).value}"
        for _, name, off in nodes
        if off is not None and node_map.get_node(name).value != off
    ]
    recorder = getattr(automatics, "camera_settings", lambda _: {})
    recorded = recorder(camera)
    forgotten = [
        name
        for _, name, off in nodes
        if off is None and not name.endswith("Selector") and name not in recorded
    ]
    if left or forgotten:
        text = f"{len(left)} left on: {', '.join(left)}; not recorded: {', '.join(forgotten)}"
        return Outcome("wrong", text)
    altering = sum(off is not None for _, _, off in nodes)
    return Outcome("right", f"{altering} off, {len(nodes) - altering} others recorded")


_PRESETS = "Off Daylight5000K Tungsten2800K"
LEFT_ON: list[Node] = [
    _choice("LightSourcePreset", _PRESETS, "Daylight5000K", "Off"),
    _flag("ProcessedRawEnable", 1, off=False),
    _choice("LightSourceSelector", "Off Daylight", "Daylight", "Off"),
    _flag("ColorAdjustmentEnable", 1, off=False),
    _choice("ReadoutMode", "Normal Fast", "Fast"),
    _choice("BalanceWhiteAuto", "Off Once Continuous", "Once", "Off"),
    _choice("BalanceRatioSelector", "Red Green Blue", "Red"),
    _number("BalanceRatio", 1.93, 0, 8, 1),
    _flag("ReverseX", 1, off=False),
    _flag("ReverseY", 0, off=False),
    _integer("BinningHorizontal", 2, 1, 4, 1),
    _integer("BinningVertical", 1, 1, 4, 1),
    _choice("BinningHorizontalMode", "Sum Average", "Sum"),
    _integer("DecimationHorizontal", 1, 1, 4, 1),
    _integer("DigitalShift", 2, 0, 4, 0),
    _choice("BslColorSpace", "Off sRgb", "sRgb", "Off"),
    _number("BslContrast", 0.4, -1, 1, 0),
    _number("BslBrightness", 0.2, -1, 1, 0),
    _number("BslSharpnessEnhancement", 0.5, 0, 1, 0),
    _number("BslNoiseReduction", 0.5, 0, 2, 0),
    _choice("BslContrastMode", "Linear SCurve", "SCurve", "Linear"),
    _choice("BslLightSourcePreset", "Off Daylight5000K", "Daylight5000K", "Off"),
    _flag("ColorTransformationEnable", 1, off=False),
    _flag("SaturationEnable", 1, off=False),
    _number("BslSaturation", 1.5, 0, 2, 1),
    _switch("SequencerMode"),
    _switch("FlatFieldCorrectionMode"),
    _flag("FfcEnable", 1, off=False),
    _switch("mvFlatFieldCorrectionEnable"),
    _flag("ShadingCorrectionEnable", 1, off=False),
    _flag("mvHDREnable", 1, off=False),
    _choice("GainSelector", "AnalogAll DigitalAll", "DigitalAll"),
    _choice("ADCBitDepth", "Bit8 Bit12", "Bit8"),
    _flag("BslVignettingCorrection", 1, off=False),
    _switch("VignettingCorrectionMode"),
    _switch("MultipleExposure"),
    _number("Gamma", 1.0, 0, 4, 1),
    _choice("GammaSelector", "User sRGB", "sRGB", "User"),
    _switch("ISPEnable"),
    _flag("IspEnable", 1, off=False),
    _switch("ToneMapping"),
    _flag("AutoToneEnable", 1, off=False),
    _switch("BslLowLightImaging"),
    _choice("ImageCompressionMode", "Off Lossless Lossy", "Lossy", "Off"),
    _switch("LossyCompression"),
]
# Names of the same kinds in manuals of other makers.
OTHER_MAKERS: list[Node] = [
    _flag("SharpeningEnable", 1, off=False),
    _switch("mvSharpeningMode"),
    _choice("NoiseReductionMode", "Off Median Gaussian", "Median", "Off"),
    _choice("DenoiseMode", "Off Spatial", "Spatial", "Off"),
    _switch("EdgeEnhancementMode"),
    _flag("HDRModeEnable", 1, off=False),
    _switch("WDRMode"),
    _switch("pgrExposureCompensationAuto"),
    _flag("RgbTransformEnable", 1, off=False),
    _flag("HueEnable", 1, off=False),
    _flag("ShadingEnable", 1, off=False),
    _flag("ImageMirrorEnable", 1, off=False),
    _choice("ImageRotation", "Off Rotate90 Rotate180", "Rotate180", "Off"),
    _integer("BinningX", 2, 1, 4, 1),
    _integer("SubSamplingHorizontal", 2, 1, 4, 1),
    _number("DigitalGain", 6, 0, 24, 0),
    _flag("FrameAveragingEnable", 1, off=False),
    _switch("CompandingMode"),
    _choice("DeviceScanType", "Areascan Linescan", "Areascan"),
    _integer("TimerDuration", 40, 0, 1000),
]

# Names in the manuals and programs of users of further makers: Allied Vision, Baumer, Daheng,
# Hikrobot, IDS, JAI, Lucid, Sony, Teledyne (in lower case), The Imaging Source.
FURTHER_MAKERS: list[Node] = [
    _choice("ConvolutionMode", "Off Sharpening Custom", "Sharpening", "Off"),
    _flag("DefectMaskColumnEnable", 1, off=False),
    _choice("EdgeFilter", "Off Smooth2 Sharpen1", "Sharpen1", "Off"),
    _switch("FixedPatternNoiseCorrection"),
    _flag("SensorEffectCorrection", 1, off=False),
    _flag("BrightnessCorrection", 1, off=False),
    _flag("OnBoardColorProcessEnabled", 1, off=False),
    _switch("StaticDefectCorrection"),
    _number("GammaParam", 2.2, 0.1, 10, 1),
    _integer("ContrastParam", 10, -50, 100, 0),
    _flag("DigitalShiftEnable", 1, off=False),
    _flag("CCMEnable", 1, off=False),
    _flag("NUCEnable", 1, off=False),
    _flag("PRNUCEnable", 1, off=False),
    _flag("LSCEnable", 1, off=False),
    _flag("SuperBayerEnable", 1, off=False),
    _choice("HotpixelCorrectionMode", "Off Static Dynamic", "Static", "Off"),
    _flag("ColorCorrectionMatrixEnable", 1, off=False),
    _switch("PixelCorrection"),
    _flag("BlemishCompensationEnable", 1, off=False),
    _switch("EdgeEnhancerEnable"),
    _switch("ALCEnable"),
    _choice("HDROutput", "Off HDR", "HDR", "Off"),
    _choice("ImageFilter", "Off Median", "Median", "Off"),
    _flag("AreaGainEnable", 1, off=False),
    _choice("flatfieldCorrectionMode", "Off Active", "Active", "Off"),
    _choice("lutMode", "Off Active", "Active", "Off"),
    _choice("imageFilterMode", "Off Active", "Active", "Off"),
    _choice("autoBrightnessMode", "Off Active", "Active", "Off"),
    _number("gammaCorrection", 2, 0.1, 4, 1),
    _switch("HighlightReduction"),
    _choice("PixelColorFilter", "None BayerRG", "BayerRG"),
    _choice("ColorCorrectionMatrix", "Custom0 HQ", "HQ"),
    _flag("BlackLevelClampingEnable", 1),
]


def _rounded_gamma() -> Outcome:
    """The register of the gamma has steps, of which none is exactly 1."""
    from rig import CameraError
    from rig.genicam.automatics import turn_off_automatics
    from rig.genicam.nodes import Nodes

    xml, name, _ = _number("Gamma", 0.45, 0.25, 3.99902)
    node_map = _map([(xml.replace("</Max>", "</Max><Inc>0.007</Inc>"), name, 1)])
    try:
        turn_off_automatics(Nodes(node_map, "test"))
    except CameraError as error:
        return Outcome("wrong", str(error))
    value = node_map.get_node("Gamma").value
    return Outcome("right" if abs(value - 1) < 0.0035 else "wrong", f"Gamma={value:g}")


def _neutral(node: Node) -> Node:
    """Return a node that alters samples, off and locked; others as they are."""
    xml, name, off = node
    if off is None:
        return node
    if "<Enumeration" not in xml:
        value = f"<Value>{float(off):g}</Value>"
        xml = re.sub(r"<Value>[^<]*</Value>(?=<OnValue>|<Min>)", value, xml)
    if "<Enumeration" in xml:
        symbols = re.findall(r'EnumEntry Name="(\w+)"', xml)
        place = symbols.index(off) if off in symbols else 0
        xml = re.sub(
            r"<Value>\d+</Value></Enumeration>", f"<Value>{place}</Value></Enumeration>", xml
        )
    return re.sub(r'(Name="\w+">)', rf"\1{_LOCKED}", xml, count=1), name, off


def _per_channel() -> Outcome:
    from rig.genicam.automatics import turn_off_automatics
    from rig.genicam.nodes import Nodes

    node_map = _map([_per_entry("LUTEnable", "LUTSelector", "Luminance Red Green Blue")])
    turn_off_automatics(Nodes(node_map, "test"))
    on = [i for i in range(4) if node_map.get_node(f"LUTEnable{i}").value]
    kept = node_map.get_node("LUTSelector").value
    if on or kept != "Luminance":
        return Outcome("wrong", f"tables {on} are still on; selected: {kept}")
    return Outcome("right", "the table of each channel is off")


def _locked(node: Node, *, refused: bool) -> Outcome:
    """Judge a node that is on and cannot be written."""
    from rig import CameraError
    from rig.genicam import automatics
    from rig.genicam.nodes import Nodes

    camera = Nodes(_map([node]), "test")
    try:
        automatics.turn_off_automatics(camera)
    except CameraError as error:
        named = node[1] in str(error)
        return Outcome("refused by name" if named else "vague", str(error))
    recorded = getattr(automatics, "camera_settings", lambda _: {})(camera)
    if refused or node[1] not in recorded:
        return Outcome("wrong", f"{node[1]} stays on without a word")
    return Outcome("applied and stated", f"{node[1]} = {recorded[node[1]]} recorded")


def _commands() -> Outcome:
    """Judge that nothing permanent is written: commands and user sets stay untouched."""
    from rig.genicam.automatics import turn_off_automatics
    from rig.genicam.nodes import Nodes

    names = ("UserSetSave", "UserSetLoad", "DeviceReset", "TimestampReset", "FlatFieldSave")
    commands = "".join(
        f'<Command Name="{n}"><pValue>{n}Value</pValue><CommandValue>7</CommandValue></Command>'
        f'<Integer Name="{n}Value"><Value>0</Value></Integer>'
        for n in names
    )
    default = _choice("UserSetDefault", "Default UserSet1", "UserSet1")
    selector = _choice("UserSetSelector", "Default UserSet1", "UserSet1")
    node_map = _map([(commands, "commands", None), default, selector, *LEFT_ON])
    turn_off_automatics(Nodes(node_map, "test"))
    run = [n for n in names if node_map.get_node(f"{n}Value").value]
    run += [n for _, n, _ in (default, selector) if node_map.get_node(n).value != "UserSet1"]
    return Outcome("wrong" if run else "right", f"changed: {', '.join(run) or 'nothing'}")


def _following(block: int, largest: int, after: int) -> int:
    return after if block == largest else block + 1


def _singles(first: int, largest: int, after: int, *, lost: int = 0) -> Outcome:
    """One trigger per acquisition; the device continues its count, ``lost`` ids are not seen."""
    from rig.genicam.frame_count import BlockCount

    count, block = BlockCount(), first
    wrong = []
    for i in range(1000):
        count.started()
        block = _following(block, largest, after)
        for _ in range(lost if block > largest - 20 and i % 3 == 0 else 0):
            block = _following(block, largest, after)
        if (place := count.place(block, 1)) != 0:
            wrong.append((i, block, place))
    return _blocks(wrong, 1000)


def _long(largest: int, after: int, *, first: int, total: int, lost: frozenset[int]) -> Outcome:
    """One acquisition; the frames of the triggers ``lost`` do not arrive."""
    from rig.genicam.frame_count import BlockCount

    count, block = BlockCount(), first
    wrong = []
    count.started()
    for i in range(total):
        block = _following(block, largest, after) if i else block
        if i in lost:
            continue
        if (place := count.place(block, i + 1)) != i:
            wrong.append((i, block, place))
    return _blocks(wrong, total)


def _repeated() -> Outcome:
    """A frame that arrives twice, and one that arrives late, around the wrap of 16 bits."""
    from rig.genicam.frame_count import BlockCount

    wrong = []
    for blocks in ([65534, 65535, 65535], [65534, 65535, 1, 65535], [65535, 1, 2, 1]):
        count = BlockCount()
        count.started()
        count.place(blocks[0], 1)
        places = [count.place(block, i + 2) for i, block in enumerate(blocks[1:])]
        if places[-1] is not None or None in places[:-1]:
            wrong.append((blocks, places))
    return _blocks(wrong, 3)


def _restarting() -> Outcome:
    """Acquisitions of many triggers each, and a count that restarts at 1 with each of them."""
    from rig.genicam.frame_count import BlockCount

    count, wrong = BlockCount(), []
    for run in range(4):
        count.started()
        for i in range(65_600 if run == 1 else 3):
            block = i % 65535 + 1
            if (place := count.place(block, i + 1)) != i:
                wrong.append((run, i, block, place))
    return _blocks(wrong, 65_609)


def _blocks(wrong: list[Any], total: int) -> Outcome:
    text = f"{len(wrong)} of {total} frames refused or misplaced"
    return Outcome("wrong" if wrong else "right", f"{text}; first {wrong[0]}" if wrong else text)


_PLAN = 'leds = "0-5"\nexposures_us = [8000.0, 2000.0]\ndark = true\nambient = true\n'


def _plan(folder: Path, each: str) -> Outcome:
    """Compare the plan's shots with what ``capture run --meter`` records."""
    path = folder / "plan.toml"
    path.write_text(_PLAN, encoding="utf-8")
    planned = sgp("capture", "plan", path, "--led-count", "36")
    options = ("--rig", "simulated", "--plan", path, "--meter", each, "--skip-check")
    recorded = sgp("capture", "run", folder / "session", *options)
    if planned.code or recorded.code:
        return Outcome("vague", planned.message or recorded.message)
    taken = len(list((folder / "session" / "frames").iterdir()))
    plain = len(planned.values["metrics"]["shots"])
    bounds = planned.values["metrics"].get("metering", {}).get(each, {})
    most = bounds.get("most_shots", plain)
    text = f"planned {plain}, metered at most {most}, recorded {taken}"
    return Outcome("right" if plain <= taken <= most else "wrong", text)


def _cases() -> Iterator[Case]:
    def case(
        name: str, right: str, run: Callable[[Path], Outcome], *, listed: bool = False
    ) -> Case:
        return Case(name, 4, right, run, listed)

    off = "off, the others recorded"
    yield case("processing_left_on", off, lambda _: _turned_off(LEFT_ON), listed=True)
    yield case("other_makers_names", off, lambda _: _turned_off(OTHER_MAKERS))
    yield case("further_makers_names", off, lambda _: _turned_off(FURTHER_MAKERS))
    yield case(
        "further_makers_locked",
        "nothing refused",
        lambda _: _turned_off([*map(_neutral, FURTHER_MAKERS)]),
    )
    yield case("gamma_in_steps", "nothing refused", lambda _: _rounded_gamma())
    yield case(
        "neutral_and_locked", "nothing refused", lambda _: _turned_off([*map(_neutral, LEFT_ON)])
    )
    yield case("table_per_channel", "off in each channel", lambda _: _per_channel())
    locked = (
        ("mirrored_for_good", _flag("ReverseX", 1, lock=_LOCKED), True),
        ("lookup_for_good", _flag("LUTEnable", 1, lock=_LOCKED), True),
        ("shading_for_good", _flag("ShadingCorrectionEnable", 1, lock=_LOCKED), False),
    )
    for name, node, refused in locked:
        right = "refused by name" if refused else "recorded, or refused by name"
        yield case(name, right, lambda _, n=node, r=refused: _locked(n, refused=r))
    yield case("nothing_permanent", "nothing permanent is written", lambda _: _commands())
    bits = {16: 2**16 - 1, 32: 2**32 - 1, 64: 2**64 - 1}
    yield case("wrap_16_single", "0 refused", lambda _: _singles(65000, bits[16], 1), listed=True)
    yield case(
        "wrap_16_long",
        "0 refused",
        lambda _: _long(bits[16], 1, first=1, total=66000, lost=frozenset()),
        listed=True,
    )
    for width, after in ((16, 0), (32, 0), (32, 1), (64, 0), (64, 1)):
        largest = bits[width]
        yield case(
            f"wrap_{width}_to_{after}_single",
            "0 refused",
            lambda _, n=largest, a=after: _singles(n - 500, n, a),
        )
        yield case(
            f"wrap_{width}_to_{after}_long",
            "0 refused",
            lambda _, n=largest, a=after: _long(n, a, first=n - 500, total=1000, lost=frozenset()),
        )
    yield case("wrap_unseen_frames", "0 refused", lambda _: _singles(65000, bits[16], 1, lost=2))
    yield case(
        "wrap_lost_frames",
        "the others keep their places",
        lambda _: _long(
            bits[16], 1, first=65000, total=1000, lost=frozenset({534, 535, 536, 540, 700})
        ),
    )
    yield case("wrap_repeated", "refused", lambda _: _repeated())
    yield case("wrap_restarting", "0 refused", lambda _: _restarting())
    for each in ("each", "one"):
        yield case(
            f"plan_metered_{each}",
            "no more recorded than planned",
            lambda folder, e=each: _plan(folder, e),
            listed=each == "each",
        )


CASES = tuple(_cases())
