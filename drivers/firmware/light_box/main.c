/* Light box: LED channels, a button and a serial line on an ATmega328P at 16 MHz. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "button.h"
#include "clock.h"
#include "light.h"
#include "protocol.h"
#include "sensors.h"
#include "uart.h"

static uint8_t reset_flags __attribute__((section(".noinit")));

/* Before anything else: after a watchdog reset the watchdog still runs with its shortest time. */
void stop_watchdog(void) __attribute__((naked, used, section(".init3")));
void stop_watchdog(void)
{
    reset_flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

int main(void)
{
    light_init();
    clock_init();
    uart_init();
    button_init();
    sensors_init();
    wdt_enable(WDTO_250MS);
    sei();
    protocol_init(reset_flags);
    light_remember();
    set_sleep_mode(SLEEP_MODE_IDLE);
    for (;;) {
        wdt_reset();
        protocol_poll();
        sensors_poll();
        sleep_mode(); /* until the next interrupt, at most a millisecond away */
    }
}
