#include "stream_parts.h"

GC_ERROR buffer_info(const struct buffer *buffer, int what, struct answer to)
{
    const struct frame_info *frame = &buffer->frame;
    switch (what) {
    case BUFFER_INFO_BASE: return answer_pointer(to, buffer->memory);
    case BUFFER_INFO_SIZE: return answer_size(to, buffer->size);
    case BUFFER_INFO_USER_PTR: return answer_pointer(to, buffer->user);
    case BUFFER_INFO_TIMESTAMP:
    case BUFFER_INFO_TIMESTAMP_NS: return answer_u64(to, (uint64_t)frame->start_ns);
    case BUFFER_INFO_NEW_DATA: return answer_bool(to, buffer->new_data);
    case BUFFER_INFO_IS_QUEUED: return answer_bool(to, buffer->place == INPUT);
    case BUFFER_INFO_IS_ACQUIRING: return answer_bool(to, buffer->place == FILLING);
    case BUFFER_INFO_IS_INCOMPLETE: return answer_bool(to, frame->size_filled < frame->size);
    case BUFFER_INFO_TLTYPE: return answer_text(to, "Custom");
    case BUFFER_INFO_SIZE_FILLED: return answer_size(to, frame->size_filled);
    case BUFFER_INFO_DATA_SIZE: return answer_size(to, frame->size);
    case BUFFER_INFO_WIDTH: return answer_size(to, frame->width);
    case BUFFER_INFO_DELIVERED_IMAGEHEIGHT:
    case BUFFER_INFO_HEIGHT: return answer_size(to, frame->height);
    case BUFFER_INFO_XOFFSET: return answer_size(to, frame->x);
    case BUFFER_INFO_YOFFSET: return answer_size(to, frame->y);
    case BUFFER_INFO_XPADDING:
    case BUFFER_INFO_YPADDING:
    case BUFFER_INFO_IMAGEOFFSET:
    case BUFFER_INFO_DELIVERED_CHUNKPAYLOADSIZE: return answer_size(to, 0);
    case BUFFER_INFO_FRAMEID: return answer_u64(to, frame->block);
    case BUFFER_INFO_IMAGEPRESENT: return answer_bool(to, buffer->new_data);
    case BUFFER_INFO_PAYLOADTYPE: return answer_size(to, PAYLOAD_TYPE_IMAGE);
    case BUFFER_INFO_PIXELFORMAT: return answer_u64(to, frame->format);
    case BUFFER_INFO_PIXELFORMAT_NAMESPACE:
        return answer_u64(to, PIXELFORMAT_NAMESPACE_PFNC_32BIT);
    case BUFFER_INFO_CHUNKLAYOUTID: return answer_u64(to, 0);
    case BUFFER_INFO_PIXEL_ENDIANNESS: return answer_i32(to, PIXELENDIANNESS_LITTLE);
    case BUFFER_INFO_DATA_LARGER_THAN_BUFFER:
    case BUFFER_INFO_CONTAINS_CHUNKDATA: return answer_bool(to, 0);
    default: return fail(GC_ERR_NOT_AVAILABLE, "no buffer info %d", what);
    }
}
