#include "shake.h"

#include <math.h>
#include <stdlib.h>

#include "dice.h"

#define TAG 0x5AFE
#define LOBES 8
#define BETA 7.0
#define MOST_TAPS 512
#define PI 3.141592653589793

struct kernel {
    int reach; /* taps on each side */
    int step;  /* distance between the pixels of two taps */
    float taps[MOST_TAPS];
};

void shake_draw(uint64_t shot, double sigma_px, double *right, double *down)
{
    dice_normal_pair(dice_stream(shot, (const uint64_t[]){TAG}, 1), 0, right, down);
    *right *= sigma_px;
    *down *= sigma_px;
}

/* The modified Bessel function of the first kind and order 0. */
static double bessel_i0(double x)
{
    double term = 1, sum = 1;
    for (int k = 1; k < 60; k++) {
        term *= x * x / 4 / ((double)k * k);
        sum += term;
    }
    return sum;
}

static struct kernel kernel_for(double shift, int step)
{
    struct kernel kernel = {.reach = LOBES + (int)ceil(fabs(shift)), .step = step};
    double taps[MOST_TAPS], sum = 0;
    for (int k = 0; k <= 2 * kernel.reach; k++) {
        const double at = k - kernel.reach + shift, share = at / LOBES;
        const double sinc = at == 0 ? 1 : sin(PI * at) / (PI * at);
        taps[k] = fabs(at) < LOBES ? sinc * bessel_i0(BETA * sqrt(fmax(1 - share * share, 0))) : 0;
        sum += taps[k];
    }
    for (int k = 0; k <= 2 * kernel.reach; k++)
        kernel.taps[k] = (float)(taps[k] / sum);
    return kernel;
}

/* Index in the mirror image, which does not repeat the edge pixel. */
static int mirrored(int at, int size)
{
    if (size == 1)
        return 0;
    const int period = 2 * (size - 1);
    at = abs(at) % period;
    return at < size ? at : period - at;
}

static void shift_row(const struct kernel *kernel, const float *from, float *to, int width)
{
    const int margin = kernel->reach * kernel->step;
    for (int column = 0; column < width; column++) {
        const bool inside = column >= margin && column + margin < width;
        float sum = 0;
        for (int k = 0; k <= 2 * kernel->reach; k++) {
            const int at = column + (k - kernel->reach) * kernel->step;
            sum += kernel->taps[k] * from[inside ? at : mirrored(at, width)];
        }
        to[column] = sum;
    }
}

void shake_shift(float *image, float *between, uint32_t width, uint32_t height, double right,
                 double down, bool mosaic)
{
    const int step = mosaic ? 2 : 1;
    const struct kernel across = kernel_for(right / step, step);
    const struct kernel along = kernel_for(down / step, step);
    for (uint32_t row = 0; row < height; row++)
        shift_row(&across, image + (size_t)row * width, between + (size_t)row * width, (int)width);
    for (uint32_t row = 0; row < height; row++) {
        float *to = image + (size_t)row * width;
        for (uint32_t column = 0; column < width; column++)
            to[column] = 0;
        for (int k = 0; k <= 2 * along.reach; k++) {
            const int at = mirrored((int)row + (k - along.reach) * step, (int)height);
            const float *from = between + (size_t)at * width;
            for (uint32_t column = 0; column < width; column++)
                to[column] += along.taps[k] * from[column];
        }
        for (uint32_t column = 0; column < width; column++)
            to[column] = fmaxf(to[column], 0.0f);
    }
}
