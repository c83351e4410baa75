#include "control.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "answers.h"

static const char MAGIC[8] = "SGPCAMRA";

static struct control *control;
static struct control alone; /* camera without a control file */
static int control_fd = -1;
static struct {
    void *at;
    size_t size;
} maps[3];

/* Set when the library is loaded: a relative path is no longer valid after the host has changed its
 * folder. */
static char library_path[PATH_MAX];

__attribute__((constructor)) static void find_library(void)
{
    Dl_info info;
    if (!dladdr((void *)&maps, &info) || !info.dli_fname || !realpath(info.dli_fname, library_path))
        library_path[0] = 0;
}

const char *control_library(void) { return library_path; }

static void path_in_folder(const char *name, char *path, size_t size)
{
    const char *library = control_library();
    const char *slash = strrchr(library, '/');
    const int folder = slash ? (int)(slash - library) + 1 : 0;
    snprintf(path, size, "%.*s%s", folder, library, name);
}

static void be_alone(void)
{
    memset(&alone, 0, sizeof alone);
    alone.width = 640;
    alone.height = 480;
    alone.content = CONTENT_PATTERN;
    alone.bit_depth = 12;
    alone.frame_period_us = 5000;
    alone.electrons_per_dn = 1;
    alone.black_level_dn = 64;
    alone.quantum_efficiency = 1;
    alone.full_well_e = INFINITY;
    alone.temperature_c = 40;
    alone.plugged = 1;
    strcpy(alone.serial, "SGP-0000");
}

/* Description of the first fault of a control file, or NULL. */
static const char *complaint(const struct control *c)
{
    if (memcmp(c->magic, MAGIC, sizeof MAGIC) != 0)
        return "it does not begin with SGPCAMRA";
    if (c->version != CONTROL_VERSION || c->size != sizeof *c)
        return "it has another version";
    if (c->width < 1 || c->width > 65535 || c->height < 1 || c->height > 65535)
        return "the sensor's size is out of range";
    if (c->leds > CONTROL_MAX_LEDS)
        return "too many LEDs";
    if (c->content > CONTENT_FRAMES || c->bit_depth < 8 || c->bit_depth > 16)
        return "content or bit depth is out of range";
    if (!memchr(c->serial, 0, sizeof c->serial) || !memchr(c->hidden, 0, sizeof c->hidden) ||
        !memchr(c->bench_path, 0, sizeof c->bench_path) || !memchr(c->cfa, 0, sizeof c->cfa))
        return "a text is not terminated";
    if (c->cfa[0] && strcmp(c->cfa, "RGGB") != 0 && strcmp(c->cfa, "GRBG") != 0 &&
        strcmp(c->cfa, "GBRG") != 0 && strcmp(c->cfa, "BGGR") != 0)
        return "unknown mosaic";
    const double finite[] = {c->readout_us,         c->frame_period_us,      c->shake_px,
                             c->read_noise_e,       c->black_level_dn,       c->quantum_efficiency,
                             c->dark_current_e_per_s, c->warm_up_s,          c->flicker,
                             c->pwm_hz,             c->pwm_duty,             c->electrons_per_dn};
    for (size_t i = 0; i < sizeof finite / sizeof *finite; i++)
        if (!isfinite(finite[i]) || finite[i] < 0)
            return "a number is negative or not finite";
    if (!isfinite(c->warm_up) || !(c->electrons_per_dn > 0) || !(c->full_well_e > 0) ||
        !(c->shake_px <= 8) || !(c->warm_up_s > 0) || !(c->pwm_duty > 0) || !(c->pwm_duty <= 1) ||
        !(c->readout_us <= 1e7) || !(c->frame_period_us <= 1e7))
        return "a number is out of range";
    return NULL;
}

static const void *map_file(int slot, const char *name, size_t size)
{
    char path[PATH_MAX];
    path_in_folder(name, path, sizeof path);
    struct stat about;
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0 || fstat(fd, &about) != 0) {
        fail(GC_ERR_IO, "%s: cannot be opened (%s)", path, strerror(errno));
    } else if ((size_t)about.st_size != size) {
        fail(GC_ERR_IO, "%s: has %lld bytes, but the camera requires %zu", path,
             (long long)about.st_size, size);
    } else {
        void *at = mmap(NULL, size, PROT_READ, MAP_SHARED, fd, 0);
        if (at == MAP_FAILED)
            fail(GC_ERR_IO, "%s: cannot be mapped (%s)", path, strerror(errno));
        else
            maps[slot].at = at, maps[slot].size = size;
    }
    if (fd >= 0)
        close(fd);
    return maps[slot].at;
}

static bool map_files(struct files *files)
{
    const size_t pixels = (size_t)control->width * control->height;
    const size_t images = pixels * (control->leds + 1);
    if (control->content == CONTENT_PLANES &&
        !(files->planes = map_file(0, "planes.f32", images * sizeof(float))))
        return false;
    if (control->content == CONTENT_FRAMES &&
        !(files->frames = map_file(1, "frames.u16", images * sizeof(uint16_t))))
        return false;
    return !control->patterned ||
           (files->pattern = map_file(2, "pattern.f32", 3 * pixels * sizeof(float)));
}

struct control *control_open(struct files *files)
{
    char path[PATH_MAX];
    path_in_folder("camera.control", path, sizeof path);
    memset(files, 0, sizeof *files);
    control_fd = open(path, O_RDWR | O_CLOEXEC);
    if (control_fd < 0 && errno == ENOENT && access(control_library(), F_OK) == 0) {
        be_alone();
        return control = &alone;
    }
    struct stat about;
    if (control_fd < 0 || fstat(control_fd, &about) != 0) {
        fail(GC_ERR_IO, "%s: cannot be opened (%s)", path, strerror(errno));
        control_close();
        return NULL;
    }
    if ((size_t)about.st_size != sizeof *control) {
        fail(GC_ERR_IO, "%s: damaged control file: %lld bytes, not %zu", path,
             (long long)about.st_size, sizeof *control);
        control_close();
        return NULL;
    }
    void *at = mmap(NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED, control_fd, 0);
    if (at == MAP_FAILED) {
        fail(GC_ERR_IO, "%s: cannot be mapped (%s)", path, strerror(errno));
        control_close();
        return NULL;
    }
    control = at;
    const char *wrong = complaint(control);
    if (wrong)
        fail(GC_ERR_IO, "%s: damaged control file: %s", path, wrong);
    if (wrong || !map_files(files)) {
        control_close();
        return NULL;
    }
    return control;
}

void control_close(void)
{
    for (size_t i = 0; i < sizeof maps / sizeof *maps; i++)
        if (maps[i].at)
            munmap(maps[i].at, maps[i].size);
    memset(maps, 0, sizeof maps);
    if (control && control != &alone)
        munmap(control, sizeof *control);
    control = NULL;
    if (control_fd >= 0)
        close(control_fd);
    control_fd = -1;
}

bool control_lock(void)
{
    return control_fd < 0 || flock(control_fd, LOCK_EX | LOCK_NB) == 0;
}

void control_unlock(void)
{
    if (control_fd >= 0)
        flock(control_fd, LOCK_UN);
}
