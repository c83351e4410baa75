/* Which modules of the transport layer are open, and whose handle is whose. */
#ifndef MODULES_H
#define MODULES_H

#include <stdbool.h>

#include "gentl.h"

/* A module closes with the one before it, all but the stream, which closes alone. */
enum module { SYSTEM, INTERFACE, DEVICE, REMOTE, STREAM, MODULES };

#define VENDOR "sgp"
#define MODEL "virtual camera"
#define LAYER "Custom"
#define INTERFACE_ID "interface0"
#define STREAM_ID "stream0"

GC_ERROR initialise(void);
GC_ERROR finalise(void);
GC_ERROR check_initialised(void);
GC_ERROR check_module(HANDLE handle, enum module module);
/* The open module of a handle, MODULES where there is none. */
enum module module_of(HANDLE handle);
GC_ERROR module_handle(enum module module, HANDLE *handle);
bool module_is_open(enum module module);
GC_ERROR module_open(enum module module, HANDLE *handle);
void module_close(enum module module);

/* Return from the function where a handle is not of the open module. */
#define CHECK(handle, module)                                                                    \
    do {                                                                                         \
        const GC_ERROR checked = check_module(handle, module);                                   \
        if (checked != GC_ERR_SUCCESS)                                                           \
            return checked;                                                                      \
    } while (0)

/* The last three arguments of every question. */
#define ANSWER (struct answer){type, buffer, size}

#endif
