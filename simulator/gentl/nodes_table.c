#include "nodes_table.h"

#define READ_TEXT(title) {.name = title, .kind = KIND_TEXT}
#define READ_INTEGER(title) {.name = title, .kind = KIND_INTEGER, .max = 9e15}
#define COMMAND(title) {.name = title, .kind = KIND_COMMAND, .writable = true, .max = 1}
#define SWITCH(title)                                                                            \
    {                                                                                            \
        .name = title, .kind = KIND_BOOLEAN, .writable = true, .max = 1                          \
    }
#define CHOICE(title, first, second)                                                             \
    {                                                                                            \
        .name = title, .kind = KIND_ENUM, .writable = true, .names = {first, second},            \
        .entries = 2, .max = 1                                                                   \
    }
#define ONLY(title, first)                                                                       \
    {                                                                                            \
        .name = title, .kind = KIND_ENUM, .writable = true, .names = {first}, .entries = 1       \
    }
#define AREA(title, least, room)                                                                 \
    {                                                                                            \
        .name = title, .kind = KIND_INTEGER, .writable = true, .locked = true, .min = least,     \
        .max = 65535, .max_node = room                                                           \
    }
#define AMOUNT(title, value, least, greatest, of)                                                \
    {                                                                                            \
        .name = title, .kind = KIND_FLOAT, .writable = true, .initial = value, .min = least,     \
        .max = greatest, .unit = of                                                              \
    }
#define READ_AMOUNT(title, of)                                                                   \
    {                                                                                            \
        .name = title, .kind = KIND_FLOAT, .min = -1e9, .max = 1e9, .unit = of                   \
    }

const struct node_entry NODE_TABLE[NODES] = {
    [DEVICE_VENDOR_NAME] = READ_TEXT("DeviceVendorName"),
    [DEVICE_MODEL_NAME] = READ_TEXT("DeviceModelName"),
    [DEVICE_SERIAL_NUMBER] = READ_TEXT("DeviceSerialNumber"),
    [DEVICE_VERSION] = READ_TEXT("DeviceVersion"),
    [DEVICE_TEMPERATURE] = READ_AMOUNT("DeviceTemperature", "C"),
    [DEVICE_TIMESTAMP] = READ_INTEGER("DeviceTimestamp"),
    [TIMESTAMP_LATCH] = COMMAND("TimestampLatch"),
    [TIMESTAMP_LATCH_VALUE] = READ_INTEGER("TimestampLatchValue"),
    [SENSOR_WIDTH] = READ_INTEGER("SensorWidth"),
    [SENSOR_HEIGHT] = READ_INTEGER("SensorHeight"),
    [SENSOR_SHUTTER_MODE] = {.name = "SensorShutterMode", .kind = KIND_ENUM, .max = 1,
                             .names = {"Global", "Rolling"}, .entries = 2},
    [SENSOR_READOUT_TIME] = READ_AMOUNT("SensorReadoutTime", "us"),
    [WIDTH_MAX] = READ_INTEGER("WidthMax"),
    [HEIGHT_MAX] = READ_INTEGER("HeightMax"),
    [OFFSET_X_MAX] = READ_INTEGER("OffsetXMax"),
    [OFFSET_Y_MAX] = READ_INTEGER("OffsetYMax"),
    [WIDTH] = AREA("Width", 1, WIDTH_MAX),
    [HEIGHT] = AREA("Height", 1, HEIGHT_MAX),
    [OFFSET_X] = AREA("OffsetX", 0, OFFSET_X_MAX),
    [OFFSET_Y] = AREA("OffsetY", 0, OFFSET_Y_MAX),
    [PIXEL_FORMAT] = {.name = "PixelFormat", .kind = KIND_ENUM, .writable = true, .locked = true},
    [PAYLOAD_SIZE] = READ_INTEGER("PayloadSize"),
    [EXPOSURE_MODE] = ONLY("ExposureMode", "Timed"),
    [EXPOSURE_TIME] = AMOUNT("ExposureTime", 10000, 10, 1e7, "us"),
    [EXPOSURE_AUTO] = CHOICE("ExposureAuto", "Off", "Continuous"),
    [GAIN] = AMOUNT("Gain", 0, 0, 24, "dB"),
    [GAIN_AUTO] = CHOICE("GainAuto", "Off", "Continuous"),
    [BALANCE_WHITE_AUTO] = CHOICE("BalanceWhiteAuto", "Off", "Continuous"),
    [BLACK_LEVEL] = AMOUNT("BlackLevel", 0, 0, 65535, "DN"),
    [GAMMA_ENABLE] = SWITCH("GammaEnable"),
    [GAMMA] = AMOUNT("Gamma", 1, 0.1, 4, ""),
    [ACQUISITION_MODE] = {.name = "AcquisitionMode", .kind = KIND_ENUM, .writable = true,
                          .locked = true, .max = 2, .names = {"Continuous", "SingleFrame", "MultiFrame"},
                          .entries = 3},
    [ACQUISITION_FRAME_COUNT] = {.name = "AcquisitionFrameCount", .kind = KIND_INTEGER,
                                 .writable = true, .initial = 1, .min = 1, .max = 65535},
    [ACQUISITION_START] = COMMAND("AcquisitionStart"),
    [ACQUISITION_STOP] = COMMAND("AcquisitionStop"),
    [FRAME_RATE_ENABLE] = SWITCH("AcquisitionFrameRateEnable"),
    [FRAME_RATE] = AMOUNT("AcquisitionFrameRate", 30, 0.1, 100000, "Hz"),
    [TRIGGER_SELECTOR] = ONLY("TriggerSelector", "FrameStart"),
    [TRIGGER_MODE] = CHOICE("TriggerMode", "Off", "On"),
    [TRIGGER_SOURCE] = CHOICE("TriggerSource", "Software", "Line0"),
    [TRIGGER_ACTIVATION] = CHOICE("TriggerActivation", "RisingEdge", "FallingEdge"),
    [TRIGGER_DELAY] = AMOUNT("TriggerDelay", 0, 0, 1e6, "us"),
    [TRIGGER_SOFTWARE] = COMMAND("TriggerSoftware"),
    [LINE_SELECTOR] = ONLY("LineSelector", "Line0"),
    [LINE_STATUS] = {.name = "LineStatus", .kind = KIND_BOOLEAN, .max = 1},
    [TL_PARAMS_LOCKED] = {.name = "TLParamsLocked", .kind = KIND_INTEGER, .writable = true,
                          .max = 1},
};
