#include <stdlib.h>
#include <string.h>

#include "clock.h"
#include "stream_parts.h"

#define BUFFERS 256

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed;
static pthread_once_t once = PTHREAD_ONCE_INIT;

static struct buffer *buffers[BUFFERS];
static uint32_t announced, most;
static bool grabbing;
static uint64_t wanted, moves, delivered, underruns;

static void init(void) { condition_init(&changed); }
void stream_lock(void) { pthread_mutex_lock(&lock); }
void stream_unlock(void) { pthread_mutex_unlock(&lock); }
void stream_wake(void) { pthread_cond_broadcast(&changed); }
uint64_t stream_delivered(void) { return delivered; }

void stream_wait(int64_t until_ns)
{
    if (until_ns)
        wait_until(&changed, &lock, until_ns);
    else
        pthread_cond_wait(&changed, &lock);
}

void stream_move(struct buffer *buffer, enum place to)
{
    buffer->place = to;
    buffer->since = ++moves;
}

struct buffer *stream_oldest(enum place place)
{
    struct buffer *oldest = NULL;
    for (uint32_t i = 0; i < announced; i++)
        if (buffers[i]->place == place && (!oldest || buffers[i]->since < oldest->since))
            oldest = buffers[i];
    return oldest;
}

size_t stream_count(enum place place)
{
    size_t n = 0;
    for (uint32_t i = 0; i < announced; i++)
        n += buffers[i]->place == place;
    return n;
}

static void move_all(enum place from, enum place to)
{
    for (struct buffer *b; from != to && (b = stream_oldest(from));)
        stream_move(b, to);
}

/* Index of a buffer in the table; -1 if the handle is not that of a buffer. */
static int find(HANDLE handle)
{
    for (uint32_t i = 0; i < announced; i++)
        if (buffers[i] == handle)
            return (int)i;
    fail(GC_ERR_INVALID_HANDLE, "the handle is not that of a buffer");
    return -1;
}

static void let_filling_end(void)
{
    while (stream_count(FILLING))
        pthread_cond_wait(&changed, &lock);
}

static void forget(uint32_t index)
{
    if (buffers[index]->ours)
        free(buffers[index]->memory);
    free(buffers[index]);
    memmove(&buffers[index], &buffers[index + 1], (--announced - index) * sizeof *buffers);
}

void stream_open(uint32_t most_buffers)
{
    pthread_once(&once, init);
    stream_lock();
    most = most_buffers && most_buffers < BUFFERS ? most_buffers : BUFFERS;
    delivered = underruns = 0;
    grabbing = false;
    stream_unlock();
}

void stream_close(void)
{
    stream_lock();
    grabbing = false;
    let_filling_end();
    while (announced)
        forget(announced - 1);
    stream_unlock();
}

GC_ERROR stream_start(uint64_t frames)
{
    GC_ERROR result = GC_ERR_SUCCESS;
    stream_lock();
    if (grabbing)
        result = fail(GC_ERR_RESOURCE_IN_USE, "the stream is already started");
    else
        wanted = frames;
    grabbing = true;
    stream_unlock();
    return result;
}

GC_ERROR stream_stop(void)
{
    stream_lock();
    const bool was = grabbing;
    grabbing = false;
    let_filling_end();
    stream_unlock();
    return was ? GC_ERR_SUCCESS : fail(GC_ERR_RESOURCE_IN_USE, "the stream is not started");
}

GC_ERROR stream_info(int what, size_t payload, struct answer to)
{
    stream_lock();
    const size_t queued = stream_count(INPUT), waiting = stream_count(OUTPUT), all = announced;
    const uint64_t done = delivered, lost = underruns;
    const bool grabs = grabbing;
    stream_unlock();
    switch (what) {
    case STREAM_INFO_ID: return answer_text(to, "stream0");
    case STREAM_INFO_NUM_STARTED:
    case STREAM_INFO_NUM_DELIVERED: return answer_u64(to, done);
    case STREAM_INFO_NUM_UNDERRUN: return answer_u64(to, lost);
    case STREAM_INFO_NUM_ANNOUNCED: return answer_size(to, all);
    case STREAM_INFO_NUM_QUEUED: return answer_size(to, queued);
    case STREAM_INFO_NUM_AWAIT_DELIVERY: return answer_size(to, waiting);
    case STREAM_INFO_PAYLOAD_SIZE: return answer_size(to, payload);
    case STREAM_INFO_IS_GRABBING: return answer_bool(to, grabs);
    case STREAM_INFO_DEFINES_PAYLOADSIZE: return answer_bool(to, 0);
    case STREAM_INFO_TLTYPE: return answer_text(to, "Custom");
    case STREAM_INFO_NUM_CHUNKS_MAX: return answer_size(to, 0);
    case STREAM_INFO_BUF_ANNOUNCE_MIN: return answer_size(to, 1);
    case STREAM_INFO_BUF_ALIGNMENT: return answer_size(to, 1);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no stream info %d", what);
    }
}

GC_ERROR stream_announce(void *memory, size_t size, void *user, HANDLE *handle)
{
    if (!handle || !size)
        return fail(GC_ERR_INVALID_PARAMETER,
                    "the size of the buffer is 0 or the pointer to its handle is NULL");
    struct buffer *buffer = calloc(1, sizeof *buffer);
    uint8_t *own = buffer && !memory ? calloc(1, size) : NULL;
    if (!buffer || (!memory && !own)) {
        free(buffer);
        return fail(GC_ERR_OUT_OF_MEMORY, "not enough memory for a buffer of %zu bytes", size);
    }
    *buffer = (struct buffer){.memory = memory ? memory : own, .size = size, .user = user,
                              .ours = !memory};
    stream_lock();
    const uint32_t limit = most;
    const bool room = announced < limit;
    if (room)
        buffers[announced++] = buffer;
    stream_unlock();
    if (!room) {
        free(own);
        free(buffer);
        return fail(GC_ERR_RESOURCE_EXHAUSTED, "at most %u buffers can be announced", limit);
    }
    *handle = buffer;
    return GC_ERR_SUCCESS;
}

GC_ERROR stream_revoke(HANDLE handle, void **memory, void **user)
{
    stream_lock();
    let_filling_end();
    const int index = find(handle);
    if (index >= 0) {
        if (memory)
            *memory = buffers[index]->ours ? NULL : buffers[index]->memory;
        if (user)
            *user = buffers[index]->user;
        forget((uint32_t)index);
    }
    stream_unlock();
    return index >= 0 ? GC_ERR_SUCCESS : GC_ERR_INVALID_HANDLE;
}

GC_ERROR stream_queue(HANDLE handle)
{
    GC_ERROR result = GC_ERR_SUCCESS;
    stream_lock();
    const int index = find(handle);
    if (index < 0)
        result = GC_ERR_INVALID_HANDLE;
    else if (buffers[index]->place != UNQUEUED)
        result = fail(GC_ERR_RESOURCE_IN_USE, "the buffer is already queued");
    else
        stream_move(buffers[index], INPUT);
    stream_unlock();
    return result;
}

GC_ERROR stream_flush(int what)
{
    GC_ERROR result = GC_ERR_SUCCESS;
    stream_lock();
    let_filling_end();
    switch (what) {
    case ACQ_QUEUE_INPUT_TO_OUTPUT:
        for (uint32_t i = 0; i < announced; i++)
            buffers[i]->new_data &= buffers[i]->place != INPUT;
        move_all(INPUT, OUTPUT);
        stream_wake();
        break;
    case ACQ_QUEUE_OUTPUT_DISCARD: move_all(OUTPUT, UNQUEUED); break;
    case ACQ_QUEUE_ALL_TO_INPUT: move_all(OUTPUT, INPUT); /* fall through */
    case ACQ_QUEUE_UNQUEUED_TO_INPUT: move_all(UNQUEUED, INPUT); break;
    case ACQ_QUEUE_ALL_DISCARD:
        move_all(INPUT, UNQUEUED);
        move_all(OUTPUT, UNQUEUED);
        break;
    default: result = fail(GC_ERR_INVALID_PARAMETER, "unknown flush operation %d", what);
    }
    stream_unlock();
    return result;
}

GC_ERROR stream_buffer_id(uint32_t index, HANDLE *handle)
{
    stream_lock();
    const bool there = index < announced;
    if (there)
        *handle = buffers[index];
    stream_unlock();
    return there ? GC_ERR_SUCCESS : fail(GC_ERR_INVALID_INDEX, "no buffer %u", index);
}

GC_ERROR stream_buffer_info(HANDLE handle, int what, struct answer to)
{
    stream_lock();
    const int index = find(handle);
    const GC_ERROR result = index < 0 ? GC_ERR_INVALID_HANDLE : buffer_info(buffers[index], what, to);
    stream_unlock();
    return result;
}

/* Buffer for the next frame, or NULL if the client requests no frame. Counts an underrun if no
 * buffer is free. */
static struct buffer *next_buffer(bool underrun)
{
    if (!grabbing || !wanted)
        return NULL;
    struct buffer *buffer = underrun ? NULL : stream_oldest(INPUT);
    underruns += !buffer;
    return buffer;
}

bool stream_awaits(bool underrun)
{
    stream_lock();
    const bool awaits = next_buffer(underrun) != NULL;
    stream_unlock();
    return awaits;
}

struct buffer *stream_take(size_t size, uint8_t **memory)
{
    stream_lock();
    struct buffer *buffer = next_buffer(false);
    if (buffer && buffer->size < size)
        buffer = NULL;
    if (buffer) {
        stream_move(buffer, FILLING);
        *memory = buffer->memory;
        wanted -= wanted != UINT64_MAX;
    }
    stream_unlock();
    return buffer;
}

void stream_deliver(struct buffer *buffer, const struct frame_info *frame)
{
    stream_lock();
    buffer->frame = *frame;
    buffer->new_data = true;
    delivered++;
    stream_move(buffer, OUTPUT);
    stream_wake();
    stream_unlock();
}
