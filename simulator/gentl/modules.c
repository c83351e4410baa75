#include "modules.h"

#include "answers.h"
#include "camera.h"
#include "stream.h"

static bool initialised;
static bool opened[MODULES];
static char handles[MODULES]; /* their addresses are the handles */

GC_ERROR check_initialised(void)
{
    return initialised ? GC_ERR_SUCCESS
                       : fail(GC_ERR_NOT_INITIALIZED, "GCInitLib has not been called");
}

GC_ERROR initialise(void)
{
    if (initialised)
        return fail(GC_ERR_RESOURCE_IN_USE, "GCInitLib has already been called");
    initialised = true;
    return GC_ERR_SUCCESS;
}

GC_ERROR finalise(void)
{
    const GC_ERROR result = check_initialised();
    module_close(SYSTEM);
    initialised = false;
    return result;
}

enum module module_of(HANDLE handle)
{
    for (int m = 0; m < MODULES; m++)
        if (handle == &handles[m] && opened[m])
            return (enum module)m;
    return MODULES;
}

GC_ERROR check_module(HANDLE handle, enum module module)
{
    const GC_ERROR result = check_initialised();
    if (result)
        return result;
    return module_of(handle) == module
               ? GC_ERR_SUCCESS
               : fail(GC_ERR_INVALID_HANDLE,
                      "the handle is not that of an open module of this kind");
}

GC_ERROR module_handle(enum module module, HANDLE *handle)
{
    if (!handle)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the handle is NULL");
    *handle = &handles[module];
    return GC_ERR_SUCCESS;
}

bool module_is_open(enum module module) { return opened[module]; }

GC_ERROR module_open(enum module module, HANDLE *handle)
{
    GC_ERROR result = check_initialised();
    if (!result && opened[module])
        result = fail(GC_ERR_RESOURCE_IN_USE, "the module is already open");
    if (!result)
        result = module_handle(module, handle);
    if (!result)
        opened[module] = true;
    return result;
}

void module_close(enum module module)
{
    if (opened[STREAM]) {
        stream_event_unregister();
        stream_close();
    }
    if (module <= DEVICE && opened[DEVICE])
        camera_close();
    if (module == SYSTEM)
        camera_forget();
    for (int m = (int)module; m < MODULES; m++)
        opened[m] = false;
}
