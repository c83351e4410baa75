// The functions that the core requires of a board. Each board defines them; the linker resolves them.
//
#ifndef SGP_BOARD_H
#define SGP_BOARD_H

#include <stdint.h>

// Maximum number of steps of a sequence, at most 64 because more could outlast the clock. 21 bytes of RAM each.
#ifndef BOARD_STEPS
#ifdef ARDUINO
#define BOARD_STEPS 40
#else
#define BOARD_STEPS 48
#endif
#endif

// When the next edge is closer than this, the firmware only waits for it. Longer than any work between two calls of
// light::poll().
#ifndef BOARD_SPIN_US
#ifdef ARDUINO
#define BOARD_SPIN_US 300
#else
#define BOARD_SPIN_US 150
#endif
#endif

const uint8_t BOARD_LEDS = 36;
const uint8_t BOARD_CHANNELS = 48;  // two TLC5947 of 24 channels; LED n is on channel n

// Microseconds since the start; wraps at 2^32.
uint32_t board_now_us();

// The next byte from the host, or -1.
int16_t board_get();

// Send one byte to the host; false if there is no room for it now.
bool board_put(uint8_t byte);

// Shift the brightness (0 to 4095) of one channel into the drivers, beginning with channel 47. The LEDs do not change.
void board_shift(uint16_t level);

// Latch the shifted pattern and turn its LEDs on.
void board_light();

// Turn all LEDs off immediately.
void board_dark();

// The trigger output.
void board_trigger(bool up);

// The camera's exposure-active input.
bool board_active();

// Temperature in tenths of a kelvin, 0 if it is not known.
uint16_t board_temperature_dk();

// Reset the watchdog of the processor: the program is alive.
void board_alive();

#endif
