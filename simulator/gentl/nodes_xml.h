/* Node maps as texts: the camera's, and those of the modules of the transport layer. */
#ifndef NODES_XML_H
#define NODES_XML_H

#include <stdbool.h>

#include "control.h"

#define NODE_XML_ADDRESS 0x100000u

/* The camera's node map, as last written. */
const char *nodes_xml(void);
/* Write it, after the nodes have been reset. */
void nodes_write_xml(const struct control *camera);

/* A node map of nothing but texts. */
struct text_node {
    const char *name;
    const char *text;
};
#define TEXT_NODE_ADDRESS 0x1000u
#define TEXT_NODE_SIZE 256u
#define TEXT_NODES_XML 8192
void text_nodes_write_xml(char xml[TEXT_NODES_XML], const char *model, const char *port,
                          const struct text_node *nodes, size_t count);

/* Copy a part of a node map's text by its address; false where it does not lie within it. */
bool xml_read(const char *xml, uint64_t address, void *to, size_t size);

#endif
