#include "limits.h"

/* A bucket of S seconds at level 60000 (235 units per ms) refills in ten minutes of darkness.
 * bleach: 200 s; field: 300 s; test spots and fixation: 3600 s, which a forty-minute test does not reach.
 * BUCKET_DIVISOR above 1 makes every bucket smaller, so that a test need not wait for it; it can make none larger. */
#ifndef BUCKET_DIVISOR
#define BUCKET_DIVISOR 1UL
#endif
#if BUCKET_DIVISOR < 1
#error "a bucket may be made smaller only"
#endif
#define UNITS(full) ((full) / BUCKET_DIVISOR)

const struct channel_limits channel_limits[CHANNELS] = {
    [BLEACH] = {"bleach", 0, AREA_STEPS, {65535, 60000}, UNITS(47000000UL), 78},
    [SPOT] = {"spot", 453, SPOT_STEPS, {65535, 60000}, UNITS(846000000UL), 1410},
    [SPOT_RED] = {"spot_red", 640, SPOT_STEPS, {65535, 60000}, UNITS(846000000UL), 1410},
    [FIXATION] = {"fixation", 640, AREA_STEPS, {65535, 20000}, UNITS(846000000UL), 1410},
    [SPOT_GREEN] = {"spot_green", 505, SPOT_STEPS, {65535, 60000}, UNITS(846000000UL), 1410},
    [FIELD] = {"field", 0, AREA_STEPS, {65535, 60000}, UNITS(70500000UL), 118},
};
