/* The control file: the properties of this camera, in memory shared with the process that made it.
 *
 * It is "camera.control" in the folder of the library. Without it, the library is a camera with a
 * test pattern. `simulator/camera/gentl_camera.py` has the same layout: change both together. */
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
    FAULT_LOST,       /* exposed and counted, but not delivered */
    FAULT_LATE,       /* delivered late_ns later, and so are all frames after it */
    FAULT_INCOMPLETE, /* half of the rows, reported as incomplete */
    FAULT_DOUBLED,    /* delivered twice with one block id */
    FAULT_MISSED,     /* the trigger has no effect */
    FAULT_UNPLUG,     /* unplugged instead of exposing */
    FAULT_UNDERRUN,   /* finds no free buffer, even if buffers are queued */
};
enum automatic { AUTO_EXPOSURE = 1, AUTO_GAIN = 2, AUTO_WHITE = 4, AUTO_GAMMA = 8 };

struct fault {
    int64_t at;      /* number of the exposure since the camera was made, from 0; -1: the next */
    int64_t late_ns;
    uint32_t kind;
    uint32_t armed; /* written last; 0 again when the fault has occurred */
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
    uint32_t autos;      /* automatic functions that are on at power-up */
    uint32_t stuck;      /* automatic functions that ignore new settings */
    uint32_t patterned;  /* there is a file with the fixed pattern */
    uint32_t most_buffers; /* maximum number of announced buffers; 0: limit of the stream */
    uint64_t seed;
    char cfa[8];
    char serial[64];
    char hidden[256]; /* nodes that this camera does not have: names, each followed by a comma */
    char bench_path[CONTROL_PATH];

    double readout_us;
    double frame_period_us; /* minimum time between the starts of exposures */
    double shake_px;

    double electrons_per_dn, read_noise_e, black_level_dn, quantum_efficiency;
    double full_well_e; /* infinite if the converter saturates first */
    double dark_current_e_per_s;

    double warm_up, warm_up_s, flicker;
    double pwm_hz; /* 0: constant current */
    double pwm_duty;
    uint8_t dead[CONTROL_MAX_LEDS];

    /* From here on: values that change while the camera runs. */
    double temperature_c;
    uint32_t plugged; /* written by the process that made the camera */
    uint32_t unplugs; /* number of times it was unplugged: earlier handles are dead */
    uint64_t exposures, delivered, dropped, missed; /* written by the camera */
    struct fault faults[CONTROL_FAULTS];
};

struct files {
    const float *planes;     /* (leds + 1, height, width), the ambient light first */
    const uint16_t *frames;  /* the same with grey values */
    const float *pattern;    /* (3, height, width): response, offset, dark current */
};

/* Map the control file and its data files. Returns NULL after a call of `fail` with the reason. */
struct control *control_open(struct files *files);
void control_close(void);
/* Lock the camera against other processes; returns false if another process has it open. */
bool control_lock(void);
void control_unlock(void);
/* Path of the library. */
const char *control_library(void);

#endif
