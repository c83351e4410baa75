// What the core needs of a board. Each board defines these functions; they are joined at link time.
//
#ifndef SGP_BOARD_H
#define SGP_BOARD_H

#include <stdint.h>

// Steps that a sequence may have, at most 64: more would outlast the clock. 21 bytes of RAM each.
#ifndef BOARD_STEPS
#ifdef ARDUINO
#define BOARD_STEPS 40
#else
#define BOARD_STEPS 48
#endif
#endif

// An edge this close is waited for and nothing else done: longer than any work between two calls of light::poll().
#ifndef BOARD_SPIN_US
#ifdef ARDUINO
#define BOARD_SPIN_US 300
#else
#define BOARD_SPIN_US 150
#endif
#endif

const uint8_t BOARD_LEDS = 36;
const uint8_t BOARD_CHANNELS = 48;  // two TLC5947 of 24 channels; LED n sits on channel n

// Microseconds since the start; wraps at 2^32.
uint32_t board_now_us();

// The next byte from the host, or -1.
int16_t board_get();

// Hand one byte to the host; false where there is no room for it now.
bool board_put(uint8_t byte);

// Shift the brightness (0 to 4095) of one channel into the drivers; channel 47 goes first. What burns does not change.
void board_shift(uint16_t level);

// Take over what was shifted in and let it burn.
void board_light();

// Everything dark, at once.
void board_dark();

// The trigger output.
void board_trigger(bool up);

// The camera's exposure-active input.
bool board_active();

// Tenths of a kelvin, 0 where it is not known.
uint16_t board_temperature_dk();

// The program is alive: hold off the watchdog of the processor.
void board_alive();

#endif
