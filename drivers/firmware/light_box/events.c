#include "events.h"

#include <stdbool.h>

#include "button.h"
#include "text.h"

#define KEPT 16u /* a power of two */

static struct {
    char type[2];
    char argument;
    stamp_t when;
} kept[KEPT];
static uint8_t latest, sent; /* numbers, wrapping at 256; 0 means none yet */
static uint8_t count;        /* how many are kept */

void events_add(const char *type, char argument, stamp_t when)
{
    uint8_t slot = ++latest & (KEPT - 1);
    kept[slot].type[0] = type[0];
    kept[slot].type[1] = type[1];
    kept[slot].argument = argument;
    kept[slot].when = when;
    if (count < KEPT)
        count++;
}

void events_watch_button(void)
{
    bool pressed;
    stamp_t when;
    while (button_take(&pressed, &when))
        events_add("BT", pressed ? 'D' : 'U', when);
}

static char *put_event(char *end, uint8_t number)
{
    uint8_t slot = number & (KEPT - 1);
    *end++ = kept[slot].type[0];
    *end++ = kept[slot].type[1];
    *end++ = ' ';
    *end++ = kept[slot].argument;
    *end++ = ' ';
    return put_stamp(end, kept[slot].when);
}

char *events_next(char *text)
{
    char *end = text;
    if (sent == latest)
        return 0;
    if ((uint8_t)(latest - sent) > count)
        sent = latest - count; /* overwritten before they could be sent */
    sent++;
    *end++ = '!';
    end = put_hex(end, sent, 2);
    *end++ = ' ';
    return put_event(end, sent);
}

char *events_again(uint8_t number, char *end)
{
    if ((uint8_t)(latest - number) >= count)
        return 0;
    return put_event(end, number);
}

uint8_t events_latest(void)
{
    return latest;
}
