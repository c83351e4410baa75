/* The entry points of library, system, interface and device. */
#include <string.h>

#include "answers.h"
#include "camera.h"
#include "modules.h"
#include "stream.h"

GC_API GC_ERROR GCInitLib(void) { return initialise(); }
GC_API GC_ERROR GCCloseLib(void) { return finalise(); }

GC_API GC_ERROR GCGetLastError(GC_ERROR *code, char *text, size_t *size)
{
    return last_error(code, text, size);
}

static GC_ERROR check_id(const char *id, const char *expected)
{
    if (id && strcmp(id, expected) == 0)
        return GC_ERR_SUCCESS;
    return fail(GC_ERR_INVALID_ID, "there is no '%s', only '%s'", id ? id : "", expected);
}

static GC_ERROR system_info(int32_t what, struct answer to)
{
    switch (what) {
    case TL_INFO_ID: return answer_text(to, "sgp virtual camera");
    case TL_INFO_VENDOR: return answer_text(to, VENDOR);
    case TL_INFO_MODEL: return answer_text(to, MODEL);
    case TL_INFO_VERSION: return answer_text(to, "1.0");
    case TL_INFO_TLTYPE: return answer_text(to, LAYER);
    case TL_INFO_NAME: {
        const char *slash = strrchr(control_library(), '/');
        return answer_text(to, slash ? slash + 1 : control_library());
    }
    case TL_INFO_PATHNAME: return answer_text(to, control_library());
    case TL_INFO_DISPLAYNAME: return answer_text(to, "sgp virtual camera");
    case TL_INFO_CHAR_ENCODING: return answer_i32(to, 0);
    case TL_INFO_GENTL_VER_MAJOR: return answer_u32(to, 1);
    case TL_INFO_GENTL_VER_MINOR: return answer_u32(to, 5);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no system info %d", (int)what);
    }
}

GC_API GC_ERROR GCGetInfo(int32_t what, INFO_DATATYPE *type, void *buffer, size_t *size)
{
    const GC_ERROR result = check_initialised();
    return result ? result : system_info(what, ANSWER);
}

GC_API GC_ERROR TLOpen(HANDLE *tl) { return module_open(SYSTEM, tl); }

GC_API GC_ERROR TLClose(HANDLE tl)
{
    CHECK(tl, SYSTEM);
    module_close(SYSTEM);
    return GC_ERR_SUCCESS;
}

GC_API GC_ERROR TLGetInfo(HANDLE tl, int32_t what, INFO_DATATYPE *type, void *buffer, size_t *size)
{
    CHECK(tl, SYSTEM);
    return system_info(what, ANSWER);
}

GC_API GC_ERROR TLGetNumInterfaces(HANDLE tl, uint32_t *count)
{
    CHECK(tl, SYSTEM);
    return answer_count(count, 1);
}

GC_API GC_ERROR TLGetInterfaceID(HANDLE tl, uint32_t index, char *id, size_t *size)
{
    CHECK(tl, SYSTEM);
    if (index != 0)
        return fail(GC_ERR_INVALID_INDEX, "there is only one interface");
    return answer_text((struct answer){NULL, id, size}, INTERFACE_ID);
}

static GC_ERROR interface_info(int32_t what, struct answer to)
{
    switch (what) {
    case INTERFACE_INFO_ID: return answer_text(to, INTERFACE_ID);
    case INTERFACE_INFO_DISPLAYNAME: return answer_text(to, "sgp bench");
    case INTERFACE_INFO_TLTYPE: return answer_text(to, LAYER);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no interface info %d", (int)what);
    }
}

GC_API GC_ERROR TLGetInterfaceInfo(HANDLE tl, const char *id, int32_t what, INFO_DATATYPE *type,
                                   void *buffer, size_t *size)
{
    CHECK(tl, SYSTEM);
    const GC_ERROR checked = check_id(id, INTERFACE_ID);
    return checked ? checked : interface_info(what, ANSWER);
}

GC_API GC_ERROR TLOpenInterface(HANDLE tl, const char *id, HANDLE *interface)
{
    CHECK(tl, SYSTEM);
    const GC_ERROR checked = check_id(id, INTERFACE_ID);
    return checked ? checked : module_open(INTERFACE, interface);
}

GC_API GC_ERROR TLUpdateInterfaceList(HANDLE tl, bool8_t *changed, uint64_t timeout_ms)
{
    (void)timeout_ms;
    CHECK(tl, SYSTEM);
    if (changed)
        *changed = 0;
    return GC_ERR_SUCCESS;
}

GC_API GC_ERROR IFClose(HANDLE interface)
{
    CHECK(interface, INTERFACE);
    module_close(INTERFACE);
    return GC_ERR_SUCCESS;
}

GC_API GC_ERROR IFGetInfo(HANDLE interface, int32_t what, INFO_DATATYPE *type, void *buffer,
                          size_t *size)
{
    CHECK(interface, INTERFACE);
    return interface_info(what, ANSWER);
}

GC_API GC_ERROR IFGetParentTL(HANDLE interface, HANDLE *tl)
{
    CHECK(interface, INTERFACE);
    return module_handle(SYSTEM, tl);
}

GC_API GC_ERROR IFGetNumDevices(HANDLE interface, uint32_t *count)
{
    CHECK(interface, INTERFACE);
    return answer_count(count, camera_plugged());
}

GC_API GC_ERROR IFGetDeviceID(HANDLE interface, uint32_t index, char *id, size_t *size)
{
    CHECK(interface, INTERFACE);
    if (index >= (uint32_t)camera_plugged())
        return fail(GC_ERR_INVALID_INDEX, "there is no device %u", index);
    return answer_text((struct answer){NULL, id, size}, camera_serial());
}

GC_API GC_ERROR IFUpdateDeviceList(HANDLE interface, bool8_t *changed, uint64_t timeout_ms)
{
    (void)timeout_ms;
    static int before = -1;
    CHECK(interface, INTERFACE);
    const int now = camera_plugged();
    if (changed)
        *changed = now != before;
    before = now;
    return GC_ERR_SUCCESS;
}

static GC_ERROR device_info(int32_t what, struct answer to)
{
    switch (what) {
    case DEVICE_INFO_VENDOR: return answer_text(to, VENDOR);
    case DEVICE_INFO_MODEL: return answer_text(to, MODEL);
    case DEVICE_INFO_TLTYPE: return answer_text(to, LAYER);
    case DEVICE_INFO_DISPLAYNAME: return answer_text(to, MODEL);
    case DEVICE_INFO_ACCESS_STATUS:
        return answer_i32(to, module_is_open(DEVICE) ? DEVICE_ACCESS_STATUS_OPEN_READWRITE
                                                        : DEVICE_ACCESS_STATUS_READWRITE);
    case DEVICE_INFO_ID:
    case DEVICE_INFO_USER_DEFINED_NAME:
    case DEVICE_INFO_SERIAL_NUMBER: return answer_text(to, camera_serial());
    case DEVICE_INFO_VERSION: return answer_text(to, "1.0");
    case DEVICE_INFO_TIMESTAMP_FREQUENCY: return answer_u64(to, 1000000000);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no device info %d", (int)what);
    }
}

GC_API GC_ERROR IFGetDeviceInfo(HANDLE interface, const char *id, int32_t what,
                                INFO_DATATYPE *type, void *buffer, size_t *size)
{
    CHECK(interface, INTERFACE);
    const GC_ERROR checked = check_id(id, camera_serial());
    return checked ? checked : device_info(what, ANSWER);
}

GC_API GC_ERROR IFOpenDevice(HANDLE interface, const char *id, int32_t access, HANDLE *device)
{
    CHECK(interface, INTERFACE);
    GC_ERROR result = check_id(id, camera_serial());
    if (!result && access <= DEVICE_ACCESS_NONE)
        result = fail(GC_ERR_ACCESS_DENIED, "no access was requested");
    if (!result)
        result = module_open(DEVICE, device);
    if (!result && (result = camera_open()))
        module_close(DEVICE);
    return result;
}

GC_API GC_ERROR DevClose(HANDLE device)
{
    CHECK(device, DEVICE);
    module_close(DEVICE);
    return GC_ERR_SUCCESS;
}

GC_API GC_ERROR DevGetInfo(HANDLE device, int32_t what, INFO_DATATYPE *type, void *buffer,
                           size_t *size)
{
    CHECK(device, DEVICE);
    return device_info(what, ANSWER);
}

GC_API GC_ERROR DevGetPort(HANDLE device, HANDLE *port)
{
    CHECK(device, DEVICE);
    return module_is_open(REMOTE) ? module_handle(REMOTE, port) : module_open(REMOTE, port);
}

GC_API GC_ERROR DevGetParentIF(HANDLE device, HANDLE *interface)
{
    CHECK(device, DEVICE);
    return module_handle(INTERFACE, interface);
}

GC_API GC_ERROR DevGetNumDataStreams(HANDLE device, uint32_t *count)
{
    CHECK(device, DEVICE);
    return answer_count(count, 1);
}

GC_API GC_ERROR DevGetDataStreamID(HANDLE device, uint32_t index, char *id, size_t *size)
{
    CHECK(device, DEVICE);
    if (index != 0)
        return fail(GC_ERR_INVALID_INDEX, "there is only one stream");
    return answer_text((struct answer){NULL, id, size}, STREAM_ID);
}

GC_API GC_ERROR DevOpenDataStream(HANDLE device, const char *id, HANDLE *stream)
{
    CHECK(device, DEVICE);
    GC_ERROR result = check_id(id, STREAM_ID);
    if (!result && !(result = module_open(STREAM, stream)))
        stream_open(camera_most_buffers());
    return result;
}
