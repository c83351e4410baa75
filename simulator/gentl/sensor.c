#include "sensor.h"

#include <math.h>

#include "dice.h"

#define EXACT_BELOW_E 12.0f
#define LONGEST_INVERSION 47
#define BLOCK 256 /* pixels per block */

struct sensor sensor_for(const struct control *camera, int64_t exposure_ns, double gain_db,
                         double black_dn, uint64_t state)
{
    const double exposure_s = (double)exposure_ns / 1000 / 1e6;
    return (struct sensor){
        .efficiency = (float)camera->quantum_efficiency,
        .dark_e = (float)(camera->dark_current_e_per_s * exposure_s),
        .exposure_s = (float)exposure_s,
        .full_well_e = (float)camera->full_well_e,
        .read_noise_e = (float)camera->read_noise_e,
        .dn_per_electron = (float)(pow(10.0, gain_db / 20.0) / camera->electrons_per_dn),
        .black_dn = (float)black_dn,
        .end_dn = (float)((1u << camera->bit_depth) - 1),
        .noisy = camera->noisy,
        .state = state,
    };
}

static inline float smaller(float a, float b) { return a < b ? a : b; }

/* 31 bits as a number in (0, 1]. */
static inline float unit(int32_t bits) { return ((float)bits + 0.5f) * 0x1p-31f; }

/* Logarithm of a number in (0, 1], to 2e-7. */
static inline float log_of(float x)
{
    union {
        float value;
        int32_t bits;
    } m = {x};
    /* x = m * 2^e with m from sqrt(1/2) to sqrt(2). */
    const int32_t e = (m.bits - 0x3F3504F3) >> 23;
    m.bits -= e * (1 << 23);
    const float f = m.value - 1.0f;
    float tail = 0.09272214f;
    tail = tail * f - 0.14118426f;
    tail = tail * f + 0.14676397f;
    tail = tail * f - 0.16592856f;
    tail = tail * f + 0.19985127f;
    tail = tail * f - 0.25000921f;
    tail = tail * f + 0.33333409f;
    return (float)e * 0.6931472f + (f - 0.5f * f * f + f * f * f * tail);
}

/* Two independent normal numbers (Box and Muller) from two times 31 bits. */
static inline void normal_pair(int32_t high, int32_t low, float *first, float *second)
{
    const float radius = sqrtf(-2.0f * log_of(unit(high)));
    /* Whole quarters of a turn, and the remainder from -1/2 to 1/2. */
    const float quarters = 4.0f * unit(low);
    const int32_t q = (int32_t)(quarters + 0.5f);
    const float r = quarters - (float)q, square = r * r;
    const float sine = r * (1.5707964f + square * (-0.6459635f + square * (0.07968022f + square *
                            -0.0046021632f)));
    const float cosine = 1.0f + square * (-1.233697f + square * (0.2535986f + square *
                                -0.020408256f));
    const float x = q & 1 ? sine : cosine, y = q & 1 ? cosine : sine;
    *first = radius * ((q + 1) & 2 ? -x : x);
    *second = radius * (q & 2 ? -y : y);
}

static float poisson_by_inversion(float mean, float uniform)
{
    float term = expf(-mean), total = term;
    int count = 0;
    while (uniform > total && count < LONGEST_INVERSION) {
        count++;
        term *= mean * (float)(1.0 / count);
        total += term;
    }
    return (float)count;
}

static inline float poisson_by_expansion(float mean, float z)
{
    const float root = sqrtf(mean), square = z * z;
    return mean + root * z + (square - 1.0f) * (float)(1 / 6.0) +
           z * (1.0f - square) / (72.0f * root);
}

/* Add shot noise to the charges and read noise to the offsets. Each loop is simple enough that
 * compilers vectorise it. */
static void add_noise(const struct sensor *s, uint64_t first, uint32_t count, float *charge,
                      float *offset)
{
    int32_t high[BLOCK], low[BLOCK];
    float shot[BLOCK], read[BLOCK];
    for (uint32_t i = 0; i < count; i++) {
        const uint64_t bits = dice_bits(s->state, 2 * (first + i));
        high[i] = (int32_t)(bits >> 33);
        low[i] = (int32_t)((uint32_t)bits >> 1);
    }
    for (uint32_t i = 0; i < count; i++)
        normal_pair(high[i], low[i], &shot[i], &read[i]);
    bool any_exact = false;
    for (uint32_t i = 0; i < count; i++) {
        const bool exact = charge[i] < EXACT_BELOW_E;
        const float mean = exact ? EXACT_BELOW_E : charge[i];
        const float drawn = poisson_by_expansion(mean, shot[i]);
        charge[i] = exact ? charge[i] : drawn;
        shot[i] = exact ? 1.0f : 0.0f;
        any_exact |= exact;
        offset[i] += s->read_noise_e * read[i];
    }
    for (uint32_t i = 0; any_exact && i < count; i++)
        if (shot[i] > 0.0f) {
            const uint64_t bits = dice_bits(s->state, 2 * (first + i) + 1);
            charge[i] = poisson_by_inversion(charge[i], unit((int32_t)(bits >> 33)));
        }
}

/* Round to a grey value and clip to the range of the converter. */
static inline uint16_t grey_value(const struct sensor *s, float value)
{
    const float dn = s->black_dn + s->dn_per_electron * value + 0.5f;
    return (uint16_t)(int32_t)(dn > 0.0f ? smaller(dn, s->end_dn) : 0.0f);
}

void sensor_expose(const struct sensor *sensor, const struct pixel_run *run, uint16_t *grey)
{
    const struct sensor s = *sensor;
    float charge[BLOCK], offset[BLOCK];
    for (uint32_t first = 0; first < run->count; first += BLOCK) {
        const uint32_t count = run->count - first < BLOCK ? run->count - first : BLOCK;
        const float *photons = run->photons + first;
        for (uint32_t i = 0; i < count; i++) {
            charge[i] = s.efficiency * photons[i] + s.dark_e;
            offset[i] = 0;
        }
        for (uint32_t i = 0; run->response && i < count; i++) {
            charge[i] = s.efficiency * run->response[first + i] * photons[i] + s.dark_e;
            charge[i] += run->hot[first + i] * s.exposure_s;
            offset[i] = run->offset[first + i];
        }
        if (s.noisy)
            add_noise(&s, run->first + first, count, charge, offset);
        for (uint32_t i = 0; i < count; i++)
            grey[first + i] = grey_value(&s, smaller(charge[i], s.full_well_e) + offset[i]);
    }
}
