/* The control file: what this camera is, in memory shared with whoever made it.
 *
 * It lies beside the library as "camera.control". Without it the library is a camera of its own
 * with a test pattern. `simulator/_camera/gentl_control.py` has the same layout: change both. */
#ifndef CONTROL_H
#define CONTROL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define CONTROL_VERSION 1
#define CONTROL_FAULTS 256
#define CONTROL_MAX_LEDS 1024
#define CONTROL_PATH 1024

enum content { CONTENT_PATTERN, CONTENT_PLANES, CONTENT_FRAMES };
enum fault_kind {
    FAULT_NONE,
    FAULT_LOST,       /* exposed, counted, never delivered */
    FAULT_LATE,       /* delivered that much later, and so are all that follow */
    FAULT_INCOMPLETE, /* half of the rows, told as incomplete */
    FAULT_DOUBLED,    /* delivered twice under one block id */
    FAULT_MISSED,     /* the trigger is not seen */
    FAULT_UNPLUG,     /* unplugged instead of exposing */
    FAULT_UNDERRUN,   /* finds no free buffer, whatever is queued */
};
enum automatic { AUTO_EXPOSURE = 1, AUTO_GAIN = 2, AUTO_WHITE = 4, AUTO_GAMMA = 8 };

struct fault {
    int64_t at;      /* which exposure of the camera's life, counted from 0; -1: the next */
    int64_t late_ns;
    uint32_t kind;
    uint32_t armed; /* written last; 0 again when it has struck */
};

struct control {
    char magic[8]; /* "SGPCAMRA" */
    uint32_t version;
    uint32_t size; /* of this structure */

    uint32_t width, height;
    uint32_t leds;
    uint32_t content;
    uint32_t bit_depth;
    uint32_t noisy;
    uint32_t rolling;
    uint32_t block_base; /* block id of the first frame after a start */
    uint32_t autos;      /* automatics that are on at power-up */
    uint32_t stuck;      /* automatics that cannot be changed */
    uint32_t patterned;  /* the file of fixed patterns is there */
    uint32_t most_buffers; /* that a client may announce; 0 for as many as the stream can take */
    uint64_t seed;
    char cfa[8];
    char serial[64];
    char hidden[256]; /* nodes that this camera lacks: names, each followed by a comma */
    char bench_path[CONTROL_PATH];

    double readout_us;
    double frame_period_us; /* least time between the starts of exposures */
    double shake_px;

    double electrons_per_dn, read_noise_e, black_level_dn, quantum_efficiency;
    double full_well_e; /* infinite where the converter ends first */
    double dark_current_e_per_s;

    double warm_up, warm_up_s, flicker;
    double pwm_hz; /* 0: constant current */
    double pwm_duty;
    uint8_t dead[CONTROL_MAX_LEDS];

    /* From here on alive: changed while the camera runs. */
    double temperature_c;
    uint32_t plugged; /* written by the maker */
    uint32_t unplugs; /* raised with each unplugging: handles of before are dead */
    uint64_t exposures, delivered, dropped, missed; /* written by the camera */
    struct fault faults[CONTROL_FAULTS];
};

struct files {
    const float *planes;     /* (leds + 1, height, width), the ambient light first */
    const uint16_t *frames;  /* the same, grey values */
    const float *pattern;    /* (3, height, width): response, offset, dark current */
};

/* Map the control file and what it names. NULL after all has been told to `fail`. */
struct control *control_open(struct files *files);
void control_close(void);
/* Keep every other process from opening the camera; false where one has it. */
bool control_lock(void);
void control_unlock(void);
/* The library's own path. */
const char *control_library(void);

#endif
