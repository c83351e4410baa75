#include "pixels.h"

#include <stdio.h>
#include <string.h>

static const struct {
    const char *suffix;
    int bits;
    enum packing packing;
    uint32_t codes[5]; /* Mono, BayerRG, BayerGR, BayerGB, BayerBG */
} FORMATS[PIXEL_FORMATS] = {
    {"8", 8, PACK_BYTES, {0x01080001, 0x01080009, 0x01080008, 0x0108000A, 0x0108000B}},
    {"10", 10, PACK_WORDS, {0x01100003, 0x0110000D, 0x0110000C, 0x0110000E, 0x0110000F}},
    {"10p", 10, PACK_STREAM, {0x010A0046, 0x010A0058, 0x010A0056, 0x010A0054, 0x010A0052}},
    {"10Packed", 10, PACK_PAIRS, {0x010C0004, 0x010C0027, 0x010C0026, 0x010C0028, 0x010C0029}},
    {"12", 12, PACK_WORDS, {0x01100005, 0x01100011, 0x01100010, 0x01100012, 0x01100013}},
    {"12p", 12, PACK_STREAM, {0x010C0047, 0x010C0059, 0x010C0057, 0x010C0055, 0x010C0053}},
    {"12Packed", 12, PACK_PAIRS, {0x010C0006, 0x010C002B, 0x010C002A, 0x010C002C, 0x010C002D}},
    {"16", 16, PACK_WORDS, {0x01100007, 0x0110002F, 0x0110002E, 0x01100030, 0x01100031}},
};

void pixel_formats(const char *cfa, struct pixel_format formats[PIXEL_FORMATS])
{
    static const char *const MOSAICS[] = {"", "RGGB", "GRBG", "GBRG", "BGGR"};
    int mosaic = 0;
    while (mosaic < 4 && strcmp(cfa, MOSAICS[mosaic]) != 0)
        mosaic++;
    for (int i = 0; i < PIXEL_FORMATS; i++) {
        struct pixel_format *f = &formats[i];
        snprintf(f->name, sizeof f->name, mosaic ? "Bayer%.2s%s" : "Mono%.0s%s", cfa,
                 FORMATS[i].suffix);
        f->code = FORMATS[i].codes[mosaic];
        f->bits = FORMATS[i].bits;
        f->packing = FORMATS[i].packing;
    }
}

size_t packed_size(const struct pixel_format *format, size_t samples)
{
    switch (format->packing) {
    case PACK_BYTES: return samples;
    case PACK_WORDS: return 2 * samples;
    case PACK_STREAM: return (samples * (size_t)format->bits + 7) / 8;
    case PACK_PAIRS: return (samples + 1) / 2 * 3;
    }
    return 0;
}

struct packer packer_to(const struct pixel_format *format, int sample_bits, uint8_t *at)
{
    const int drop = sample_bits > format->bits ? sample_bits - format->bits : 0;
    return (struct packer){*format, drop, at, 0, 0};
}

/* Two samples in three bytes: high bits, low bits of both, high bits (GigE Vision). */
static inline uint8_t *put_pair(uint8_t *at, int bits, uint32_t first, uint32_t second)
{
    const int low = bits - 8;
    const uint32_t mask = (1u << low) - 1;
    at[0] = (uint8_t)(first >> low);
    at[1] = (uint8_t)((first & mask) | (second & mask) << 4);
    at[2] = (uint8_t)(second >> low);
    return at + 3;
}

static void put_pairs(struct packer *to, const uint16_t *samples, size_t count)
{
    const int bits = to->format.bits, drop = to->drop;
    uint8_t *at = to->at;
    size_t i = 0;
    if (to->pending_bits && count) {
        at = put_pair(at, bits, (uint32_t)to->pending, (uint32_t)samples[i++] >> drop);
        to->pending_bits = 0;
    }
    for (; i + 2 <= count; i += 2)
        at = put_pair(at, bits, (uint32_t)samples[i] >> drop, (uint32_t)samples[i + 1] >> drop);
    if (i < count) {
        to->pending = (uint64_t)samples[i] >> drop;
        to->pending_bits = bits;
    }
    to->at = at;
}

/* Samples as one string of bits, the first one in the lowest bits; four fill whole bytes. */
static void put_stream(struct packer *to, const uint16_t *samples, size_t count)
{
    const int bits = to->format.bits, drop = to->drop;
    uint8_t *at = to->at;
    size_t i = 0;
    for (; to->pending_bits == 0 && i + 4 <= count; i += 4) {
        uint64_t word = 0;
        for (int k = 0; k < 4; k++)
            word |= (uint64_t)(samples[i + (size_t)k] >> drop) << (k * bits);
        for (int b = 0; b < bits / 2; b++)
            *at++ = (uint8_t)(word >> (8 * b));
    }
    for (; i < count; i++) {
        to->pending |= (uint64_t)(samples[i] >> drop) << to->pending_bits;
        to->pending_bits += bits;
        for (; to->pending_bits >= 8; to->pending_bits -= 8, to->pending >>= 8)
            *at++ = (uint8_t)to->pending;
    }
    to->at = at;
}

void pack(struct packer *to, const uint16_t *samples, size_t count)
{
    const int drop = to->drop;
    switch (to->format.packing) {
    case PACK_BYTES:
        for (size_t i = 0; i < count; i++)
            to->at[i] = (uint8_t)(samples[i] >> drop);
        to->at += count;
        break;
    case PACK_WORDS:
        if (drop == 0)
            memcpy(to->at, samples, 2 * count);
        else
            for (size_t i = 0; i < count; i++) {
                const uint16_t value = (uint16_t)(samples[i] >> drop);
                memcpy(to->at + 2 * i, &value, sizeof value);
            }
        to->at += 2 * count;
        break;
    case PACK_STREAM: put_stream(to, samples, count); break;
    case PACK_PAIRS: put_pairs(to, samples, count); break;
    }
}

void pack_end(struct packer *to)
{
    if (!to->pending_bits)
        return;
    if (to->format.packing == PACK_PAIRS)
        to->at = put_pair(to->at, to->format.bits, (uint32_t)to->pending, 0);
    else
        *to->at++ = (uint8_t)to->pending;
    to->pending_bits = 0;
}
