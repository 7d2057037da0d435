/* Lines in, lines out: see docs/reference/light-box-protocol.md. */
#ifndef PROTOCOL_H
#define PROTOCOL_H

#include <stdint.h>

enum {
    ERROR_FRAME = 1,        /* checksum wrong, line too long or not of the form */
    ERROR_VERB = 2,         /* no such command */
    ERROR_ARGUMENTS = 3,    /* wrong number or form of arguments, or out of the range that any channel has */
    ERROR_CHANNEL = 4,      /* no such channel */
    ERROR_LEVEL = 5,        /* level above the channel's limit */
    ERROR_ENERGY = 6,       /* more energy than the channel's bucket holds now */
    ERROR_SESSION = 7,      /* light was asked for without a session: say HI first */
    ERROR_RANGE_CHANGE = 8, /* a ramp cannot change the current range */
    ERROR_VERSION = 9,      /* this box does not speak that version */
    ERROR_EVENT = 10,       /* that event is no longer kept */
    ERROR_SHARED = 11,      /* the channel that shares its output is lit */
    ERROR_HELD = 12         /* the button is held: every light stays off */
};

void protocol_init(uint8_t reset_cause);
/* Takes what has arrived, answers it, and reports what has happened; never waits for input. */
void protocol_poll(void);

#endif
