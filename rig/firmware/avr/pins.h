// Pin assignment. docs/build-the-rig.md has the wiring.
#ifndef SGP_PINS_H
#define SGP_PINS_H

#include <avr/io.h>

// All but ACTIVE are outputs. Use only ports A to G, where one instruction sets a bit.
#if defined(__AVR_ATmega328P__)  // Uno: D4 to D9
#define SIN_PORT PORTD
#define SIN_DDR DDRD
#define SIN_BIT 4
#define SCLK_PORT PORTD
#define SCLK_DDR DDRD
#define SCLK_BIT 5
#define XLAT_PORT PORTD
#define XLAT_DDR DDRD
#define XLAT_BIT 6
#define BLANK_PORT PORTD
#define BLANK_DDR DDRD
#define BLANK_BIT 7
#define TRIGGER_PORT PORTB
#define TRIGGER_DDR DDRB
#define TRIGGER_BIT 0
#define ACTIVE_PIN PINB
#define ACTIVE_BIT 1
#elif defined(__AVR_ATmega2560__)  // Mega: D22 to D27
#define SIN_PORT PORTA
#define SIN_DDR DDRA
#define SIN_BIT 0
#define SCLK_PORT PORTA
#define SCLK_DDR DDRA
#define SCLK_BIT 1
#define XLAT_PORT PORTA
#define XLAT_DDR DDRA
#define XLAT_BIT 2
#define BLANK_PORT PORTA
#define BLANK_DDR DDRA
#define BLANK_BIT 3
#define TRIGGER_PORT PORTA
#define TRIGGER_DDR DDRA
#define TRIGGER_BIT 4
#define ACTIVE_PIN PINA
#define ACTIVE_BIT 5
#else
#error "no pins are defined for this processor"
#endif

#endif
