// Timing of LEDs and trigger: which LED is on, until when, and what turns it off.
#ifndef SGP_LIGHT_H
#define SGP_LIGHT_H

#include <stdint.h>

#include "steps.h"

namespace light {

const uint32_t MAX_HOLD_MS = 60000;
const uint32_t WATCHDOG_MS = 900;
const uint16_t FULL = 4095;
const uint32_t NO_PULSE = 0xFFFFFFFF;

enum State : uint8_t { IDLE, ON, FLASH, RUN, HALT };
enum Pace : uint8_t { BY_TIME, BY_EXPOSURE };

void start();

// Do what is due. To call very often, also during other work.
void poll();

// Microseconds in which poll() has nothing to do, according to the clock alone.
uint32_t spare_us();

// Report that a complete line arrived from the host.
void heard();

State state();
uint8_t led();   // the LED that is on now, or NO_LED
uint8_t done();  // number of steps of the running or last sequence that have ended
uint32_t trips();
uint32_t uptime_ms();
uint32_t since_pulse_us();  // time from the last but one trigger pulse to the last, or NO_PULSE

void set_level(uint8_t led, uint16_t level);

void on(uint8_t led, uint32_t hold_ms);
uint8_t off();  // the LED that was on until now
void flash(uint8_t led, uint32_t settle_us, uint32_t hold_us);
void run(uint8_t count, Pace pace);
void end_halt();  // HALT becomes IDLE

// True once after a flash ended by itself; `last_burn` then has its report.
bool flash_ended();
const Burn &last_burn();

}  // namespace light

#endif
