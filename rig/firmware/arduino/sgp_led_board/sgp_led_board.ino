// The LED board's firmware as an Arduino sketch. `make arduino` in rig/firmware creates the folder; docs/build-the-rig.md
// has the wiring. The bare image of rig/firmware/avr is smaller and its edges are more precise; the sketch is for
// users who have only the IDE, or another board of the Arduino family.

#include "src/board.h"
#include "src/firmware.h"

#if defined(__AVR_ATmega328P__)
#include <avr/wdt.h>
#endif

#if defined(__AVR_ATmega2560__)
static const uint8_t SIN = 22, SCLK = 23, XLAT = 24, BLANK = 25, TRIGGER = 26, ACTIVE = 27;
#else
static const uint8_t SIN = 4, SCLK = 5, XLAT = 6, BLANK = 7, TRIGGER = 8, ACTIVE = 9;
#endif

// digitalWrite takes 4 us; a pattern of 576 bits needs 1200 writes.
struct Output {
    volatile uint8_t *port;
    uint8_t mask;
    void start(uint8_t pin) {
        port = portOutputRegister(digitalPinToPort(pin));
        mask = digitalPinToBitMask(pin);
    }
    void high() const { *port |= mask; }
    void low() const { *port &= static_cast<uint8_t>(~mask); }
};

static Output sin_out, sclk_out, xlat_out, blank_out, trigger_out;

uint32_t board_now_us() { return micros(); }

int16_t board_get() { return static_cast<int16_t>(Serial.read()); }

bool board_put(uint8_t byte) { return Serial.availableForWrite() > 0 && Serial.write(byte) == 1; }

void board_shift(uint16_t level) {
    for (uint16_t bit = 0x800; bit != 0; bit >>= 1) {
        if (level & bit)
            sin_out.high();
        else
            sin_out.low();
        sclk_out.high();
        sclk_out.low();
    }
}

void board_light() {
    blank_out.high();
    xlat_out.high();
    xlat_out.low();
    blank_out.low();
}

void board_dark() { blank_out.high(); }

void board_trigger(bool up) {
    if (up)
        trigger_out.high();
    else
        trigger_out.low();
}

bool board_active() { return digitalRead(ACTIVE) == HIGH; }

uint16_t board_temperature_dk() { return 0; }

void board_alive() {
#if defined(__AVR_ATmega328P__)
    wdt_reset();
#endif
}

void setup() {
    // High before it is an output, so that the LEDs stay off without a gap.
    digitalWrite(BLANK, HIGH);
    static const uint8_t OUTPUTS[] = {BLANK, TRIGGER, SIN, SCLK, XLAT};
    for (const uint8_t pin : OUTPUTS)
        pinMode(pin, OUTPUT);
    pinMode(ACTIVE, INPUT);
    sin_out.start(SIN);
    sclk_out.start(SCLK);
    xlat_out.start(XLAT);
    blank_out.start(BLANK);
    trigger_out.start(TRIGGER);
    // After power-on the drivers' latches hold arbitrary values.
    for (uint8_t channel = 0; channel < BOARD_CHANNELS; channel++)
        board_shift(0);
    xlat_out.high();
    xlat_out.low();
    Serial.begin(115200);
    firmware_start();
#if defined(__AVR_ATmega328P__)
    // Boot loaders of some Megas hang after a reset by the watchdog; the Uno's does not.
    wdt_enable(WDTO_120MS);
#endif
}

void loop() { firmware_loop(); }
