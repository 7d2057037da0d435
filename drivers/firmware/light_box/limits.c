#include "limits.h"

/* A bucket of S seconds at level 60000 (235 units per ms) refills in ten minutes of darkness.
 * bleach: 200 s; test spots and fixation: 3600 s, which a forty-minute test does not reach. */
const struct channel_limits channel_limits[CHANNELS] = {
    [BLEACH] = {"bleach", 0, AREA_STEPS, {65535, 60000}, 47000000UL, 78},
    [SPOT] = {"spot", 453, SPOT_STEPS, {65535, 60000}, 846000000UL, 1410},
    [SPOT_RED] = {"spot_red", 640, SPOT_STEPS, {65535, 60000}, 846000000UL, 1410},
    [FIXATION] = {"fixation", 640, AREA_STEPS, {65535, 20000}, 846000000UL, 1410},
};
