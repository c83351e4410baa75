/* Node maps as XML: of the camera and of the modules of the transport layer. */
#ifndef NODES_XML_H
#define NODES_XML_H

#include <stdbool.h>

#include "control.h"

#define NODE_XML_ADDRESS 0x100000u

/* The camera's node map, as written by nodes_write_xml. */
const char *nodes_xml(void);
/* Write the camera's node map. The nodes must have been reset. */
void nodes_write_xml(const struct control *camera);

/* A node of a node map that has only texts. */
struct text_node {
    const char *name;
    const char *text;
};
#define TEXT_NODE_ADDRESS 0x1000u
#define TEXT_NODE_SIZE 256u
#define TEXT_NODES_XML 8192
void text_nodes_write_xml(char xml[TEXT_NODES_XML], const char *model, const char *port,
                          const struct text_node *nodes, size_t count);

/* Copy a part of a node map by its address; returns false if it is not within the node map. */
bool xml_read(const char *xml, uint64_t address, void *to, size_t size);

#endif
