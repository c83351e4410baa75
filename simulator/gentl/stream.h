/* The data stream: the client's buffers on their way round, and the event that tells of each. */
#ifndef STREAM_H
#define STREAM_H

#include <stdbool.h>

#include "answers.h"
#include "pixels.h"

struct buffer;

/* What a frame is, as the buffer's info tells it. */
struct frame_info {
    uint64_t block;
    int64_t start_ns;
    uint32_t width, height, x, y;
    uint32_t format;
    size_t size;        /* of a whole frame */
    size_t size_filled; /* less where it is incomplete */
};

/* At most so many buffers may be announced; 0 for as many as there is room for. */
void stream_open(uint32_t most_buffers);
void stream_close(void);
GC_ERROR stream_start(uint64_t frames);
GC_ERROR stream_stop(void);
GC_ERROR stream_info(int what, size_t payload, struct answer to);

GC_ERROR stream_announce(void *memory, size_t size, void *user, HANDLE *buffer);
GC_ERROR stream_revoke(HANDLE buffer, void **memory, void **user);
GC_ERROR stream_queue(HANDLE buffer);
GC_ERROR stream_flush(int what);
GC_ERROR stream_buffer_id(uint32_t index, HANDLE *buffer);
GC_ERROR stream_buffer_info(HANDLE buffer, int what, struct answer to);

GC_ERROR stream_event_register(HANDLE *event);
GC_ERROR stream_event_unregister(void);
GC_ERROR stream_event_get(HANDLE event, void *data, size_t *size, uint64_t timeout_ms);
GC_ERROR stream_event_info(HANDLE event, int what, struct answer to);
GC_ERROR stream_event_flush(HANDLE event);
GC_ERROR stream_event_kill(HANDLE event);

/* The camera's side: whether a frame would find a buffer now; counts an underrun where not, or
 * where it is to be treated so. */
bool stream_awaits(bool underrun);
/* Memory for the next frame, NULL where none is queued or large enough. It is
 * the camera's alone until it is given back filled. */
struct buffer *stream_take(size_t size, uint8_t **memory);
void stream_deliver(struct buffer *buffer, const struct frame_info *frame);

#endif
