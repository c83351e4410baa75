#include <string.h>

#include "clock.h"
#include "stream_parts.h"

static bool registered, killed;
static char handle; /* its address is the handle */

GC_ERROR stream_event_register(HANDLE *event)
{
    stream_lock();
    const bool was = registered;
    registered = true;
    killed &= was;
    stream_unlock();
    *event = &handle;
    return was ? fail(GC_ERR_RESOURCE_IN_USE, "the event for new buffers is already registered")
               : GC_ERR_SUCCESS;
}

GC_ERROR stream_event_unregister(void)
{
    stream_lock();
    const bool was = registered;
    registered = false;
    stream_wake();
    stream_unlock();
    return was ? GC_ERR_SUCCESS
               : fail(GC_ERR_INVALID_HANDLE, "the event for new buffers is not registered");
}

/* With the lock held. */
static GC_ERROR check_event(HANDLE event)
{
    return event == &handle && registered ? GC_ERR_SUCCESS
                                          : fail(GC_ERR_INVALID_HANDLE,
                                                 "the handle is not that of a registered event");
}

GC_ERROR stream_event_get(HANDLE event, void *data, size_t *size, uint64_t timeout_ms)
{
    EVENT_NEW_BUFFER_DATA filled = {NULL, NULL};
    if (!size || !data || *size < sizeof filled)
        return fail(GC_ERR_BUFFER_TOO_SMALL, "the event requires %zu bytes", sizeof filled);
    const bool forever = timeout_ms > INT64_MAX / 2000000;
    const int64_t until = forever ? 0 : now_ns() + (int64_t)timeout_ms * 1000000;
    stream_lock();
    GC_ERROR result;
    while (!(result = check_event(event)) && !killed && !(filled.buffer = stream_oldest(OUTPUT))) {
        if (!forever && now_ns() >= until)
            break;
        stream_wait(until);
    }
    if (!result && killed) {
        result = fail(GC_ERR_ABORT, "EventKill ended the wait");
        killed = false;
    } else if (!result && !filled.buffer) {
        result = fail(GC_ERR_TIMEOUT, "no buffer within %llu ms", (unsigned long long)timeout_ms);
    }
    if (!result) {
        filled.user_pointer = ((struct buffer *)filled.buffer)->user;
        stream_move(filled.buffer, UNQUEUED);
        memcpy(data, &filled, sizeof filled);
        *size = sizeof filled;
    }
    stream_unlock();
    return result;
}

GC_ERROR stream_event_info(HANDLE event, int what, struct answer to)
{
    stream_lock();
    const GC_ERROR result = check_event(event);
    const size_t waiting = stream_count(OUTPUT);
    const uint64_t fired = stream_delivered();
    stream_unlock();
    if (result)
        return result;
    switch (what) {
    case EVENT_EVENT_TYPE: return answer_i32(to, EVENT_NEW_BUFFER);
    case EVENT_NUM_IN_QUEUE: return answer_size(to, waiting);
    case EVENT_NUM_FIRED: return answer_u64(to, fired);
    case EVENT_SIZE_MAX:
    case EVENT_INFO_DATA_SIZE_MAX: return answer_size(to, sizeof(EVENT_NEW_BUFFER_DATA));
    default: return fail(GC_ERR_NOT_AVAILABLE, "no event info %d", what);
    }
}

GC_ERROR stream_event_flush(HANDLE event)
{
    stream_lock();
    const GC_ERROR result = check_event(event);
    stream_unlock();
    return result ? result : stream_flush(ACQ_QUEUE_OUTPUT_DISCARD);
}

GC_ERROR stream_event_kill(HANDLE event)
{
    stream_lock();
    const GC_ERROR result = check_event(event);
    if (!result) {
        killed = true;
        stream_wake();
    }
    stream_unlock();
    return result;
}
