/* Internals that the files of the data stream share. */
#ifndef STREAM_PARTS_H
#define STREAM_PARTS_H

#include "stream.h"

enum place { UNQUEUED, INPUT, FILLING, OUTPUT };

struct buffer {
    uint8_t *memory;
    size_t size;
    void *user;
    bool ours; /* allocated by this library */
    bool new_data;
    enum place place;
    uint64_t since; /* order within its place */
    struct frame_info frame;
};

void stream_lock(void);
void stream_unlock(void);

/* With the lock held: */
/* Wait for a change, or until a time at the latest unless it is 0. */
void stream_wait(int64_t until_ns);
/* Wake all waiting threads. */
void stream_wake(void);
struct buffer *stream_oldest(enum place place);
size_t stream_count(enum place place);
void stream_move(struct buffer *buffer, enum place to);
uint64_t stream_delivered(void);
GC_ERROR buffer_info(const struct buffer *buffer, int what, struct answer to);

#endif
