/* Table of the nodes, for registers and node map. */
#ifndef NODES_TABLE_H
#define NODES_TABLE_H

#include <stdbool.h>

#include "nodes.h"

enum kind { KIND_INTEGER, KIND_FLOAT, KIND_ENUM, KIND_BOOLEAN, KIND_COMMAND, KIND_TEXT };

struct node_entry {
    const char *name;
    enum kind kind;
    bool writable;
    bool locked; /* while TLParamsLocked is 1 */
    double initial, min, max;
    const char *unit;
    enum node max_node;   /* node with the maximum, or 0 */
    const char *names[3]; /* entries of an enumeration, from value 0 */
    int entries;
};

extern const struct node_entry NODE_TABLE[NODES];

#endif
