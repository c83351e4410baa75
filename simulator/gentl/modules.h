/* Open modules of the transport layer and their handles. */
#ifndef MODULES_H
#define MODULES_H

#include <stdbool.h>

#include "gentl.h"

/* Closing a module closes all modules after it. */
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
/* The open module of a handle, or MODULES. */
enum module module_of(HANDLE handle);
GC_ERROR module_handle(enum module module, HANDLE *handle);
bool module_is_open(enum module module);
GC_ERROR module_open(enum module module, HANDLE *handle);
void module_close(enum module module);

/* Return from the function with an error if a handle does not belong to the open module. */
#define CHECK(handle, module)                                                                    \
    do {                                                                                         \
        const GC_ERROR checked = check_module(handle, module);                                   \
        if (checked != GC_ERR_SUCCESS)                                                           \
            return checked;                                                                      \
    } while (0)

/* The last three arguments of every query. */
#define ANSWER (struct answer){type, buffer, size}

#endif
