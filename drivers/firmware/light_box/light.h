/* What each channel is doing: steady, ramp, pulse or blink, timed by the box; and when it must go dark. */
#ifndef LIGHT_H
#define LIGHT_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint8_t channel;
    uint8_t range;
    uint16_t level;
    uint32_t on_ms; /* length of a pulse, of a blink's bright phase or of a ramp */
    uint32_t off_ms;
    uint16_t count; /* blinks; 0: until the next command */
} stimulus_t;

typedef struct {
    char mode; /* O off, S steady, R ramp, P pulse, B blink */
    uint8_t range;
    uint16_t level; /* driven at this moment */
    uint32_t bucket;
} channel_state_t;

void light_init(void);
/* Fills the buckets, empty till then, from the EEPROM; takes 7 ms, with interrupts on. */
void light_remember(void);
/* Each returns 0 or an error code of protocol.h; on an error the channel is left as it was. */
uint8_t light_steady(const stimulus_t *stimulus);
uint8_t light_ramp(const stimulus_t *stimulus);
uint8_t light_pulse(const stimulus_t *stimulus);
uint8_t light_blink(const stimulus_t *stimulus);
void light_off(uint8_t channel);
void light_all_off(void);
channel_state_t light_state(uint8_t channel);

/* The host has been heard. */
void light_feed_deadman(void);
/* Fires the photographic flash; 0 or an error code. */
uint8_t light_flash(void);
/* Flashes that may still be fired in a row, and ms until the next one may. */
void light_flash_state(uint8_t *left, uint16_t *wait_ms);
/* Returns and clears the reason for which the box itself went dark: bit n: bucket of channel n empty, bit 6: button held,
 * bit 7: dead man. */
uint8_t light_take_darkened(void);
/* Keeps in the EEPROM what a reset must not forget; called by the main loop. */
void light_keep(void);
/* One millisecond has passed; called by the clock's interrupt. */
void light_tick(void);

#endif
