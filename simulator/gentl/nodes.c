#include "nodes.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "answers.h"
#include "nodes_table.h"

static const struct control *camera;
static struct pixel_format formats[PIXEL_FORMATS];
static union value {
    int64_t integer;
    double real;
    char text[NODE_STRIDE];
} values[NODES];

int64_t node_integer(enum node node) { return values[node].integer; }
double node_float(enum node node) { return values[node].real; }
void node_set_integer(enum node node, int64_t value) { values[node].integer = value; }
void node_set_float(enum node node, double value) { values[node].real = value; }

struct pixel_format node_pixel_format(void)
{
    int i = 0;
    while (i < PIXEL_FORMATS - 1 && formats[i].code != (uint32_t)values[PIXEL_FORMAT].integer)
        i++;
    return formats[i];
}

size_t node_payload(void)
{
    const struct pixel_format format = node_pixel_format();
    return packed_size(&format, (size_t)(values[WIDTH].integer * values[HEIGHT].integer));
}

static void set_text(enum node node, const char *text)
{
    snprintf(values[node].text, NODE_STRIDE, "%s", text);
}

void nodes_reset(const struct control *of)
{
    camera = of;
    pixel_formats(camera->cfa, formats);
    memset(values, 0, sizeof values);
    for (int n = 0; n < NODES; n++) {
        if (NODE_TABLE[n].kind == KIND_FLOAT)
            values[n].real = NODE_TABLE[n].initial;
        else
            values[n].integer = (int64_t)NODE_TABLE[n].initial;
    }
    set_text(DEVICE_VENDOR_NAME, "sgp");
    set_text(DEVICE_MODEL_NAME, "virtual camera");
    set_text(DEVICE_SERIAL_NUMBER, camera->serial);
    set_text(DEVICE_VERSION, "1.0");
    values[SENSOR_WIDTH].integer = values[WIDTH].integer = camera->width;
    values[SENSOR_HEIGHT].integer = values[HEIGHT].integer = camera->height;
    values[SENSOR_SHUTTER_MODE].integer = camera->rolling;
    values[SENSOR_READOUT_TIME].real = camera->readout_us;
    int widest = 0;
    while (formats[widest].bits < (int)camera->bit_depth ||
           (formats[widest].packing != PACK_WORDS && formats[widest].packing != PACK_BYTES))
        widest++;
    values[PIXEL_FORMAT].integer = formats[widest].code;
    values[BLACK_LEVEL].real = camera->black_level_dn;
    values[EXPOSURE_AUTO].integer = (camera->autos & AUTO_EXPOSURE) != 0;
    values[GAIN_AUTO].integer = (camera->autos & AUTO_GAIN) != 0;
    values[BALANCE_WHITE_AUTO].integer = (camera->autos & AUTO_WHITE) != 0;
    if (camera->autos & AUTO_GAMMA) {
        values[GAMMA_ENABLE].integer = 1;
        values[GAMMA].real = 0.45;
    }
    values[FRAME_RATE].real = node_maximum(FRAME_RATE);
}

double node_maximum(enum node node)
{
    const int64_t *with[] = {&values[OFFSET_X].integer, &values[OFFSET_Y].integer,
                             &values[WIDTH].integer, &values[HEIGHT].integer};
    switch (node) {
    case WIDTH: return (double)(camera->width - *with[0]);
    case HEIGHT: return (double)(camera->height - *with[1]);
    case OFFSET_X: return (double)(camera->width - *with[2]);
    case OFFSET_Y: return (double)(camera->height - *with[3]);
    case FRAME_RATE:
        return fmin(1e6 / fmax(camera->frame_period_us, camera->readout_us),
                    NODE_TABLE[node].max);
    case BLACK_LEVEL: return ldexp(1, (int)camera->bit_depth) - 2;
    default: return NODE_TABLE[node].max;
    }
}

/* Update the value of a node that depends on others. */
static void refresh(enum node node)
{
    switch (node) {
    case WIDTH_MAX:
    case HEIGHT_MAX:
    case OFFSET_X_MAX:
    case OFFSET_Y_MAX:
        values[node].integer = (int64_t)node_maximum(WIDTH + (node - WIDTH_MAX));
        break;
    case PAYLOAD_SIZE: values[node].integer = (int64_t)node_payload(); break;
    case DEVICE_TEMPERATURE: values[node].real = camera->temperature_c; break;
    default: break;
    }
}

static int node_at(uint64_t address, size_t size)
{
    const uint64_t offset = address - NODE_ADDRESS(0);
    if (address < NODE_ADDRESS(0) || offset >= (uint64_t)NODES * NODE_STRIDE || offset % NODE_STRIDE)
        return -1;
    const int node = (int)(offset / NODE_STRIDE);
    return size == (NODE_TABLE[node].kind == KIND_TEXT ? NODE_STRIDE : 8) ? node : -1;
}

GC_ERROR nodes_read(uint64_t address, void *to, size_t size)
{
    const int node = node_at(address, size);
    if (node < 0)
        return fail(GC_ERR_INVALID_ADDRESS, "no register of %zu bytes at 0x%llx", size,
                    (unsigned long long)address);
    refresh((enum node)node);
    memcpy(to, &values[node], size);
    return GC_ERR_SUCCESS;
}

/* Whether an automatic function of this camera is stuck: it accepts a value but ignores it. */
static bool stuck(enum node node)
{
    return (node == EXPOSURE_AUTO && camera->stuck & AUTO_EXPOSURE) ||
           (node == GAIN_AUTO && camera->stuck & AUTO_GAIN) ||
           (node == BALANCE_WHITE_AUTO && camera->stuck & AUTO_WHITE) ||
           ((node == GAMMA || node == GAMMA_ENABLE) && camera->stuck & AUTO_GAMMA);
}

static GC_ERROR refuse(enum node node, double value)
{
    return fail(GC_ERR_INVALID_VALUE, "%s is %g, it must be within %g to %g", NODE_TABLE[node].name,
                value, NODE_TABLE[node].min, node_maximum(node));
}

static bool has_entry(enum node node, int64_t value)
{
    if (node == PIXEL_FORMAT) {
        for (int i = 0; i < PIXEL_FORMATS; i++)
            if (formats[i].code == (uint32_t)value)
                return true;
        return false;
    }
    return value >= 0 && value < NODE_TABLE[node].entries;
}

GC_ERROR nodes_write(uint64_t address, const void *from, size_t size, enum node *written)
{
    const int at = node_at(address, size);
    if (at < 0)
        return fail(GC_ERR_INVALID_ADDRESS, "no register of %zu bytes at 0x%llx", size,
                    (unsigned long long)address);
    const enum node node = *written = (enum node)at;
    const struct node_entry *entry = &NODE_TABLE[node];
    if (!entry->writable)
        return fail(GC_ERR_ACCESS_DENIED, "%s is read-only", entry->name);
    if (entry->locked && values[TL_PARAMS_LOCKED].integer)
        return fail(GC_ERR_ACCESS_DENIED, "%s cannot be changed while TLParamsLocked is 1",
                    entry->name);
    union value value;
    memcpy(&value, from, 8);
    if (entry->kind == KIND_FLOAT) {
        if (!(value.real >= entry->min && value.real <= node_maximum(node)))
            return refuse(node, value.real);
        if (node == EXPOSURE_TIME)
            value.real = nearbyint(value.real);
    } else if (entry->kind == KIND_ENUM ? !has_entry(node, value.integer)
                                        : value.integer < (int64_t)entry->min ||
                                              value.integer > (int64_t)node_maximum(node)) {
        return refuse(node, (double)value.integer);
    }
    if ((node == OFFSET_X || node == OFFSET_Y) && camera->cfa[0] && value.integer % 2)
        return fail(GC_ERR_INVALID_VALUE, "%s must be even for a mosaic", entry->name);
    /* A command is complete immediately: its register reads 0 again. */
    if (!stuck(node) && entry->kind != KIND_COMMAND)
        memcpy(&values[node], &value, 8);
    return GC_ERR_SUCCESS;
}
