// The board on a bare atmega328p or atmega2560 at 16 MHz: serial line, clock, pins, and two daisy-chained TLC5947.

#include "board.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "firmware.h"
#include "pins.h"

#if F_CPU != 16000000
#error "the clock and the serial line require 16 MHz"
#endif

#if defined(__AVR_ATmega2560__)
#define RECEIVED_vect USART0_RX_vect
#else
#define RECEIVED_vect USART_RX_vect
#endif

#define UP(name) (name##_PORT |= _BV(name##_BIT))
#define DOWN(name) (name##_PORT &= static_cast<uint8_t>(~_BV(name##_BIT)))
#define OUTPUT(name) (name##_DDR |= _BV(name##_BIT))

static const uint8_t RING = 128;
static volatile uint8_t ring[RING];
static volatile uint8_t ring_in;
static volatile uint8_t ring_out;

// The clock at the last overflow of timer 1, which counts half microseconds.
static volatile uint32_t overflow_us;

ISR(RECEIVED_vect) {
    const uint8_t byte = UDR0;
    const uint8_t next = (ring_in + 1) % RING;
    // If the ring is full, the byte is lost; the line's checksum is then wrong.
    if (next != ring_out) {
        ring[ring_in] = byte;
        ring_in = next;
    }
}

ISR(TIMER1_OVF_vect) { overflow_us += 0x8000; }

uint32_t board_now_us() {
    uint32_t base;
    uint16_t half;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        base = overflow_us;
        half = TCNT1;
        // The timer has just overflowed, and its interrupt is still pending.
        if ((TIFR1 & _BV(TOV1)) && half < 0x8000)
            base += 0x8000;
    }
    return base + (half >> 1);
}

int16_t board_get() {
    if (ring_in == ring_out)
        return -1;
    const uint8_t byte = ring[ring_out];
    ring_out = (ring_out + 1) % RING;
    return byte;
}

bool board_put(uint8_t byte) {
    if (!(UCSR0A & _BV(UDRE0)))
        return false;
    UDR0 = byte;
    return true;
}

void board_shift(uint16_t level) {
    // In software, because the 8-bit frames of the hardware do not fit a single 12-bit channel. Highest bit first.
    for (uint16_t bit = 0x800; bit != 0; bit >>= 1) {
        if (level & bit)
            UP(SIN);
        else
            DOWN(SIN);
        UP(SCLK);
        DOWN(SCLK);
    }
}

static void latch() {
    UP(XLAT);
    DOWN(XLAT);
}

void board_light() {
    // Dark while the latch changes: the release of BLANK restarts the drivers' brightness period.
    UP(BLANK);
    latch();
    DOWN(BLANK);
}

void board_dark() { UP(BLANK); }

void board_trigger(bool up) {
    if (up)
        UP(TRIGGER);
    else
        DOWN(TRIGGER);
}

bool board_active() { return ACTIVE_PIN & _BV(ACTIVE_BIT); }

uint16_t board_temperature_dk() {
#if defined(__AVR_ATmega328P__)
    // The sensor in the processor gives 314 mV at 25 C and about 1 mV per kelvin, within 10 K; full scale is 1.1 V.
    // Before the first conversion the reading is 0.
    const uint16_t reading = ADC;
    if (reading == 0)
        return 0;
    const int16_t tenth_mv = static_cast<int16_t>(reading * 11000UL / 1024);
    const int16_t dk = static_cast<int16_t>(2982 - 3140 + tenth_mv);
    return dk > 0 ? static_cast<uint16_t>(dk) : 0;
#else
    return 0;
#endif
}

void board_alive() { wdt_reset(); }

// After a watchdog reset the watchdog runs with its shortest time: stop it before anything slow.
extern "C" void stop_watchdog() __attribute__((naked, used, section(".init3")));
extern "C" void stop_watchdog() {
    MCUSR = 0;
    wdt_disable();
}

static void start_pins() {
    // High before it is an output, so that the LEDs stay off without a gap.
    UP(BLANK);
    OUTPUT(BLANK);
    OUTPUT(TRIGGER);
    OUTPUT(SIN);
    OUTPUT(SCLK);
    OUTPUT(XLAT);
    // After power-on the drivers' latches hold arbitrary values.
    for (uint8_t channel = 0; channel < BOARD_CHANNELS; channel++)
        board_shift(0);
    latch();
}

static void start_serial() {
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UBRR0 = 16;  // 117647 baud, 2.1 % above 115200
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

static void start_clock() {
    TCCR1B = _BV(CS11);
    TIMSK1 = _BV(TOIE1);
}

static void start_thermometer() {
#if defined(__AVR_ATmega328P__)
    ADMUX = _BV(REFS1) | _BV(REFS0) | _BV(MUX3);
    // Free-running conversion at 125 kHz.
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADATE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
#endif
}

int main() {
    start_pins();
    start_serial();
    start_clock();
    start_thermometer();
    sei();
    wdt_enable(WDTO_120MS);
    firmware_start();
    for (;;)
        firmware_loop();
}
