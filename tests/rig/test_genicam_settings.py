"""Cameras of different vendors: the same settings under other names, steps, units and errors."""

import math
from pathlib import Path

import pytest

from rig import CameraError
from rig.genicam import CameraOptions, FoundCamera
from rig.genicam.automatics import camera_settings, turn_off_automatics
from rig.genicam.nodes import Nodes
from rig.genicam.processing import PROCESSING
from rig.genicam.settings import EXPOSURE, Settings, TriggerControl
from rig.genicam.setup import set_up
from tests.rig.genicam_memory import Memory, amount, choice, command, switch

EXPOSURE_US = amount("ExposureTime", 1000, 10, 1e6, unit="us")


def settings(*nodes):
    return Settings(Nodes(Memory(nodes).node_map, "c7"))


@pytest.mark.parametrize(
    ("node", "wanted_us", "got_us"),
    [
        pytest.param(EXPOSURE_US, 123.5, 123.5, id="SFNC"),
        pytest.param(amount("ExposureTime", 1000, 10, 1e6), 123.5, 123.5, id="without a unit"),
        pytest.param(amount("ExposureTimeAbs", 1000, 10, 1e6, unit="us"), 50.0, 50.0, id="Abs"),
        pytest.param(amount("ExposureTimeRaw", 20, 20, 900_000, unit="us", kind="Integer", step=5),
                     123.5, 125.0, id="Raw in steps"),
        pytest.param(amount("ExposureTimeRaw", 20, 20, 900_000, unit="us", kind="Integer", step=7),
                     9e5, 9e5 - (9e5 - 20) % 7, id="the last step within the range"),
        pytest.param(amount("ExposureTime", 1, 0.01, 100, unit="ms"), 2500.0, 2500.0, id="ms"),
    ],
)  # fmt: skip
def test_the_exposure_is_set_under_any_name_and_read_back(node, wanted_us, got_us):
    camera = settings(node)
    assert camera.set_exposure(wanted_us) == pytest.approx(got_us)
    assert camera.exposure_us == pytest.approx(got_us)


@pytest.mark.parametrize(
    ("node", "wanted_us", "message"),
    [
        pytest.param(EXPOSURE_US, 9.0, r"c7, ExposureTime: 9 us .* range of 10 to 1e\+06 us",
                     id="too short"),
        pytest.param(EXPOSURE_US, 2e6, r"2e\+06 us is outside its range", id="too long"),
        pytest.param(EXPOSURE_US, math.nan, "nan us is outside its range", id="not a number"),
        pytest.param(amount("ExposureTime", 1, 0.01, 100, unit="ms"), 1.0,
                     "0.001 ms is outside its range of 0.01 to 100 ms", id="in its own unit"),
        pytest.param(amount("ExposureTimeRaw", 20, 20, 900_000, kind="Integer"), 100.0,
                     r"ExposureTimeRaw: its unit \(none\) is not a unit of time", id="ticks"),
        pytest.param(amount("ExposureTime", 20, 20, 900_000, access="RO"), 100.0,
                     "c7, ExposureTime, set to 100 us: .*not writable", id="read only"),
        pytest.param(amount("Gain", 0, 0, 1), 100.0, "c7 has no node ExposureTime", id="absent"),
    ],
)  # fmt: skip
def test_an_impossible_exposure_is_refused(node, wanted_us, message):
    camera = settings(node)
    with pytest.raises(CameraError, match=message) as error:
        camera.set_exposure(wanted_us)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("nodes", "wanted_db", "got_db"),
    [
        pytest.param((amount("Gain", 3, 0, 24, unit="dB"),), 6.5, 6.5, id="SFNC"),
        pytest.param((amount("GainAbs", 3, 0, 24, unit="dB"),), 6.5, 6.5, id="Abs"),
        pytest.param((amount("GainRaw", 3, 0, 24, unit="dB", kind="Integer"),), 6.4, 6.0,
                     id="whole dB"),
        pytest.param((), 0.0, 0.0, id="none"),
    ],
)  # fmt: skip
def test_gain_in_db_is_set_and_read_back(nodes, wanted_db, got_db):
    camera = settings(EXPOSURE_US, *nodes)
    assert camera.set_gain(wanted_db) == got_db
    assert camera.gain_db == got_db


@pytest.mark.parametrize(
    "node",
    [
        pytest.param(amount("GainRaw", 300, 36, 512, kind="Integer", step=4), id="raw"),
        pytest.param(amount("Gain", 3, 1, 10), id="a factor"),
    ],
)
def test_gain_without_a_unit_is_set_to_its_least(node):
    memory = Memory((EXPOSURE_US, node))
    nodes = Nodes(memory.node_map, "c7")
    camera = Settings(nodes)
    assert camera.set_gain(0.0) == 0.0
    assert nodes.number(node.name) == nodes.limits(node.name)[0]
    with pytest.raises(
        CameraError, match=f"c7, {node.name}: a gain of 6 dB is not possible, .* no gain in dB"
    ):
        camera.set_gain(6.0)


def test_the_gain_for_all_taps_is_selected():
    memory = Memory((choice("GainSelector", "Tap1", "Tap2", "All"), EXPOSURE_US))
    nodes = Nodes(memory.node_map, "c7")
    Settings(nodes)
    assert nodes.text("GainSelector") == "All"


@pytest.mark.parametrize(
    ("nodes", "period_us"),
    [
        pytest.param((amount("AcquisitionFrameRate", 20, 1, 50),), 50_000.0, id="rate in force"),
        pytest.param((amount("AcquisitionFrameRate", 20, 1, 50),
                      switch("AcquisitionFrameRateEnable", on=True)), 20_000.0, id="not limited"),
        pytest.param((amount("AcquisitionFrameRateAbs", 20, 1, 50),
                      amount("ResultingFrameRateAbs", 40, 1, 50, access="RO")), 25_000.0,
                     id="resulting"),
        pytest.param((), 0.0, id="unknown"),
    ],
)  # fmt: skip
def test_the_frame_period_is_what_the_camera_can_do(nodes, period_us):
    camera = settings(EXPOSURE_US, *nodes)
    camera.set_frame_rate(None)
    assert camera.frame_period_us() == period_us


def test_a_frame_rate_is_a_limit():
    camera = settings(
        amount("AcquisitionFrameRate", 20, 1, 50), switch("AcquisitionFrameRateEnable", on=False)
    )
    camera.set_frame_rate(10.0)
    assert camera.frame_period_us() == 100_000.0
    with pytest.raises(CameraError, match=r"AcquisitionFrameRate: 60 Hz .* range of 1 to 50 Hz"):
        camera.set_frame_rate(60.0)


@pytest.mark.parametrize(
    ("nodes", "shutter"),
    [
        pytest.param((), "global", id="no node"),
        pytest.param((choice("SensorShutterMode", "Global", "Rolling"),), "global", id="global"),
        pytest.param((choice("SensorShutterMode", "Rolling", "Global"),), "rolling", id="rolling"),
        pytest.param((choice("ShutterMode", "Rolling"),), "rolling", id="another name"),
    ],
)
def test_the_shutter_is_recognised(nodes, shutter):
    assert settings(EXPOSURE_US, *nodes).shutter() == shutter


def test_rows_that_begin_together_and_end_apart_are_refused():
    with pytest.raises(CameraError, match="SensorShutterMode: in the mode GlobalReset rows"):
        settings(choice("SensorShutterMode", "GlobalReset", "Rolling")).shutter()


@pytest.mark.parametrize(
    ("nodes", "readout_us"),
    [
        pytest.param((amount("SensorReadoutTime", 15_000, 0, 1e6, unit="us"),), 15_000.0, id="us"),
        pytest.param((amount("ReadoutTimeAbs", 15, 0, 1e6, unit="ms"),), 15_000.0, id="ms"),
        pytest.param((amount("AcquisitionFrameRate", 20, 1, 50),), 50_000.0, id="by frame rate"),
    ],
)
def test_the_readout_of_a_rolling_shutter_is_read(nodes, readout_us):
    assert settings(*nodes).readout_us() == readout_us


def test_a_rolling_shutter_of_unknown_readout_is_refused():
    with pytest.raises(CameraError, match=r"does not report its readout time .*readout_us"):
        settings(EXPOSURE_US).readout_us()


def test_temperature_delay_and_black_level_are_optional():
    bare = settings(EXPOSURE_US)
    assert bare.temperature_c() is None
    assert bare.trigger_delay_us() == 0.0
    with pytest.raises(CameraError, match="no node BlackLevel"):
        bare.set_black_level(1)
    full = settings(
        amount("DeviceTemperatureAbs", 41.5, -50, 150, access="RO"),
        amount("TriggerDelayAbs", 7, 0, 1e6, unit="us"),
        amount("BlackLevelRaw", 0, 0, 255, kind="Integer"),
    )
    assert full.temperature_c() == 41.5
    assert full.trigger_delay_us() == 7.0
    assert full.set_black_level(31.7) == 32.0


def test_without_an_exposure_node_the_exposure_is_unknown():
    bare = settings(amount("Gain", 0, 0, 1))
    assert math.isnan(bare.exposure_us)
    assert bare.exposure_range_us() == (0.0, 0.0)


AUTOMATICS = (
    choice("ExposureAuto", "Continuous", "Off", "Once"),
    choice("GainAuto", "Once", "Off"),
    choice("BalanceWhiteAuto", "Continuous", "Off"),
    choice("BlackLevelAuto", "Continuous", "Off"),
    switch("GammaEnable", on=True),
    switch("LUTEnable", on=True),
    amount("Gamma", 2.2, 0.1, 4),
    switch("DefectCorrectStaticEnable", on=True),
    choice("BslDefectPixelCorrectionMode", "On", "Off"),
)


def test_automatics_are_turned_off():
    nodes = Nodes(Memory(AUTOMATICS).node_map, "c7")
    assert set(turn_off_automatics(nodes)) == {automatic.name for automatic in AUTOMATICS}
    assert turn_off_automatics(nodes) == ()
    assert not nodes.flag("DefectCorrectStaticEnable")
    assert nodes.text("BslDefectPixelCorrectionMode") == "Off"
    for automatic in AUTOMATICS[:4]:
        assert nodes.text(automatic.name) == "Off"
    assert not nodes.flag("GammaEnable")
    assert not nodes.flag("LUTEnable")
    assert nodes.number("Gamma") == 1.0


@pytest.mark.parametrize(
    "automatic", [*AUTOMATICS[:6], *AUTOMATICS[7:]], ids=lambda node: node.name
)
def test_an_automatic_that_cannot_be_turned_off_is_named(automatic):
    nodes = Nodes(Memory(AUTOMATICS, stuck=frozenset({automatic.name})).node_map, "c7")
    with pytest.raises(CameraError, match=rf"c7, {automatic.name}: was set to .* but is still"):
        turn_off_automatics(nodes)


@pytest.mark.parametrize(
    ("node", "message"),
    [
        pytest.param(choice("GainAuto", "Continuous", access="RO"),
                     "'Off' is not available, only Contin", id="no off"),
        pytest.param(choice("GainAuto", "Continuous", "Off", access="RO"), "set to Off: .*writ",
                     id="read only"),
        pytest.param(amount("Gamma", 2.2, 0.1, 4, access="RO"), "Gamma: .*still 2.2", id="gamma"),
        pytest.param(choice("ExposureMode", "TriggerWidth"), "'Timed' is not available",
                     id="exposure mode"),
    ],
)  # fmt: skip
def test_a_refusal_to_turn_off_is_reported(node, message):
    with pytest.raises(CameraError, match=message):
        turn_off_automatics(Nodes(Memory((node,)).node_map, "c7"))


@pytest.mark.parametrize(
    "nodes",
    [
        pytest.param((), id="nothing"),
        pytest.param((choice("GainAuto", "Off", access="RO"),), id="locked, but off"),
        pytest.param((switch("GammaEnable", on=False, access="RO"),), id="disabled for good"),
        pytest.param((switch("GammaEnable", on=True), amount("Gamma", 2.2, 0.1, 4, access="RO")),
                     id="gamma of no effect"),
    ],
)  # fmt: skip
def test_nodes_that_are_off_are_not_written(nodes):
    memory = Memory(nodes)
    turn_off_automatics(Nodes(memory.node_map, "c7"))
    assert not {node.name for node in nodes if "RO" in node.xml} & set(memory.written)


@pytest.mark.parametrize("name", [
    "AcquisitionMode", "TriggerMode", "LineMode", "PixelFormat", "ReadoutMode", "ADCBitDepth",
    "BinningHorizontalMode", "LUTSelector", "GainSelector", "BalanceRatioSelector",
    "DeviceScanType", "SensorShutterMode", "AcquisitionFrameRateEnable", "ChunkModeActive",
    "UserSetDefault", "DeviceLinkThroughputLimitMode", "AutoFunctionROIUseBrightness",
    "DefectPixelTableValid", "DefectCorrectionReady", "KneePointCount",
    "GevSCPSDoNotFragment", "TriggerDelay", "ExposureTime", "BlackLevel", "Width", "OffsetX",
])  # fmt: skip
def test_nodes_that_do_not_process_samples_are_left_alone(name):
    assert not any(kind.has_switch(name) or kind.has_level(name) for kind in PROCESSING)


@pytest.mark.parametrize("name", [
    "DefectCorrectStaticEnable", "DefectCorrectDynamicEnable", "DefectCorrectionEnable",
    "DefectPixelCorrection", "DefectPixelCorrectionEnable", "DefectPixelCorrectionMode",
    "DefectivePixelCorrection", "DefectMaskEnable", "BslDefectPixelCorrectionMode",
    "mvDefectivePixelEnable", "pgrDefectPixelCorrectionEnable", "defectivePixelReplacementMode",
    "GammaEnable", "GammaEnabled", "LUTEnable", "SharpnessEnable", "NoiseReductionEnable",
    "TestPattern", "TestImageSelector", "GainAutoBalance", "BlackLevelAutoBalance", "ReverseY",
    "HorizontalFlipEnable", "KneePointEnable",
])  # fmt: skip
def test_names_of_many_makers_are_known(name):
    assert any(kind.has_switch(name) for kind in PROCESSING)


def test_binning_is_turned_off_and_the_field_of_view_kept():
    whole = {"kind": "Integer", "step": 1}
    nodes = Nodes(Memory((
        amount("BinningHorizontal", 2, 1, 4, **whole),
        amount("DecimationVertical", 3, 1, 4, **whole),
        amount("Width", 300, 1, 1000, **whole),
        amount("OffsetX", 20, 0, 1000, **whole),
        amount("Height", 400, 1, 1000, **whole),
    )).node_map, "c7")  # fmt: skip
    assert set(turn_off_automatics(nodes)) == {"BinningHorizontal", "DecimationVertical"}
    sizes = [nodes.number(name) for name in ("Width", "OffsetX", "Height")]
    assert sizes == [600, 40, 1000], "at most what the sensor has"


@pytest.mark.parametrize("node", [
    amount("BalanceRatio", 1500, 1, 16376, kind="Integer"), amount("Saturation", 128, 0, 255),
    amount("Hue", 128, 0, 255), amount("Contrast", 50, 0, 100), amount("Brightness", 80, 0, 255),
], ids=lambda node: node.name)  # fmt: skip
def test_a_level_whose_neutral_value_only_the_maker_knows_is_recorded(node):
    nodes = Nodes(Memory((node,)).node_map, "c7")
    assert turn_off_automatics(nodes) == ()
    assert camera_settings(nodes) == {node.name: node.value}


def test_settings_are_those_that_can_be_written_and_locked_processing():
    nodes = Nodes(Memory((
        choice("ReadoutMode", "Normal", "Fast"),
        amount("Slope", 1 / 3, 0, 1),
        switch("ShadingEnable", on=True, access="RO"),
        switch("LineStatus", on=True),
        amount("DeviceTemperature", 41.5, -50, 150, access="RO"),
        amount("ExposureTime", 100, 1, 1000),
        command("UserSetSave"),
    )).node_map, "c7")  # fmt: skip
    expected = {"ReadoutMode": "Normal", "Slope": 0.333333, "ShadingEnable": True}
    assert camera_settings(nodes) == expected


TRIGGER = (
    choice("AcquisitionMode", "SingleFrame", "Continuous"),
    choice("TriggerSelector", "AcquisitionStart", "FrameStart"),
    choice("TriggerMode", "On", "Off"),
    choice("TriggerSource", "Line1", "Software", "Line2"),
    choice("TriggerActivation", "FallingEdge", "RisingEdge"),
    choice("LineSelector", "Line1", "Line2", "Line3"),
    choice("LineMode", "Output", "Input"),
    command("TriggerSoftware"),
)


@pytest.mark.parametrize(
    ("trigger", "source", "line"),
    [("software", "Software", "Line1"), ("line", "Line2", "Line2")],
)
def test_each_trigger_of_the_chosen_kind_gives_one_frame(trigger, source, line):
    memory = Memory(TRIGGER)
    nodes = Nodes(memory.node_map, "c7")
    control = TriggerControl(nodes, "Line2")
    control.choose(trigger)
    assert nodes.text("AcquisitionMode") == "Continuous"
    assert nodes.text("TriggerSelector") == "FrameStart"
    assert nodes.text("TriggerMode") == "On"
    assert nodes.text("TriggerSource") == source
    assert nodes.text("LineSelector") == line
    if trigger == "line":
        assert nodes.text("TriggerActivation") == "RisingEdge"
        assert nodes.text("LineMode") == "Input"
    control.fire()
    assert memory.written[-1] == "TriggerSoftware"


def test_the_message_of_a_missing_line_lists_the_lines():
    control = TriggerControl(Nodes(Memory(TRIGGER).node_map, "c7"), "Line0")
    with pytest.raises(
        CameraError, match="TriggerSource: 'Line0' is not available, only Line1, Software, L"
    ):
        control.choose("line")


def test_a_camera_without_a_trigger_for_single_frames_is_refused():
    nodes = (choice("TriggerSelector", "LineStart"), *TRIGGER[2:])
    with pytest.raises(
        CameraError, match="none of FrameStart, ExposureStart is available, only LineStart"
    ):
        TriggerControl(Nodes(Memory(nodes).node_map, "c7"), "Line1").choose("software")


def test_a_node_is_accessed_by_the_first_existing_name():
    nodes = Nodes(Memory((amount("ExposureTimeAbs", 5, 1, 9),)).node_map, "c7")
    assert nodes.name(EXPOSURE) == "ExposureTimeAbs"
    assert nodes.exists(EXPOSURE)
    assert not nodes.exists("ExposureTime")


def test_a_camera_without_a_format_of_raw_samples_is_refused():
    nodes = Nodes(Memory([choice("PixelFormat", "RGB8", "YUV422_8")]).node_map, "c7")
    found = FoundCamera(Path("x.cti"), "maker", "model", "c7")
    with pytest.raises(CameraError, match=r"c7.* no format of raw samples.* only RGB8, YUV422_8:"):
        set_up(nodes, Settings(nodes), found, CameraOptions())
