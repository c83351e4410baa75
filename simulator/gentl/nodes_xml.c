#include "nodes_xml.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "nodes_table.h"

static char device_xml[65536];

struct text {
    char *at;
    size_t left;
};

__attribute__((format(printf, 2, 3))) static void put(struct text *to, const char *format, ...)
{
    va_list values;
    va_start(values, format);
    const int length = vsnprintf(to->at, to->left, format, values);
    va_end(values);
    const size_t wrote = length < 0 ? 0 : (size_t)length;
    to->at += wrote < to->left ? wrote : to->left;
    to->left -= wrote < to->left ? wrote : to->left;
}

static void put_head(struct text *to, const char *model, const char *port)
{
    put(to,
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n"
        "<RegisterDescription ModelName=\"%s\" VendorName=\"sgp\" StandardNameSpace=\"None\" "
        "SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" "
        "MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" "
        "ProductGuid=\"6B1D4A30-0F5C-4E1B-9B62-5A7C00000001\" "
        "VersionGuid=\"6B1D4A30-0F5C-4E1B-9B62-5A7C00000002\" "
        "xmlns=\"http://www.genicam.org/GenApi/Version_1_1\">\n"
        "<Port Name=\"%s\"/>\n<Category Name=\"Root\">\n",
        model, port);
}

static void put_register(struct text *to, const char *kind, const char *name, uint64_t address,
                         unsigned length, const char *access, const char *port)
{
    put(to,
        "<%s Name=\"%s\"><Address>0x%llx</Address><Length>%u</Length><AccessMode>%s</AccessMode>"
        "<pPort>%s</pPort><Cachable>NoCache</Cachable>",
        kind, name, (unsigned long long)address, length, access, port);
    if (strcmp(kind, "IntReg") == 0)
        put(to, "<Sign>Signed</Sign>");
    if (strcmp(kind, "StringReg") != 0)
        put(to, "<Endianess>LittleEndian</Endianess>");
    put(to, "</%s>\n", kind);
}

static void put_entries(struct text *to, const struct node_entry *entry, const char *cfa)
{
    if (entry == &NODE_TABLE[PIXEL_FORMAT]) {
        struct pixel_format formats[PIXEL_FORMATS];
        pixel_formats(cfa, formats);
        for (int i = 0; i < PIXEL_FORMATS; i++)
            put(to, "<EnumEntry Name=\"%s\"><Value>%u</Value></EnumEntry>", formats[i].name,
                formats[i].code);
    }
    for (int i = 0; i < entry->entries; i++)
        put(to, "<EnumEntry Name=\"%s\"><Value>%d</Value></EnumEntry>", entry->names[i], i);
}

static void put_node(struct text *to, const struct node_entry *entry, const char *cfa)
{
    static const char *const KINDS[] = {"Integer", "Float", "Enumeration", "Boolean", "Command"};
    const char *kind = KINDS[entry->kind];
    const bool area = entry == &NODE_TABLE[OFFSET_X] || entry == &NODE_TABLE[OFFSET_Y];
    put(to, "<%s Name=\"%s\">", kind, entry->name);
    if (entry->locked)
        put(to, "<pIsLocked>TLParamsLocked</pIsLocked>");
    if (entry->kind == KIND_ENUM)
        put_entries(to, entry, cfa);
    put(to, "<pValue>%sReg</pValue>", entry->name);
    if (entry->kind == KIND_BOOLEAN)
        put(to, "<OnValue>1</OnValue><OffValue>0</OffValue>");
    if (entry->kind == KIND_COMMAND)
        put(to, "<CommandValue>1</CommandValue>");
    if (entry->kind == KIND_INTEGER && entry->writable) {
        put(to, "<Min>%.0f</Min>", entry->min);
        if (entry->max_node)
            put(to, "<pMax>%s</pMax>", NODE_TABLE[entry->max_node].name);
        else
            put(to, "<Max>%.0f</Max>", entry->max);
        put(to, "<Inc>%d</Inc>", area && cfa[0] ? 2 : 1);
    }
    if (entry->kind == KIND_FLOAT) {
        put(to, "<Min>%.10g</Min><Max>%.10g</Max>", entry->min,
            node_maximum((enum node)(entry - NODE_TABLE)));
        if (entry->unit[0])
            put(to, "<Unit>%s</Unit>", entry->unit);
    }
    put(to, "</%s>\n", kind);
}

static bool hidden(const struct control *camera, const char *name)
{
    const size_t length = strlen(name);
    for (const char *at = camera->hidden; (at = strstr(at, name)); at += length)
        if ((at == camera->hidden || at[-1] == ',') && at[length] == ',')
            return true;
    return false;
}

void nodes_write_xml(const struct control *camera)
{
    struct text to = {device_xml, sizeof device_xml};
    put_head(&to, "VirtualCamera", "Device");
    for (int n = 0; n < NODES; n++)
        if (!hidden(camera, NODE_TABLE[n].name))
            put(&to, "<pFeature>%s</pFeature>\n", NODE_TABLE[n].name);
    put(&to, "</Category>\n");
    for (int n = 0; n < NODES; n++) {
        const struct node_entry *entry = &NODE_TABLE[n];
        if (hidden(camera, entry->name))
            continue;
        const uint64_t address = NODE_ADDRESS(n);
        const char *access = !entry->writable ? "RO" : "RW";
        if (entry->kind == KIND_TEXT) {
            put_register(&to, "StringReg", entry->name, address, NODE_STRIDE, "RO", "Device");
            continue;
        }
        char name[64];
        snprintf(name, sizeof name, "%sReg", entry->name);
        put_node(&to, entry, camera->cfa);
        put_register(&to, entry->kind == KIND_FLOAT ? "FloatReg" : "IntReg", name, address, 8,
                     access, "Device");
    }
    put(&to, "</RegisterDescription>\n");
}

const char *nodes_xml(void) { return device_xml; }

void text_nodes_write_xml(char xml[TEXT_NODES_XML], const char *model, const char *port,
                          const struct text_node *nodes, size_t count)
{
    struct text to = {xml, TEXT_NODES_XML};
    put_head(&to, model, port);
    for (size_t n = 0; n < count; n++)
        put(&to, "<pFeature>%s</pFeature>\n", nodes[n].name);
    put(&to, "</Category>\n");
    for (size_t n = 0; n < count; n++)
        put_register(&to, "StringReg", nodes[n].name, TEXT_NODE_ADDRESS + n * TEXT_NODE_SIZE,
                     TEXT_NODE_SIZE, "RO", port);
    put(&to, "</RegisterDescription>\n");
}

bool xml_read(const char *xml, uint64_t address, void *to, size_t size)
{
    const size_t length = strlen(xml);
    const uint64_t from = address - NODE_XML_ADDRESS;
    if (address < NODE_XML_ADDRESS || from > length || size > length - from)
        return false;
    memcpy(to, xml + from, size);
    return true;
}
