/* The entry points of ports: registers and node maps of every module. */
#include <stdio.h>
#include <string.h>

#include "answers.h"
#include "camera.h"
#include "modules.h"
#include "nodes_xml.h"

static const char *const NAMES[MODULES] = {"TLPort", "InterfacePort", "DevicePort", "Device",
                                           "StreamPort"};
static const char *const FILES[MODULES] = {"sgp_system", "sgp_interface", "sgp_local_device",
                                           "sgp_camera", "sgp_stream"};
#define MOST_TEXTS 5

/* Texts in the node map of a module of the transport layer. */
static size_t texts(enum module module, struct text_node nodes[MOST_TEXTS])
{
    const struct text_node all[MODULES][MOST_TEXTS] = {
        [SYSTEM] = {{"TLID", "sgp virtual camera"}, {"TLVendorName", VENDOR},
                    {"TLModelName", MODEL}, {"TLType", LAYER}, {"TLVersion", "1.0"}},
        [INTERFACE] = {{"InterfaceID", INTERFACE_ID}, {"InterfaceType", LAYER}},
        [DEVICE] = {{"DeviceID", camera_serial()}, {"DeviceVendorName", VENDOR},
                    {"DeviceModelName", MODEL}, {"DeviceSerialNumber", camera_serial()},
                    {"DeviceType", LAYER}},
        [STREAM] = {{"StreamID", STREAM_ID}, {"StreamType", LAYER}},
    };
    memcpy(nodes, all[module], sizeof all[module]);
    size_t count = 0;
    while (count < MOST_TEXTS && nodes[count].name)
        count++;
    return count;
}

/* The node map of a module; `room` is memory for a node map that is written on request. */
static const char *node_map(enum module module, char room[TEXT_NODES_XML])
{
    if (module == REMOTE)
        return nodes_xml();
    struct text_node nodes[MOST_TEXTS];
    const size_t count = texts(module, nodes);
    text_nodes_write_xml(room, FILES[module], NAMES[module], nodes, count);
    return room;
}

static GC_ERROR read_texts(enum module module, uint64_t address, void *to, size_t size)
{
    char room[TEXT_NODES_XML];
    if (xml_read(node_map(module, room), address, to, size))
        return GC_ERR_SUCCESS;
    struct text_node nodes[MOST_TEXTS];
    const uint64_t count = texts(module, nodes), offset = address - TEXT_NODE_ADDRESS;
    if (address < TEXT_NODE_ADDRESS || offset / TEXT_NODE_SIZE >= count ||
        offset % TEXT_NODE_SIZE || size > TEXT_NODE_SIZE)
        return fail(GC_ERR_INVALID_ADDRESS, "no register at 0x%llx", (unsigned long long)address);
    strncpy(to, nodes[offset / TEXT_NODE_SIZE].text, size);
    return GC_ERR_SUCCESS;
}

static GC_ERROR check_port(HANDLE port, const void *data, const size_t *size)
{
    const GC_ERROR result = check_initialised();
    if (result)
        return result;
    if (module_of(port) == MODULES)
        return fail(GC_ERR_INVALID_HANDLE, "the handle is not that of an open port");
    return data && size ? GC_ERR_SUCCESS
                        : fail(GC_ERR_INVALID_PARAMETER, "the pointer to data or size is NULL");
}

GC_API GC_ERROR GCReadPort(HANDLE port, uint64_t address, void *data, size_t *size)
{
    const GC_ERROR result = check_port(port, data, size);
    if (result)
        return result;
    const enum module module = module_of(port);
    return module == REMOTE ? camera_read(address, data, *size)
                            : read_texts(module, address, data, *size);
}

GC_API GC_ERROR GCWritePort(HANDLE port, uint64_t address, const void *data, size_t *size)
{
    const GC_ERROR result = check_port(port, data, size);
    if (result)
        return result;
    if (module_of(port) != REMOTE)
        return fail(GC_ERR_ACCESS_DENIED, "this port is read-only");
    return camera_write(address, data, *size);
}

GC_API GC_ERROR GCReadPortStacked(HANDLE port, PORT_REGISTER_STACK_ENTRY *entries, size_t *count)
{
    GC_ERROR result = check_port(port, entries, count);
    size_t done = 0;
    for (; !result && done < *count; done++)
        result = GCReadPort(port, entries[done].address, entries[done].buffer,
                            &(size_t){entries[done].size});
    if (count)
        *count = result ? done - (done > 0) : done;
    return result;
}

GC_API GC_ERROR GCWritePortStacked(HANDLE port, PORT_REGISTER_STACK_ENTRY *entries, size_t *count)
{
    GC_ERROR result = check_port(port, entries, count);
    size_t done = 0;
    for (; !result && done < *count; done++)
        result = GCWritePort(port, entries[done].address, entries[done].buffer,
                             &(size_t){entries[done].size});
    if (count)
        *count = result ? done - (done > 0) : done;
    return result;
}

GC_API GC_ERROR GCGetPortInfo(HANDLE port, int32_t what, INFO_DATATYPE *type, void *buffer,
                              size_t *size)
{
    static const char *const KINDS[MODULES] = {"TLSystem", "TLInterface", "TLDevice", "Device",
                                               "TLDataStream"};
    const enum module module = module_of(port);
    if (module == MODULES)
        return fail(GC_ERR_INVALID_HANDLE, "the handle is not that of an open port");
    switch (what) {
    case PORT_INFO_ID: return answer_text(ANSWER, FILES[module]);
    case PORT_INFO_VENDOR: return answer_text(ANSWER, VENDOR);
    case PORT_INFO_MODEL: return answer_text(ANSWER, MODEL);
    case PORT_INFO_TLTYPE: return answer_text(ANSWER, LAYER);
    case PORT_INFO_MODULE: return answer_text(ANSWER, KINDS[module]);
    case PORT_INFO_LITTLE_ENDIAN:
    case PORT_INFO_ACCESS_READ: return answer_bool(ANSWER, 1);
    case PORT_INFO_ACCESS_WRITE: return answer_bool(ANSWER, module == REMOTE);
    case PORT_INFO_BIG_ENDIAN:
    case PORT_INFO_ACCESS_NA:
    case PORT_INFO_ACCESS_NI: return answer_bool(ANSWER, 0);
    case PORT_INFO_VERSION: return answer_text(ANSWER, "1.0");
    case PORT_INFO_PORTNAME: return answer_text(ANSWER, NAMES[module]);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no port info %d", (int)what);
    }
}

GC_API GC_ERROR GCGetNumPortURLs(HANDLE port, uint32_t *count)
{
    const GC_ERROR result = check_port(port, count, &(size_t){0});
    return result ? result : answer_count(count, 1);
}

static GC_ERROR url_info(enum module module, int32_t what, struct answer to)
{
    char text[128], room[TEXT_NODES_XML];
    const size_t length = strlen(node_map(module, room));
    switch (what) {
    case URL_INFO_URL:
        snprintf(text, sizeof text, "Local:///%s.xml;%X;%zX?SchemaVersion=1.1.0", FILES[module],
                 NODE_XML_ADDRESS, length);
        return answer_text(to, text);
    case URL_INFO_SCHEMA_VER_MAJOR:
    case URL_INFO_SCHEMA_VER_MINOR:
    case URL_INFO_FILE_VER_MAJOR: return answer_i32(to, 1);
    case URL_INFO_FILE_VER_MINOR:
    case URL_INFO_FILE_VER_SUBMINOR:
    case URL_INFO_SCHEME: return answer_i32(to, 0);
    case URL_INFO_FILE_REGISTER_ADDRESS: return answer_u64(to, NODE_XML_ADDRESS);
    case URL_INFO_FILE_SIZE: return answer_u64(to, length);
    case URL_INFO_FILENAME:
        snprintf(text, sizeof text, "%s.xml", FILES[module]);
        return answer_text(to, text);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no URL info %d", (int)what);
    }
}

GC_API GC_ERROR GCGetPortURLInfo(HANDLE port, uint32_t index, int32_t what, INFO_DATATYPE *type,
                                 void *buffer, size_t *size)
{
    const GC_ERROR result = check_port(port, size, size);
    if (result)
        return result;
    if (index != 0)
        return fail(GC_ERR_INVALID_INDEX, "there is only one URL");
    return url_info(module_of(port), what, ANSWER);
}

GC_API GC_ERROR GCGetPortURL(HANDLE port, char *url, size_t *size)
{
    const GC_ERROR result = check_port(port, size, size);
    return result ? result
                  : url_info(module_of(port), URL_INFO_URL, (struct answer){NULL, url, size});
}
