/* The entry points of data stream and events. */
#include "answers.h"
#include "camera.h"
#include "modules.h"
#include "stream.h"

GC_API GC_ERROR DSClose(HANDLE stream)
{
    CHECK(stream, STREAM);
    module_close(STREAM);
    return GC_ERR_SUCCESS;
}

GC_API GC_ERROR DSGetInfo(HANDLE stream, int32_t what, INFO_DATATYPE *type, void *buffer,
                          size_t *size)
{
    CHECK(stream, STREAM);
    return stream_info(what, camera_payload(), ANSWER);
}

GC_API GC_ERROR DSGetParentDev(HANDLE stream, HANDLE *device)
{
    CHECK(stream, STREAM);
    return module_handle(DEVICE, device);
}

GC_API GC_ERROR DSAnnounceBuffer(HANDLE stream, void *memory, size_t size, void *user,
                                 HANDLE *buffer)
{
    CHECK(stream, STREAM);
    if (!memory)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the buffer's memory is NULL");
    return stream_announce(memory, size, user, buffer);
}

GC_API GC_ERROR DSAllocAndAnnounceBuffer(HANDLE stream, size_t size, void *user, HANDLE *buffer)
{
    CHECK(stream, STREAM);
    return stream_announce(NULL, size, user, buffer);
}

GC_API GC_ERROR DSRevokeBuffer(HANDLE stream, HANDLE buffer, void **memory, void **user)
{
    CHECK(stream, STREAM);
    return stream_revoke(buffer, memory, user);
}

GC_API GC_ERROR DSQueueBuffer(HANDLE stream, HANDLE buffer)
{
    CHECK(stream, STREAM);
    return stream_queue(buffer);
}

GC_API GC_ERROR DSFlushQueue(HANDLE stream, int32_t what)
{
    CHECK(stream, STREAM);
    return stream_flush(what);
}

GC_API GC_ERROR DSStartAcquisition(HANDLE stream, int32_t flags, uint64_t frames)
{
    (void)flags;
    CHECK(stream, STREAM);
    return stream_start(frames);
}

GC_API GC_ERROR DSStopAcquisition(HANDLE stream, int32_t flags)
{
    (void)flags;
    CHECK(stream, STREAM);
    return stream_stop();
}

GC_API GC_ERROR DSGetBufferID(HANDLE stream, uint32_t index, HANDLE *buffer)
{
    CHECK(stream, STREAM);
    if (!buffer)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the handle is NULL");
    return stream_buffer_id(index, buffer);
}

GC_API GC_ERROR DSGetBufferInfo(HANDLE stream, HANDLE of, int32_t what, INFO_DATATYPE *type,
                                void *buffer, size_t *size)
{
    CHECK(stream, STREAM);
    return stream_buffer_info(of, what, ANSWER);
}

GC_API GC_ERROR DSGetNumBufferParts(HANDLE stream, HANDLE buffer, uint32_t *count)
{
    (void)buffer;
    CHECK(stream, STREAM);
    return answer_count(count, 0);
}

GC_API GC_ERROR GCRegisterEvent(HANDLE source, int32_t which, HANDLE *event)
{
    if (!event)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the handle is NULL");
    if (module_of(source) == MODULES)
        return fail(GC_ERR_INVALID_HANDLE, "the handle is not that of an open module");
    if (module_of(source) != STREAM || which != EVENT_NEW_BUFFER)
        return fail(GC_ERR_NOT_IMPLEMENTED, "only the event for new buffers is implemented");
    return stream_event_register(event);
}

GC_API GC_ERROR GCUnregisterEvent(HANDLE source, int32_t which)
{
    CHECK(source, STREAM);
    if (which != EVENT_NEW_BUFFER)
        return fail(GC_ERR_NOT_IMPLEMENTED, "only the event for new buffers is implemented");
    return stream_event_unregister();
}

GC_API GC_ERROR EventGetData(HANDLE event, void *data, size_t *size, uint64_t timeout_ms)
{
    return stream_event_get(event, data, size, timeout_ms);
}

GC_API GC_ERROR EventGetDataInfo(HANDLE event, const void *data, size_t data_size, int32_t what,
                                 INFO_DATATYPE *type, void *buffer, size_t *size)
{
    (void)event;
    if (!data || data_size < sizeof(EVENT_NEW_BUFFER_DATA))
        return fail(GC_ERR_INVALID_PARAMETER, "the data of the event is too short");
    const EVENT_NEW_BUFFER_DATA *filled = data;
    switch (what) {
    case EVENT_DATA_ID: return answer_pointer(ANSWER, filled->buffer);
    case EVENT_DATA_VALUE: return answer_pointer(ANSWER, filled->user_pointer);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no event data info %d", (int)what);
    }
}

GC_API GC_ERROR EventGetInfo(HANDLE event, int32_t what, INFO_DATATYPE *type, void *buffer,
                             size_t *size)
{
    return stream_event_info(event, what, ANSWER);
}

GC_API GC_ERROR EventFlush(HANDLE event) { return stream_event_flush(event); }
GC_API GC_ERROR EventKill(HANDLE event) { return stream_event_kill(event); }

/* Functions that clients look up by name and that this producer does not implement. */
#define ABSENT(name)                                                                             \
    GC_API GC_ERROR name(void)                                                                   \
    {                                                                                            \
        return fail(GC_ERR_NOT_IMPLEMENTED, #name " is not implemented");                       \
    }

ABSENT(DSGetBufferChunkData)
ABSENT(DSGetBufferPartInfo)
ABSENT(DSAnnounceCompositeBuffer)
ABSENT(DSGetBufferInfoStacked)
ABSENT(DSGetBufferPartInfoStacked)
ABSENT(DSGetNumFlows)
ABSENT(DSGetFlowInfo)
ABSENT(DSGetNumBufferSegments)
ABSENT(DSGetBufferSegmentInfo)
