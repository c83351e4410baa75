/* Pixel formats: their names and numbers (PFNC), and samples packed as they say. */
#ifndef PIXELS_H
#define PIXELS_H

#include <stddef.h>
#include <stdint.h>

struct pixel_format {
    char name[20];
    uint32_t code;
    int bits; /* of a sample */
    enum packing { PACK_BYTES, PACK_WORDS, PACK_STREAM, PACK_PAIRS } packing;
};

#define PIXEL_FORMATS 8

/* The formats of a sensor with this mosaic ("" for none), fewest bits first. */
void pixel_formats(const char *cfa, struct pixel_format formats[PIXEL_FORMATS]);
size_t packed_size(const struct pixel_format *format, size_t samples);

/* Packs samples one run after the other, as rows come. */
struct packer {
    struct pixel_format format;
    int drop; /* low bits that the format has no room for */
    uint8_t *at;
    uint64_t pending;
    int pending_bits;
};

struct packer packer_to(const struct pixel_format *format, int sample_bits, uint8_t *at);
void pack(struct packer *to, const uint16_t *samples, size_t count);
void pack_end(struct packer *to);

#endif
