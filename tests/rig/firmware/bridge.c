/* The AVR image of the LED board in simavr, with a simulated rig: serial line to a pty, two TLC5947, trigger, camera.
 *
 * bridge IMAGE.elf atmega328p|atmega2560
 *
 * It prints {"port": PATH} and then a line when the set of LEDs that are on, or the trigger line, changes:
 * {"us": T, "lit": [LED, ...], "levels": [BRIGHTNESS, ...]} and {"us": T, "trigger": 0 or 1}; T is simulated time. On
 * its standard input it accepts the lines `active 0`, `active 1` and `reset`, and it ends when that is closed. For the
 * line `stack` it prints the size of the RAM that was never written: {"us": T, "untouched": BYTES}. It never runs
 * faster than real time.
 *
 * bridge IMAGE.elf MCU stepped
 *
 * Simulated time stops between orders. The order `step BYTES US` waits until this number of bytes has arrived at the
 * port, sends them to the board at the speed of the serial line, continues until US, and prints
 * {"us": T, "stepped": BYTES} with the number of bytes that the board has sent.
 *
 * A test tool: it is linked with libsimavr (GPL-3) on the computer that runs the tests, and is part of no package. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

/* simavr uses eleven bits of 8 x 17 cycles per byte. */
enum { MHZ = 16, CHANNELS = 48, BITS = 12, SLICE_US = 250, BYTE_CYCLES = 11 * 8 * 17, UNTOUCHED = 0xA5 };
enum { SIN, SCLK, XLAT, BLANK, TRIGGER, WIRES };

typedef struct {
    char port;
    uint8_t bit;
} pin_t;
typedef struct {
    const char *mcu;
    pin_t out[WIRES];
    pin_t active;
} wiring_t;

static const wiring_t WIRINGS[] = {
    {"atmega328p", {{'D', 4}, {'D', 5}, {'D', 6}, {'D', 7}, {'B', 0}}, {'B', 1}},
    {"atmega2560", {{'A', 0}, {'A', 1}, {'A', 2}, {'A', 3}, {'A', 4}}, {'A', 5}},
};

static const wiring_t *wiring;
static avr_t *avr;
static uint8_t port_of[128], direction_of[128];
static int level_of[WIRES];
static uint8_t chain[CHANNELS * BITS]; /* shift registers; [0] is the bit shifted in last */
static uint16_t latches[CHANNELS];
static int exposing, stepped;
static char lit_before[1100];

static void report(const char *what) {
    printf("{\"us\": %llu, %s}\n", (unsigned long long)(avr->cycle / MHZ), what);
}

static void report_lit(void) {
    char leds[512] = "", levels[512] = "", now[sizeof lit_before];
    for (int k = 0; k < CHANNELS && !level_of[BLANK]; k++) {
        if (latches[k] == 0)
            continue;
        sprintf(leds + strlen(leds), "%s%d", *leds ? ", " : "", k);
        sprintf(levels + strlen(levels), "%s%d", *levels ? ", " : "", latches[k]);
    }
    snprintf(now, sizeof now, "\"lit\": [%s], \"levels\": [%s]", leds, levels);
    if (strcmp(now, lit_before) == 0)
        return;
    report(now);
    memcpy(lit_before, now, sizeof now);
}

static void rising(int wire) {
    if (wire == SCLK) {
        memmove(chain + 1, chain, sizeof chain - 1);
        chain[0] = (uint8_t)level_of[SIN];
    }
    if (wire == XLAT)
        for (int k = 0; k < CHANNELS; k++) {
            latches[k] = 0;
            for (int bit = 0; bit < BITS; bit++)
                latches[k] |= (uint16_t)(chain[k * BITS + bit] << bit);
        }
}

/* Update the levels of the wires. An undriven BLANK is pulled up, every other undriven wire down. */
static void settle(void) {
    for (int wire = 0; wire < WIRES; wire++) {
        const pin_t pin = wiring->out[wire];
        const int driven = direction_of[(int)pin.port] >> pin.bit & 1;
        const int level = driven ? port_of[(int)pin.port] >> pin.bit & 1 : wire == BLANK;
        if (level == level_of[wire])
            continue;
        level_of[wire] = level;
        if (level)
            rising(wire);
        if (wire == TRIGGER)
            report(level ? "\"trigger\": 1" : "\"trigger\": 0");
    }
    report_lit();
}

static void port_written(struct avr_irq_t *irq, uint32_t value, void *port) {
    (void)irq;
    port_of[*(const uint8_t *)port] = (uint8_t)value;
    settle();
}

static void direction_written(struct avr_irq_t *irq, uint32_t value, void *port) {
    (void)irq;
    direction_of[*(const uint8_t *)port] = (uint8_t)value;
    settle();
}

static void drive_active(void) {
    const pin_t pin = wiring->active;
    avr_irq_t *irq = avr_io_getirq(avr, (uint32_t)AVR_IOCTL_IOPORT_GETIRQ(pin.port), pin.bit);
    /* A reset clears the pin's register, but simavr would still drop a level equal to the last one. */
    irq->flags &= (uint8_t)~IRQ_FLAG_FILTERED;
    avr_raise_irq(irq, (uint32_t)exposing);
}

/* A reset of any cause releases all pins. */
static void (*reset_core)(struct avr_t *);
static void let_go(struct avr_t *of) {
    if (reset_core)
        reset_core(of);
    memset(port_of, 0, sizeof port_of);
    memset(direction_of, 0, sizeof direction_of);
    settle();
}

static char to_host[4096], to_board[4096];
static size_t to_host_n, to_board_n;
static int wire_fd;
static avr_cycle_count_t next_byte;

static void byte_sent(struct avr_irq_t *irq, uint32_t value, void *ignored) {
    (void)irq, (void)ignored;
    if (to_host_n < sizeof to_host)
        to_host[to_host_n++] = (char)value;
}

static void send_byte(void) {
    if (to_board_n == 0 || avr->cycle < next_byte)
        return;
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), (uint8_t)to_board[0]);
    memmove(to_board, to_board + 1, --to_board_n);
    next_byte = avr->cycle + BYTE_CYCLES;
}

static void exchange(void) {
    if (to_host_n > 0) {
        /* If the host does not read, bytes are lost, as on a wire. */
        if (write(wire_fd, to_host, to_host_n) < 0 && errno != EAGAIN)
            exit(1);
        to_host_n = 0;
    }
    const ssize_t n = read(wire_fd, to_board + to_board_n, sizeof to_board - to_board_n);
    if (n > 0)
        to_board_n += (size_t)n;
    fflush(stdout);
}

/* The longest stretch of RAM that was never written is between the data and the deepest stack. */
static void report_stack(void) {
    int longest = 0;
    for (int at = avr->ioend + 1, from = at; at <= avr->ramend; at++) {
        if (avr->data[at] != UNTOUCHED)
            from = at + 1;
        else if (at + 1 - from > longest)
            longest = at + 1 - from;
    }
    char text[64];
    snprintf(text, sizeof text, "\"untouched\": %d", longest);
    report(text);
}

static int run_until(avr_cycle_count_t end) {
    while (avr->cycle < end) {
        send_byte();
        const int state = avr_run(avr);
        if (state == cpu_Crashed || state == cpu_Done) {
            fprintf(stderr, "the bridge: the processor stopped\n");
            return 0;
        }
    }
    return 1;
}

static void step(size_t bytes, unsigned long long until_us) {
    struct pollfd end = {wire_fd, POLLIN, 0};
    while (to_board_n < bytes && poll(&end, 1, -1) >= 0) {
        const ssize_t n = read(wire_fd, to_board + to_board_n, sizeof to_board - to_board_n);
        if (n > 0)
            to_board_n += (size_t)n;
    }
    next_byte = avr->cycle + BYTE_CYCLES;
    if (!run_until(until_us * MHZ))
        exit(1);
    char text[64];
    snprintf(text, sizeof text, "\"stepped\": %zu", to_host_n);
    report(text);
    exchange();
}

static void obey(const char *order) {
    size_t bytes;
    unsigned long long until_us;
    if (stepped && sscanf(order, "step %zu %llu", &bytes, &until_us) == 2) {
        step(bytes, until_us);
    } else if (strncmp(order, "active ", 7) == 0) {
        exposing = order[7] == '1';
        drive_active();
    } else if (strcmp(order, "stack") == 0) {
        report_stack();
    } else if (strcmp(order, "reset") == 0) {
        char lost[256];
        while (read(wire_fd, lost, sizeof lost) > 0) {
        }
        to_board_n = to_host_n = 0;
        avr_reset(avr);
        drive_active();
    } else
        fprintf(stderr, "the bridge: unknown order: %s\n", order);
}

static int take_orders(void) {
    static char orders[1024];
    static size_t n;
    const ssize_t got = read(STDIN_FILENO, orders + n, sizeof orders - 1 - n);
    if (got == 0)
        return 0;
    n += got > 0 ? (size_t)got : 0;
    orders[n] = '\0';
    for (char *end; (end = strchr(orders, '\n')) != NULL;) {
        *end = '\0';
        obey(orders);
        n -= (size_t)(end + 1 - orders);
        memmove(orders, end + 1, n + 1);
    }
    return 1;
}

static int64_t wall_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000 + now.tv_nsec / 1000;
}

static void quiet(avr_t *of, const int level, const char *format, va_list arguments) {
    (void)of;
    if (level <= LOG_WARNING)
        vfprintf(stderr, format, arguments);
}

static void open_pty(void) {
    int host;
    struct termios raw;
    memset(&raw, 0, sizeof raw);
    cfmakeraw(&raw);
    if (openpty(&wire_fd, &host, NULL, &raw, NULL) != 0) {
        perror("the bridge: cannot open a pty");
        exit(1);
    }
    fcntl(wire_fd, F_SETFL, O_NONBLOCK);
    fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);
    printf("{\"port\": \"%s\"}\n", ttyname(host));
    fflush(stdout);
}

static void start(const char *image, const char *mcu) {
    for (size_t i = 0; i < sizeof WIRINGS / sizeof *WIRINGS; i++)
        if (strcmp(mcu, WIRINGS[i].mcu) == 0)
            wiring = WIRINGS + i;
    elf_firmware_t firmware;
    memset(&firmware, 0, sizeof firmware);
    avr_global_logger_set(quiet);
    avr = avr_make_mcu_by_name(mcu);
    if (wiring == NULL || avr == NULL || elf_read_firmware(image, &firmware) != 0) {
        fprintf(stderr, "the bridge: cannot run %s on %s\n", image, mcu);
        exit(1);
    }
    /* After power-on the latches and shift registers of the drivers hold arbitrary values: here all ones, the worst. */
    memset(latches, 0xFF, sizeof latches);
    memset(chain, 1, sizeof chain);
    level_of[BLANK] = 1;
    avr_init(avr);
    avr->frequency = MHZ * 1000000;
    avr->log = LOG_WARNING;
    avr_load_firmware(avr, &firmware);
    memset(avr->data + avr->ioend + 1, UNTOUCHED, (size_t)(avr->ramend - avr->ioend));
    reset_core = avr->reset;
    avr->reset = let_go;

    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), byte_sent, NULL);
    static char names[] = "ABD";
    for (char *name = names; *name; name++) {
        const uint32_t port = (uint32_t)AVR_IOCTL_IOPORT_GETIRQ(*name);
        if (avr_io_getirq(avr, port, 0) == NULL)
            continue;
        avr_irq_t *written = avr_io_getirq(avr, port, IOPORT_IRQ_REG_PORT);
        avr_irq_t *directed = avr_io_getirq(avr, port, IOPORT_IRQ_DIRECTION_ALL);
        avr_irq_register_notify(written, port_written, name);
        avr_irq_register_notify(directed, direction_written, name);
        /* simavr suppresses a write of the previous value, even after a reset. */
        written->flags &= (uint8_t)~IRQ_FLAG_FILTERED;
        directed->flags &= (uint8_t)~IRQ_FLAG_FILTERED;
    }
    /* The sensor of the processor at 25 C. */
    avr_irq_t *temperature = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_TEMP);
    if (temperature)
        avr_raise_irq(temperature, 314);
    drive_active();
    settle();
}

int main(int argc, char **argv) {
    stepped = argc == 4 && strcmp(argv[3], "stepped") == 0;
    if (argc != 3 + stepped) {
        fprintf(stderr, "bridge IMAGE.elf atmega328p|atmega2560 [stepped]\n");
        return 2;
    }
    open_pty();
    start(argv[1], argv[2]);
    int64_t began_us = wall_us();
    for (;;) {
        struct pollfd input = {STDIN_FILENO, POLLIN, 0};
        if (stepped) {
            if (poll(&input, 1, -1) > 0 && !take_orders())
                return 0;
            continue;
        }
        if (!run_until(avr->cycle + SLICE_US * MHZ))
            return 1;
        exchange();
        int64_t ahead_us = began_us + (int64_t)(avr->cycle / MHZ) - wall_us();
        /* Time that this computer lost is not made up for: the host must never seem slower than it is. */
        if (ahead_us < -1000) {
            began_us -= ahead_us;
            ahead_us = 0;
        }
        const struct timespec wait = {0, ahead_us > 0 ? (long)ahead_us * 1000 : 0};
        if (ppoll(&input, 1, &wait, NULL) > 0 && !take_orders())
            return 0;
    }
}
