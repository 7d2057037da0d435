/* What a reset must not forget: how much light each channel has certainly left, and how many flashes. In EEPROM. */
#ifndef MEMORY_H
#define MEMORY_H

#include <stdint.h>

#include "config.h"

/* A full bucket is this many parts; one more value than parts, for the full one itself. */
#define PARTS 64

typedef struct {
    uint8_t parts[CHANNELS]; /* of the channel's bucket that are certainly left */
    uint8_t flashes;
} allowance_t;

/* Reads the latest record; nothing is left where there is none. */
void memory_read(allowance_t *allowance);
/* Returns when the record is written: 7 ms for one byte that differs, 37 ms at most. Not from an interrupt. */
void memory_write(const allowance_t *allowance);

#endif
