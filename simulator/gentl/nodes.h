/* The camera's features and their values. Node map (XML) and registers use the same table. */
#ifndef NODES_H
#define NODES_H

#include "control.h"
#include "gentl.h"
#include "pixels.h"

enum node {
    DEVICE_VENDOR_NAME,
    DEVICE_MODEL_NAME,
    DEVICE_SERIAL_NUMBER,
    DEVICE_VERSION,
    DEVICE_TEMPERATURE,
    DEVICE_TIMESTAMP,
    TIMESTAMP_LATCH,
    TIMESTAMP_LATCH_VALUE,
    SENSOR_WIDTH,
    SENSOR_HEIGHT,
    SENSOR_SHUTTER_MODE,
    SENSOR_READOUT_TIME,
    WIDTH_MAX,
    HEIGHT_MAX,
    OFFSET_X_MAX,
    OFFSET_Y_MAX,
    WIDTH,
    HEIGHT,
    OFFSET_X,
    OFFSET_Y,
    PIXEL_FORMAT,
    PAYLOAD_SIZE,
    EXPOSURE_MODE,
    EXPOSURE_TIME,
    EXPOSURE_AUTO,
    GAIN,
    GAIN_AUTO,
    BALANCE_WHITE_AUTO,
    BLACK_LEVEL,
    GAMMA_ENABLE,
    GAMMA,
    ACQUISITION_MODE,
    ACQUISITION_FRAME_COUNT,
    ACQUISITION_START,
    ACQUISITION_STOP,
    FRAME_RATE_ENABLE,
    FRAME_RATE,
    TRIGGER_SELECTOR,
    TRIGGER_MODE,
    TRIGGER_SOURCE,
    TRIGGER_ACTIVATION,
    TRIGGER_DELAY,
    TRIGGER_SOFTWARE,
    LINE_SELECTOR,
    LINE_STATUS,
    TL_PARAMS_LOCKED,
    NODES
};

enum { OFF, ON };                                 /* modes and automatic functions */
enum { MODE_CONTINUOUS, MODE_SINGLE, MODE_MULTI };
enum { SOURCE_SOFTWARE, SOURCE_LINE0 };
enum { RISING_EDGE, FALLING_EDGE };

/* Set the values after power-up. */
void nodes_reset(const struct control *camera);
int64_t node_integer(enum node node);
double node_float(enum node node);
void node_set_integer(enum node node, int64_t value);
void node_set_float(enum node node, double value);
struct pixel_format node_pixel_format(void);
/* Bytes of a frame. */
size_t node_payload(void);

/* The present maximum of a node. */
double node_maximum(enum node node);

/* The registers: addresses from 0x1000, 64 bytes per node. */
GC_ERROR nodes_read(uint64_t address, void *to, size_t size);
/* Check a value against the range of its node and store it; `written` returns the node. */
GC_ERROR nodes_write(uint64_t address, const void *from, size_t size, enum node *written);

#define NODE_STRIDE 64u
#define NODE_ADDRESS(node) (0x1000u + NODE_STRIDE * (uint64_t)(node))

#endif
