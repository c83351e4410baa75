#include "camera.h"

#include "acquisition.h"
#include "answers.h"
#include "bench.h"
#include "clock.h"
#include "nodes.h"
#include "nodes_xml.h"

static struct control *control;
static struct files files;
static bool is_open;

/* The control file, which is opened when it is first needed. */
static struct control *opened_control(void)
{
    if (!control)
        control = control_open(&files);
    return control;
}

bool camera_plugged(void)
{
    /* A damaged camera is listed, so that the error of opening it can name the reason. */
    return !opened_control() || __atomic_load_n(&control->plugged, __ATOMIC_ACQUIRE);
}

const char *camera_serial(void) { return opened_control() ? control->serial : "damaged"; }

GC_ERROR camera_open(void)
{
    if (!opened_control())
        return GC_ERR_IO;
    if (!camera_plugged())
        return fail(GC_ERR_IO, "camera %s is not plugged in", control->serial);
    if (!control_lock())
        return fail(GC_ERR_RESOURCE_IN_USE, "camera %s is in use by another process",
                    control->serial);
    GC_ERROR result = bench_open(control->bench_path);
    if (!result) {
        nodes_reset(control);
        nodes_write_xml(control);
        result = acquisition_open(control, &files);
    }
    if (result) {
        bench_close();
        control_unlock();
    }
    is_open = !result;
    return result;
}

void camera_close(void)
{
    if (is_open) {
        acquisition_close();
        bench_close();
        control_unlock();
    }
    is_open = false;
}

void camera_forget(void)
{
    camera_close();
    control_close();
    control = NULL;
}

size_t camera_payload(void)
{
    device_lock();
    const size_t size = node_payload();
    device_unlock();
    return size;
}

uint32_t camera_most_buffers(void) { return control ? control->most_buffers : 0; }

static GC_ERROR check_alive(void)
{
    return acquisition_alive()
               ? GC_ERR_SUCCESS
               : fail(GC_ERR_IO, "camera %s does not answer: was it unplugged?", control->serial);
}

static int line_status(void)
{
    const uint64_t pulses = bench_pulses();
    const int64_t since = pulses ? now_ns() - bench_pulse(pulses - 1) : -1;
    return since >= 0 && since < BENCH_PULSE_NS;
}

GC_ERROR camera_read(uint64_t address, void *to, size_t size)
{
    GC_ERROR result = check_alive();
    if (result || xml_read(nodes_xml(), address, to, size))
        return result;
    device_lock();
    if (address == NODE_ADDRESS(LINE_STATUS))
        node_set_integer(LINE_STATUS, line_status());
    if (address == NODE_ADDRESS(DEVICE_TIMESTAMP))
        node_set_integer(DEVICE_TIMESTAMP, now_ns());
    result = nodes_read(address, to, size);
    device_unlock();
    return result;
}

static GC_ERROR obey(enum node node)
{
    switch (node) {
    case ACQUISITION_START: acquisition_start(); return GC_ERR_SUCCESS;
    case ACQUISITION_STOP: acquisition_stop(); return GC_ERR_SUCCESS;
    case TRIGGER_SOFTWARE: return acquisition_software_trigger();
    case TIMESTAMP_LATCH: node_set_integer(TIMESTAMP_LATCH_VALUE, now_ns()); return GC_ERR_SUCCESS;
    default: return GC_ERR_SUCCESS;
    }
}

GC_ERROR camera_write(uint64_t address, const void *from, size_t size)
{
    GC_ERROR result = check_alive();
    if (result)
        return result;
    enum node node;
    device_lock();
    result = nodes_write(address, from, size, &node);
    if (!result)
        result = obey(node);
    acquisition_notice();
    device_unlock();
    return result;
}
