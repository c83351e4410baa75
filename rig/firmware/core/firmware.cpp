#include "firmware.h"

#include "board.h"
#include "commands.h"
#include "light.h"
#include "line.h"

static_assert(BOARD_STEPS > 0 && BOARD_STEPS <= 64, "the 32-bit clock covers at most 64 steps of 61 s");
static_assert(BOARD_LEDS <= BOARD_CHANNELS, "every LED needs a channel");

void firmware_start() {
    light::start();
    line::start();
    commands::start();
}

void firmware_loop() {
    board_alive();
    light::poll();
    for (int16_t byte = board_get(); byte >= 0; byte = board_get()) {
        if (line::take(static_cast<uint8_t>(byte))) {
            commands::handle();
            break;
        }
        light::poll();
    }
    if (light::flash_ended())
        commands::report_flash();
}
