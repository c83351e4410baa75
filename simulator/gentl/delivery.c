#include "delivery.h"

#include <math.h>

#include "nodes.h"
#include "stream.h"

static int deliver_once(const struct shot *shot, const struct pixel_format *format,
                        bool incomplete, int sample_bits)
{
    const size_t size = packed_size(format, (size_t)shot->width * shot->height);
    uint8_t *memory;
    struct buffer *buffer = stream_take(size, &memory);
    if (!buffer)
        return 0;
    const uint32_t rows = incomplete ? shot->height / 2 : shot->height;
    struct packer packer = packer_to(format, sample_bits, memory);
    for (uint32_t row = 0; row < rows; row++)
        pack(&packer, picture_row(row), shot->width);
    pack_end(&packer);
    const struct frame_info frame = {
        .block = shot->block, .start_ns = shot->start_ns, .width = shot->width,
        .height = shot->height, .x = shot->x, .y = shot->y, .format = format->code, .size = size,
        .size_filled = packed_size(format, (size_t)shot->width * rows)};
    stream_deliver(buffer, &frame);
    return 1;
}

int deliver(const struct shot *shot, const struct pixel_format *format, uint32_t fault,
            int sample_bits)
{
    int delivered = deliver_once(shot, format, fault == FAULT_INCOMPLETE, sample_bits);
    if (delivered && fault == FAULT_DOUBLED)
        delivered += deliver_once(shot, format, false, sample_bits);
    return delivered;
}

void adjust_automatics(const struct shot *shot, const struct control *camera)
{
    const bool exposure = node_integer(EXPOSURE_AUTO), gain = node_integer(GAIN_AUTO);
    if (!exposure && !gain)
        return;
    double sum = 0;
    for (uint32_t row = 0; row < shot->height; row++)
        for (uint32_t column = 0; column < shot->width; column++)
            sum += picture_row(row)[column];
    const double end = ldexp(1, (int)camera->bit_depth) - 1;
    const double mean = sum / ((double)shot->width * shot->height) - shot->black_dn;
    /* Move the mean to the middle of the range, at most by a factor of two per frame. */
    const double factor = fmin(fmax(end / 2 / fmax(mean, 1), 0.5), 2);
    if (exposure)
        node_set_float(EXPOSURE_TIME,
                       rint(fmin(fmax(node_float(EXPOSURE_TIME) * factor, 10), 1e7)));
    else
        node_set_float(GAIN, fmin(fmax(node_float(GAIN) + 20 * log10(factor), 0), 24));
}
