/* Button between PD2 (D2, PCINT18) and ground, with the internal pull-up.
 *
 * The first edge counts and is stamped in its interrupt; for DEBOUNCE_MS afterwards edges are bounce. If the contact
 * rests in the other state when that time is over, its change is reported with the time of that check.
 */
#include "button.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "config.h"

#define RING 8u

typedef struct {
    bool pressed;
    stamp_t when;
} edge_t;

static volatile edge_t ring[RING];
static volatile uint8_t head, tail;
static volatile bool reported;
static volatile uint32_t locked_since;
static volatile bool locked;

bool button_closed(void)
{
    return (PIND & _BV(PD2)) == 0;
}

void button_init(void)
{
    DDRD &= (uint8_t)~_BV(PD2);
    PORTD |= _BV(PD2);
    PCMSK2 = _BV(PCINT18); /* the only pin of its port that is watched; both edges */
    PCIFR = _BV(PCIF2);
    PCICR = _BV(PCIE2);
}

static void report(bool pressed, stamp_t when)
{
    uint8_t next = (head + 1) % RING;
    reported = pressed;
    locked = true;
    locked_since = when.ms;
    if (next == tail)
        return; /* eight unread edges within one pass of the main loop do not happen: each locks for 8 ms */
    ring[head].pressed = pressed;
    ring[head].when = when;
    head = next;
}

ISR(PCINT2_vect)
{
    stamp_t now = clock_now_locked();
    if (locked && now.ms - locked_since < DEBOUNCE_MS)
        return;
    /* an edge after rest is a change, even where the contact has bounced back already */
    report(!reported, now);
}

static void settle(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        stamp_t now = clock_now_locked();
        if (locked && now.ms - locked_since >= DEBOUNCE_MS) {
            locked = false;
            if (button_closed() != reported)
                report(!reported, now);
        }
    }
}

bool button_take(bool *pressed, stamp_t *when)
{
    bool any = false;
    settle();
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (head != tail) {
            *pressed = ring[tail].pressed;
            *when = ring[tail].when;
            tail = (tail + 1) % RING;
            any = true;
        }
    }
    return any;
}

bool button_pressed(void)
{
    return reported;
}
