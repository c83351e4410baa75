/* Pixel formats: names and codes (PFNC), and packing of samples. */
#ifndef PIXELS_H
#define PIXELS_H

#include <stddef.h>
#include <stdint.h>

struct pixel_format {
    char name[20];
    uint32_t code;
    int bits; /* per sample */
    enum packing { PACK_BYTES, PACK_WORDS, PACK_STREAM, PACK_PAIRS } packing;
};

#define PIXEL_FORMATS 8

/* The formats of a sensor with this mosaic ("" for monochrome), fewest bits first. */
void pixel_formats(const char *cfa, struct pixel_format formats[PIXEL_FORMATS]);
size_t packed_size(const struct pixel_format *format, size_t samples);

/* State while samples are packed row by row. */
struct packer {
    struct pixel_format format;
    int drop; /* number of low bits that the format does not have */
    uint8_t *at;
    uint64_t pending;
    int pending_bits;
};

struct packer packer_to(const struct pixel_format *format, int sample_bits, uint8_t *at);
void pack(struct packer *to, const uint16_t *samples, size_t count);
void pack_end(struct packer *to);

#endif
