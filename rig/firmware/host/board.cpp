// The board as a Linux program behind a pty.
//
// It prints {"port": PATH} and then a line when the set of LEDs that are on, or the trigger line, changes:
// {"us": T, "lit": [LED, ...], "levels": [BRIGHTNESS, ...]} and {"us": T, "trigger": 0 or 1}. On its standard input it
// accepts the lines `active 0`, `active 1` (the exposure-active input) and `reset`, and it ends when that is closed.
//
// `board-host stepped` has its own clock, which stops between orders. The order `step BYTES US` waits until this number
// of bytes has arrived at the port, passes them to the board at the speed of the serial line, continues until the
// clock shows US, and prints {"us": T, "stepped": BYTES} with the number of bytes that the board has sent. The order
// `burst BYTES US` passes all bytes at once, as a pty does.

#include "board.h"

#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "firmware.h"
#include "light.h"

namespace {

int wire;  // the board's end of the pty
std::string received;
std::string replies;
std::string events;
std::string orders;
std::string lit = "none yet";
uint16_t shifted[BOARD_CHANNELS];
bool trigger;
bool exposing;
uint64_t started_us;
bool stepped;
// Close to the overflow, so that the 32-bit clock wraps during the run.
uint64_t stepped_us = (uint64_t{1} << 32) - 60 * 1000000;
const uint64_t BYTE_US = 94;

uint64_t clock_us() {
    // The core waits for edges by reading the clock, so every reading must take a microsecond.
    if (stepped)
        return stepped_us++;
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<uint64_t>(now.tv_sec) * 1000000 + static_cast<uint64_t>(now.tv_nsec) / 1000;
}

void report(const std::string &what) {
    events += "{\"us\": " + std::to_string(clock_us() - started_us) + ", " + what + "}\n";
}

void report_lit(const uint16_t *channels) {
    std::string leds, levels;
    for (int channel = 0; channels != nullptr && channel < BOARD_CHANNELS; channel++) {
        if (channels[channel] == 0)
            continue;
        leds += (leds.empty() ? "" : ", ") + std::to_string(channel);
        levels += (levels.empty() ? "" : ", ") + std::to_string(channels[channel]);
    }
    const std::string now = "\"lit\": [" + leds + "], \"levels\": [" + levels + "]";
    if (now != lit)
        report(now);
    lit = now;
}

[[noreturn]] void fail(const char *what) {
    std::fprintf(stderr, "the host board: %s: %s\n", what, std::strerror(errno));
    std::exit(1);
}

// Write as much as the other side accepts now; keep the rest.
void flush(int to, std::string *text) {
    while (!text->empty()) {
        const ssize_t n = write(to, text->data(), text->size());
        if (n <= 0)
            return;
        text->erase(0, static_cast<size_t>(n));
    }
}

// Restart as after power-on: all LEDs are off, and the board's memory and pending bytes are lost.
void reset() {
    char lost[256];
    while (read(wire, lost, sizeof lost) > 0) {
    }
    received.clear();
    replies.clear();
    std::memset(shifted, 0, sizeof shifted);
    firmware_start();
}

void take_bytes() {
    char chunk[256];
    const ssize_t n = read(wire, chunk, sizeof chunk);
    if (n > 0)
        received.append(chunk, static_cast<size_t>(n));
}

// Advance the stepped clock, and run the firmware each time it has something to do.
void pass(uint64_t until_us) {
    firmware_loop();
    while (stepped_us < until_us) {
        // In short steps, because the core reads the clock once for each millisecond that it catches up.
        const uint64_t left_us = until_us - stepped_us < 20000 ? until_us - stepped_us : 20000;
        const uint64_t spare_us = received.empty() ? light::spare_us() : 0;
        stepped_us += spare_us < left_us ? spare_us : left_us;
        firmware_loop();
    }
}

void step(size_t bytes, uint64_t until_us, uint64_t byte_us) {
    pollfd end = {wire, POLLIN, 0};
    while (received.size() < bytes && ::poll(&end, 1, -1) >= 0)
        take_bytes();
    const std::string line = received;
    received.clear();
    uint64_t arrives_us = stepped_us;
    for (const char byte : line) {
        arrives_us += byte_us;
        pass(arrives_us);
        received += byte;
    }
    pass(started_us + until_us);
    events += "{\"us\": " + std::to_string(stepped_us - started_us) + ", \"stepped\": " + std::to_string(replies.size()) +
              "}\n";
    while (!replies.empty() || !events.empty()) {
        flush(wire, &replies);
        flush(STDOUT_FILENO, &events);
    }
}

void obey(const std::string &order) {
    size_t bytes;
    unsigned long long until_us;
    if (order == "active 1" || order == "active 0")
        exposing = order.back() == '1';
    else if (order == "reset")
        reset();
    else if (stepped && std::sscanf(order.c_str(), "step %zu %llu", &bytes, &until_us) == 2)
        step(bytes, until_us, BYTE_US);
    else if (stepped && std::sscanf(order.c_str(), "burst %zu %llu", &bytes, &until_us) == 2)
        step(bytes, until_us, 0);
    else
        std::fprintf(stderr, "the host board: unknown order: %s\n", order.c_str());
}

// False if no more orders can arrive.
bool take_orders() {
    char chunk[256];
    const ssize_t n = read(STDIN_FILENO, chunk, sizeof chunk);
    if (n == 0)
        return false;
    if (n > 0)
        orders.append(chunk, static_cast<size_t>(n));
    for (size_t end; (end = orders.find('\n')) != std::string::npos; orders.erase(0, end + 1)) {
        obey(orders.substr(0, end));
        firmware_loop();
    }
    return true;
}

int open_pty() {
    int board, host;
    termios raw;
    std::memset(&raw, 0, sizeof raw);
    cfmakeraw(&raw);
    // The host's end also stays open here, so that the board does not end when a host closes the port.
    if (openpty(&board, &host, nullptr, &raw, nullptr) != 0)
        fail("cannot open a pty");
    fcntl(board, F_SETFL, O_NONBLOCK);
    std::printf("{\"port\": \"%s\"}\n", ttyname(host));
    std::fflush(stdout);
    return board;
}

}  // namespace

uint32_t board_now_us() { return static_cast<uint32_t>(clock_us()); }

int16_t board_get() {
    if (received.empty())
        return -1;
    const uint8_t byte = static_cast<uint8_t>(received[0]);
    received.erase(0, 1);
    return byte;
}

bool board_put(uint8_t byte) {
    replies += static_cast<char>(byte);
    return true;
}

void board_shift(uint16_t level) {
    std::memmove(shifted + 1, shifted, sizeof shifted - sizeof *shifted);
    shifted[0] = level;
}

void board_light() { report_lit(shifted); }

void board_dark() { report_lit(nullptr); }

void board_trigger(bool up) {
    if (up != trigger)
        report(std::string("\"trigger\": ") + (up ? "1" : "0"));
    trigger = up;
}

bool board_active() { return exposing; }

uint16_t board_temperature_dk() { return 0; }

void board_alive() {}

int main(int argc, char **argv) {
    stepped = argc > 1 && std::strcmp(argv[1], "stepped") == 0;
    started_us = clock_us();
    wire = open_pty();
    fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);
    fcntl(STDOUT_FILENO, F_SETFL, O_NONBLOCK);
    firmware_start();
    pollfd input = {STDIN_FILENO, POLLIN, 0};
    while (stepped && ::poll(&input, 1, -1) >= 0)
        if (!take_orders())
            return 0;
    for (;;) {
        firmware_loop();
        const uint32_t spare_us = received.empty() ? light::spare_us() : 0;
        // Printing takes longer than an edge may be late.
        if (spare_us > 0) {
            flush(wire, &replies);
            // If the host does not read and the line is full, bytes are lost, as on a wire.
            replies.clear();
            flush(STDOUT_FILENO, &events);
        }
        pollfd ends[] = {{STDIN_FILENO, POLLIN, 0}, {wire, POLLIN, 0}};
        const uint32_t wait_us = spare_us < 100000 ? spare_us : 100000;
        const timespec wait = {0, static_cast<long>(wait_us) * 1000};
        if (ppoll(ends, 2, &wait, nullptr) < 0 && errno != EINTR)
            fail("cannot wait");
        if (ends[0].revents != 0 && !take_orders())
            return 0;
        if (ends[1].revents != 0)
            take_bytes();
    }
}
