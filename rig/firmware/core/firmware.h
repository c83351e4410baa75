// The firmware of the LED board (docs/serial-protocol.md) without the board: see board.h.
#ifndef SGP_FIRMWARE_H
#define SGP_FIRMWARE_H

#include <stdint.h>

// After power-on and after a reset.
void firmware_start();

// To be called for ever. Takes what bytes there are, up to one command.
void firmware_loop();

#endif
