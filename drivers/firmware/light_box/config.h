/* What this build of the light box is: clocks, pins, channels and the limits the box itself enforces.
 *
 * The limits are compiled in on purpose: no command can change them.
 */
#ifndef CONFIG_H
#define CONFIG_H

#include <stdint.h>

#define PROTOCOL_VERSION 2 /* version 1 is spoken too, with its four channels */
#define FIRMWARE_VERSION "2.1"
#define BOX_KIND "radiometer-light-box"

#define BAUD_RATE 115200UL

/* Silence of the host after which every channel goes dark, in ms. */
#define DEADMAN_MS 1000

/* Edges closer than this to an accepted one are contact bounce, in ms. */
#define DEBOUNCE_MS 8

/* The button held this long turns every light off, in ms. */
#define HELD_OFF_MS 3000

#define LONGEST_MS 600000UL  /* longest pulse or ramp */
#define LONGEST_BLINK_MS 60000UL /* longest on or off phase of a blink */

/* The photographic flash: width of its trigger, least time between two, how many in a row, and after which time one more. */
#define FLASH_TRIGGER_MS 10
#define FLASH_GAP_MS 5000
#ifndef FLASHES_IN_A_ROW
#define FLASHES_IN_A_ROW 8
#endif
#if FLASHES_IN_A_ROW > 8
#error "fewer flashes may be allowed, not more"
#endif
#define FLASH_REFILL_MS 75000UL /* all eight in ten minutes */

enum { BLEACH, SPOT, SPOT_RED, FIXATION, SPOT_GREEN, FIELD, CHANNELS };
#define CHANNELS_OF_VERSION_1 4

#define LOW_RANGE 0
#define HIGH_RANGE 1

/* Timer 1 makes the test spots: 16 MHz / 1024 = 15.6 kHz, eight periods dithered: 8192 steps, repeating at 1.95 kHz. */
#define SPOT_STEPS 8192
/* Timer 2 makes bleach and fixation: 16 MHz / 8 / 256 = 7.8 kHz, four periods dithered: 1024 steps, at 1.95 kHz too. */
#define AREA_STEPS 1024
#define PWM_HZ 1953 /* the lowest frequency in the light of any channel */

/* The energy bucket of a channel counts (level / 256 + 1) per ms in the high range and 1 per ms in the low range. */
struct channel_limits {
    const char *name;
    uint16_t peak_nm; /* 0: white */
    uint16_t steps;   /* duty steps that a level is rounded to */
    uint16_t limit[2]; /* highest level in the low and in the high range */
    uint32_t bucket;   /* energy units that a full bucket holds */
    uint16_t refill;   /* energy units gained in each dark ms */
};

#endif
