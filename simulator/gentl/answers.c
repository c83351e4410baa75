#include "answers.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static _Thread_local GC_ERROR last_code;
static _Thread_local char last_text[512] = "no error";

GC_ERROR fail(GC_ERROR code, const char *format, ...)
{
    va_list values;
    va_start(values, format);
    vsnprintf(last_text, sizeof last_text, format, values);
    va_end(values);
    last_code = code;
    return code;
}

GC_ERROR last_error(GC_ERROR *code, char *text, size_t *size)
{
    if (!code || !size)
        return GC_ERR_INVALID_PARAMETER;
    *code = last_code;
    return answer_text((struct answer){NULL, text, size}, last_text);
}

GC_ERROR answer_bytes(struct answer to, INFO_DATATYPE type, const void *value, size_t size)
{
    if (!to.size)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the size of the answer is NULL");
    if (to.type)
        *to.type = type;
    if (to.buffer) {
        if (*to.size < size)
            return fail(GC_ERR_BUFFER_TOO_SMALL, "the answer requires %zu bytes, not %zu", size,
                        *to.size);
        memcpy(to.buffer, value, size);
    }
    *to.size = size;
    return GC_ERR_SUCCESS;
}

GC_ERROR answer_text(struct answer to, const char *text)
{
    return answer_bytes(to, INFO_DATATYPE_STRING, text, strlen(text) + 1);
}

GC_ERROR answer_bool(struct answer to, int value)
{
    const bool8_t byte = value != 0;
    return answer_bytes(to, INFO_DATATYPE_BOOL8, &byte, sizeof byte);
}

GC_ERROR answer_i32(struct answer to, int32_t value)
{
    return answer_bytes(to, INFO_DATATYPE_INT32, &value, sizeof value);
}

GC_ERROR answer_u32(struct answer to, uint32_t value)
{
    return answer_bytes(to, INFO_DATATYPE_UINT32, &value, sizeof value);
}

GC_ERROR answer_u64(struct answer to, uint64_t value)
{
    return answer_bytes(to, INFO_DATATYPE_UINT64, &value, sizeof value);
}

GC_ERROR answer_size(struct answer to, size_t value)
{
    return answer_bytes(to, INFO_DATATYPE_SIZET, &value, sizeof value);
}

GC_ERROR answer_pointer(struct answer to, void *value)
{
    return answer_bytes(to, INFO_DATATYPE_PTR, &value, sizeof value);
}

GC_ERROR answer_count(uint32_t *to, uint32_t count)
{
    if (!to)
        return fail(GC_ERR_INVALID_PARAMETER, "the pointer to the count is NULL");
    *to = count;
    return GC_ERR_SUCCESS;
}
