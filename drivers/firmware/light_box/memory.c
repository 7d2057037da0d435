#include "memory.h"

#include <avr/eeprom.h>
#include <stdbool.h>
#include <string.h>

#include "text.h"

/* Records go round a ring, so that each cell is written once in a hundred: an ATmega328P bears 100 000 writes of a cell,
 * hence ten million records. A bleach from full to empty and back takes about eighty. */
#define FIRST 16u /* behind the serial number */
#define SLOTS 100u
#define BLANK 0xFF

typedef struct {
    uint8_t number; /* counts up and wraps: of all in the ring the latest is ahead of the others by less than half */
    allowance_t allowance;
    uint16_t check;
} record_t;

static uint8_t slot; /* of the latest record */
static uint8_t number;

static void *address(uint8_t at)
{
    return (void *)(uintptr_t)(FIRST + at * sizeof(record_t));
}

static uint16_t check_of(const record_t *record)
{
    return (uint16_t)crc32((const char *)record, sizeof record->number + sizeof record->allowance);
}

static bool read_slot(uint8_t at, record_t *record)
{
    eeprom_read_block(record, address(at), sizeof *record);
    return record->check == check_of(record);
}

static bool is_blank(uint8_t at)
{
    record_t record;
    const uint8_t *bytes = (const uint8_t *)&record;
    eeprom_read_block(&record, address(at), sizeof record);
    for (uint8_t n = 0; n < sizeof record; n++)
        if (bytes[n] != BLANK)
            return false;
    return true;
}

void memory_read(allowance_t *allowance)
{
    record_t record;
    bool found = false;
    memset(allowance, 0, sizeof *allowance);
    slot = SLOTS - 1;
    number = 0;
    for (uint8_t at = 0; at < SLOTS; at++) {
        if (read_slot(at, &record) && (!found || (int8_t)(record.number - number) > 0)) {
            found = true;
            slot = at;
            number = record.number;
            *allowance = record.allowance;
        }
    }
    /* The slot ahead is cut off where power failed during its writing; nothing was spent on it. Were it the latest one
     * and worn out, at most two parts and a flash would have been spent. */
    if (found && !is_blank((slot + 1) % SLOTS) && !read_slot((slot + 1) % SLOTS, &record)) {
        for (uint8_t n = 0; n < CHANNELS; n++)
            allowance->parts[n] = allowance->parts[n] > 2 ? allowance->parts[n] - 2 : 0;
        allowance->flashes = allowance->flashes ? allowance->flashes - 1 : 0;
    }
    for (uint8_t n = 0; n < CHANNELS; n++)
        if (allowance->parts[n] > PARTS)
            allowance->parts[n] = 0;
    if (allowance->flashes > FLASHES_IN_A_ROW)
        allowance->flashes = FLASHES_IN_A_ROW;
}

void memory_write(const allowance_t *allowance)
{
    record_t record = {.number = ++number, .allowance = *allowance};
    record.check = check_of(&record);
    slot = (slot + 1) % SLOTS;
    eeprom_update_block(&record, address(slot), sizeof record);
    eeprom_busy_wait();
}
