/* Answers to queries of the client, and reasons of errors. */
#ifndef ANSWERS_H
#define ANSWERS_H

#include "gentl.h"

/* Destination of an answer: the last three arguments of all queries of GenTL. */
struct answer {
    INFO_DATATYPE *type;
    void *buffer; /* NULL: only the size is requested */
    size_t *size;
};

GC_ERROR answer_bytes(struct answer to, INFO_DATATYPE type, const void *value, size_t size);
GC_ERROR answer_text(struct answer to, const char *text);
GC_ERROR answer_bool(struct answer to, int value);
GC_ERROR answer_i32(struct answer to, int32_t value);
GC_ERROR answer_u32(struct answer to, uint32_t value);
GC_ERROR answer_u64(struct answer to, uint64_t value);
GC_ERROR answer_size(struct answer to, size_t value);
GC_ERROR answer_pointer(struct answer to, void *value);
/* Answer a query for a number of items. */
GC_ERROR answer_count(uint32_t *to, uint32_t count);

/* Store the reason of an error for GCGetLastError, and return its code. */
__attribute__((format(printf, 2, 3))) GC_ERROR fail(GC_ERROR code, const char *format, ...);
GC_ERROR last_error(GC_ERROR *code, char *text, size_t *size);

#endif
