/* The box's own time: milliseconds since power-on and 4 microsecond ticks within the millisecond. */
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

#define TICKS_PER_MS 250
#define US_PER_TICK 4

typedef struct {
    uint32_t ms;
    uint8_t ticks; /* 0..249, 4 us each */
} stamp_t;

void clock_init(void);
/* The time now; call with interrupts off (from a handler or an atomic block). */
stamp_t clock_now_locked(void);
stamp_t clock_now(void);
uint32_t clock_ms(void);

#endif
