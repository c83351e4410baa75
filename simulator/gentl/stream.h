/* The data stream: the client's buffers and the event that reports each filled buffer. */
#ifndef STREAM_H
#define STREAM_H

#include <stdbool.h>

#include "answers.h"
#include "pixels.h"

struct buffer;

/* Properties of a frame, for the buffer's info. */
struct frame_info {
    uint64_t block;
    int64_t start_ns;
    uint32_t width, height, x, y;
    uint32_t format;
    size_t size;        /* of a complete frame */
    size_t size_filled; /* less if the frame is incomplete */
};

/* `most_buffers` is the maximum number of announced buffers; 0: limit of this library. */
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

/* For the camera: whether there is a buffer for a frame now. Counts an underrun if there is no
 * buffer, or if `underrun` is true. */
bool stream_awaits(bool underrun);
/* Memory for the next frame; NULL if no buffer is queued or the oldest one is too small. Only the
 * camera may use it until stream_deliver. */
struct buffer *stream_take(size_t size, uint8_t **memory);
void stream_deliver(struct buffer *buffer, const struct frame_info *frame);

#endif
