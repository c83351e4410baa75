// The firmware of the LED board (docs/serial-protocol.md), independent of the board: see board.h.
#ifndef SGP_FIRMWARE_H
#define SGP_FIRMWARE_H

#include <stdint.h>

// To call after power-on and after a reset.
void firmware_start();

// To call in an endless loop. Reads the available bytes, up to one command.
void firmware_loop();

#endif
