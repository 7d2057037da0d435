/* The table of channels with the limits that the box enforces. */
#ifndef LIMITS_H
#define LIMITS_H

#include "config.h"

extern const struct channel_limits channel_limits[CHANNELS];

#endif
