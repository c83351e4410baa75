#include "picture.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "develop.h"
#include "dice.h"
#include "light.h"
#include "repeats.h"
#include "sensor.h"
#include "shake.h"

static const struct control *camera;
static struct files files;
static uint16_t *grey;  /* grey values of the area read out, row by row */
static float *photons;  /* one row; the whole sensor twice if the camera shakes */
static const uint16_t *rows;
static size_t row_length;

bool picture_open(const struct control *of, const struct files *its)
{
    camera = of;
    files = *its;
    const size_t pixels = (size_t)of->width * of->height;
    grey = malloc(pixels * sizeof *grey);
    photons = malloc((of->shake_px > 0 ? 2 * pixels : of->width) * sizeof *photons);
    repeats_forget();
    return grey && photons;
}

void picture_close(void)
{
    free(grey);
    free(photons);
    grey = NULL;
    photons = NULL;
    repeats_forget();
}

const uint16_t *picture_row(uint32_t row) { return rows + row * row_length; }

static int64_t row_delay_ns(uint32_t row)
{
    return camera->rolling ? llrint(camera->readout_us * 1000 * row / camera->height) : 0;
}

/* The stream of random numbers of a shot; each of several equal shots has its own stream. */
static uint64_t shot_stream(const struct shot *shot, int32_t led)
{
    const struct shot_kind kind = {(uint64_t)(led + 1), (uint64_t)shot->exposure_ns,
                                   (uint64_t)llrint(shot->gain_db * 1000)};
    const uint64_t key[] = {camera->seed, kind.led, kind.exposure_ns, kind.gain_mdb,
                            repeats_count(&kind)};
    return dice_stream(0, key, sizeof key / sizeof *key);
}

static bool has_plane(int32_t led) { return led >= 0 && (uint32_t)led < camera->leds; }

static void expose_row(const struct light *light, uint32_t row, float *to)
{
    const size_t pixels = (size_t)camera->width * camera->height;
    const size_t at = (size_t)row * camera->width;
    const float *ambient = files.planes + at;
    const float exposure_us = (float)((double)light->exposure_ns / 1000);
    for (uint32_t column = 0; column < camera->width; column++)
        to[column] = ambient[column] * exposure_us;
    for (int n = 0; n < light->leds; n++) {
        const float amount_us =
            has_plane(light->which[n]) ? light_amount_us(light, camera, n, row_delay_ns(row)) : 0;
        if (amount_us == 0)
            continue;
        const float *plane = files.planes + pixels * (size_t)(light->which[n] + 1) + at;
        for (uint32_t column = 0; column < camera->width; column++)
            to[column] += plane[column] * amount_us;
    }
}

static void read_row(const struct sensor *sensor, const struct shot *shot, uint32_t row,
                     const float *of)
{
    const size_t pixels = (size_t)camera->width * camera->height;
    const size_t first = (size_t)row * camera->width + shot->x;
    struct pixel_run run = {.photons = of + shot->x, .first = first, .count = shot->width};
    if (files.pattern) {
        run.response = files.pattern + first;
        run.offset = files.pattern + pixels + first;
        run.hot = files.pattern + 2 * pixels + first;
    }
    sensor_expose(sensor, &run, grey + (size_t)(row - shot->y) * shot->width);
}

static bool compose_planes(const struct shot *shot, struct light *light, bool (*give_up)(void))
{
    const uint64_t state = shot_stream(shot, light->led);
    for (int n = 0; n < light->leds; n++)
        light->luck[n] = lamps_draw(state, light->which[n]);
    const struct sensor sensor =
        sensor_for(camera, shot->exposure_ns, shot->gain_db, shot->black_dn, state);
    const bool shaking = camera->shake_px > 0;
    if (shaking) {
        for (uint32_t row = 0; row < camera->height && !give_up(); row++)
            expose_row(light, row, photons + (size_t)row * camera->width);
        double right, down;
        shake_draw(state, camera->shake_px, &right, &down);
        shake_shift(photons, photons + (size_t)camera->width * camera->height, camera->width,
                    camera->height, right, down, camera->cfa[0]);
    }
    for (uint32_t row = shot->y; row < shot->y + shot->height; row++) {
        if (give_up())
            return false;
        if (!shaking)
            expose_row(light, row, photons);
        read_row(&sensor, shot, row, photons + (shaking ? (size_t)row * camera->width : 0));
    }
    return true;
}

static void compose_pattern(const struct shot *shot)
{
    const uint32_t end = (1u << camera->bit_depth) - 1;
    for (uint32_t row = 0; row < shot->height; row++)
        for (uint32_t column = 0; column < shot->width; column++)
            grey[(size_t)row * shot->width + column] =
                (uint16_t)((4 * (row + shot->y) + 8 * (column + shot->x) + 16 * shot->block) & end);
}

/* The frame of the LED that was on longest. */
static const uint16_t *prepared_frame(const struct light *light)
{
    int64_t longest_ns = 0;
    size_t frame = 0;
    for (int n = 0; n < light->leds; n++) {
        const int64_t lit_ns = light_lit_ns(light, light->which[n], 0);
        if (has_plane(light->which[n]) && lit_ns > longest_ns) {
            longest_ns = lit_ns;
            frame = (size_t)light->which[n] + 1;
        }
    }
    return files.frames + frame * camera->width * camera->height;
}

bool picture_compose(const struct shot *shot, bool (*give_up)(void))
{
    struct light light = {.lamps_ns = shot->lamps_ns};
    if (!light_see(&light, shot->start_ns, shot->exposure_ns, row_delay_ns(camera->height)))
        return false;
    const bool developed = shot->gamma != 1 || (shot->balance_white && camera->cfa[0]);
    rows = grey;
    row_length = shot->width;
    if (camera->content == CONTENT_FRAMES) {
        const uint16_t *frame =
            prepared_frame(&light) + (size_t)shot->y * camera->width + shot->x;
        if (!developed) {
            rows = frame;
            row_length = camera->width;
        }
        for (uint32_t row = 0; developed && row < shot->height; row++)
            memcpy(grey + (size_t)row * shot->width, frame + (size_t)row * camera->width,
                   shot->width * sizeof *grey);
    } else if (camera->content == CONTENT_PATTERN) {
        compose_pattern(shot);
    } else if (!compose_planes(shot, &light, give_up)) {
        return false;
    }
    if (developed)
        develop(grey, shot, camera);
    return true;
}
