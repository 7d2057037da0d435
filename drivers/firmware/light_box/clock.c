#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "light.h"

static volatile uint32_t milliseconds;

void clock_init(void)
{
    TCCR0A = _BV(WGM01); /* count to OCR0A, then start over */
    OCR0A = TICKS_PER_MS - 1;
    TCNT0 = 0;
    TIMSK0 = _BV(OCIE0A);
    TCCR0B = _BV(CS01) | _BV(CS00); /* 16 MHz / 64: 4 us per tick */
}

ISR(TIMER0_COMPA_vect)
{
    milliseconds++;
    light_tick();
}

stamp_t clock_now_locked(void)
{
    stamp_t now;
    now.ticks = TCNT0;
    now.ms = milliseconds;
    if (TIFR0 & _BV(OCF0A)) { /* the millisecond turned over but its handler has not run yet */
        now.ticks = TCNT0;
        now.ms++;
    }
    return now;
}

stamp_t clock_now(void)
{
    stamp_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = clock_now_locked(); }
    return now;
}

uint32_t clock_ms(void)
{
    uint32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = milliseconds; }
    return now;
}
