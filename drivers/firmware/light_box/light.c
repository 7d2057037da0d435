#include "light.h"

#include <util/atomic.h>

#include "button.h"
#include "config.h"
#include "limits.h"
#include "memory.h"
#include "protocol.h"
#include "pwm.h"

#define DARKENED_BY_SILENCE 0x80
#define DARKENED_BY_BUTTON 0x40

/* The memory is lowered when light may reach what it holds within the first of these times, to what the second leaves:
 * writing takes 37 ms at most. It is raised when so many parts more are there, for a cell bears 100 000 writes. */
#define SOON_MS 256UL
#define AHEAD_MS 512UL
#define PARTS_BEFORE_RAISING 4

typedef struct {
    char mode;
    uint8_t range;
    bool bright;
    uint16_t level;       /* driven now, where bright */
    uint16_t target;      /* end of a ramp */
    uint32_t left_ms;     /* to the end of this phase */
    uint32_t on_ms, off_ms;
    uint16_t blinks_left; /* 0: for ever */
    uint16_t ramp_whole;  /* a ramp moves by this much each ms, and by one more in ramp_part of ramp_ms */
    uint32_t ramp_part, ramp_ms, ramp_carry;
    uint32_t bucket;
} channel_t;

static channel_t channels[CHANNELS];
static uint16_t silent_ms;
static uint16_t held_ms;  /* how long the button has been closed */
static uint8_t open_ms;   /* how long its contact has been open: a bounce does not end a hold */
static allowance_t kept;          /* as the EEPROM has it */
static uint32_t floors[CHANNELS]; /* the same in energy units: no bucket goes below while the EEPROM says so */
static uint8_t flashes_left;
static uint8_t trigger_ms;      /* left of the flash's trigger */
static uint16_t flash_wait_ms;  /* left until the next flash may be fired */
static uint32_t flash_refill_ms;
static volatile uint8_t darkened;

static uint32_t units_of(uint8_t n, uint8_t parts)
{
    uint32_t full = channel_limits[n].bucket;
    return full / PARTS * parts + full % PARTS * parts / PARTS;
}

/* The most parts, short of all, that are at most so many units. */
static uint8_t parts_within(uint8_t n, uint32_t units)
{
    uint32_t parts = units / (channel_limits[n].bucket / PARTS);
    if (parts >= PARTS)
        parts = PARTS - 1;
    while (parts && units_of(n, (uint8_t)parts) > units)
        parts--;
    return (uint8_t)parts;
}

void light_init(void)
{
    pwm_init();
    for (uint8_t n = 0; n < CHANNELS; n++)
        channels[n].mode = 'O';
}

/* A reset, however short or long, leaves in each bucket what the EEPROM holds: less than there was, never more. */
void light_remember(void)
{
    memory_read(&kept);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        for (uint8_t n = 0; n < CHANNELS; n++)
            channels[n].bucket = floors[n] = units_of(n, kept.parts[n]);
        flashes_left = kept.flashes;
        flash_wait_ms = flashes_left < FLASHES_IN_A_ROW ? FLASH_GAP_MS : 0;
    }
}

/* Writes the memory. What rises binds the buckets before it is written, what falls frees them after that. */
static void keep(const allowance_t *next)
{
    for (uint8_t n = 0; n < CHANNELS; n++)
        if (next->parts[n] > kept.parts[n])
            ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { floors[n] = units_of(n, next->parts[n]); }
    memory_write(next);
    kept = *next;
    for (uint8_t n = 0; n < CHANNELS; n++)
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { floors[n] = units_of(n, kept.parts[n]); }
}

/* What the memory should hold of a channel that spends so much per ms: 0 in darkness. */
static uint8_t parts_to_keep(uint8_t n, uint32_t bucket, uint32_t cost)
{
    uint8_t parts = kept.parts[n], there;
    if (cost)
        return parts && bucket < floors[n] + cost * SOON_MS
                   ? parts_within(n, bucket > cost * AHEAD_MS ? bucket - cost * AHEAD_MS : 0)
                   : parts;
    there = parts_within(n, bucket);
    if (bucket == channel_limits[n].bucket && parts < PARTS - 1)
        return PARTS - 1;
    return there >= parts + PARTS_BEFORE_RAISING ? there - 1 : parts;
}

static uint16_t cost_per_ms(uint8_t range, uint16_t level)
{
    return range == HIGH_RANGE ? (level >> 8) + 1 : 1;
}

/* Makes room in the memory for light that is about to begin. */
static void make_room(uint8_t n, uint8_t range, uint16_t level)
{
    allowance_t next = kept;
    uint32_t bucket;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { bucket = channels[n].bucket; }
    next.parts[n] = parts_to_keep(n, bucket, cost_per_ms(range, level));
    if (next.parts[n] != kept.parts[n])
        keep(&next);
}

void light_keep(void)
{
    allowance_t next = kept;
    bool changed = false;
    for (uint8_t n = 0; n < CHANNELS; n++) {
        uint32_t bucket;
        uint16_t cost;
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
        {
            const channel_t *c = &channels[n];
            bucket = c->bucket;
            cost = c->bright ? cost_per_ms(c->range, c->level) : 0;
        }
        next.parts[n] = parts_to_keep(n, bucket, cost);
        changed |= next.parts[n] != kept.parts[n];
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { next.flashes = flashes_left; }
    if (changed || next.flashes != kept.flashes)
        keep(&next);
}

static void drive(uint8_t n)
{
    channel_t *c = &channels[n];
    pwm_write(n, c->range, c->bright ? pwm_steps(n, c->level) : 0);
}

static void extinguish(uint8_t n)
{
    channels[n].mode = 'O';
    channels[n].bright = false;
    channels[n].level = 0;
    channels[n].range = LOW_RANGE;
    drive(n);
}

static uint8_t refuse(const stimulus_t *stimulus, uint32_t bright_ms)
{
    uint32_t bucket;
    uint8_t partner = pwm_partner(stimulus->channel);
    if (stimulus->level > channel_limits[stimulus->channel].limit[stimulus->range])
        return ERROR_LEVEL;
    if (stimulus->level && partner < CHANNELS && light_state(partner).mode != 'O')
        return ERROR_SHARED;
    if (stimulus->level && held_ms >= HELD_OFF_MS)
        return ERROR_HELD;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { bucket = channels[stimulus->channel].bucket; }
    return bright_ms > bucket / cost_per_ms(stimulus->range, stimulus->level) ? ERROR_ENERGY : 0;
}

static void start(const stimulus_t *stimulus, char mode)
{
    if (stimulus->level)
        make_room(stimulus->channel, stimulus->range, stimulus->level);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        channel_t *c = &channels[stimulus->channel];
        c->mode = stimulus->level == 0 ? 'O' : mode;
        c->range = stimulus->range;
        c->level = stimulus->level;
        c->bright = stimulus->level != 0;
        c->left_ms = c->on_ms = stimulus->on_ms;
        c->off_ms = stimulus->off_ms;
        c->blinks_left = stimulus->count;
        drive(stimulus->channel);
    }
}

uint8_t light_steady(const stimulus_t *stimulus)
{
    uint8_t error = refuse(stimulus, 1);
    if (error == 0)
        start(stimulus, 'S');
    return error;
}

uint8_t light_pulse(const stimulus_t *stimulus)
{
    uint8_t error = refuse(stimulus, stimulus->on_ms);
    if (error == 0)
        start(stimulus, 'P');
    return error;
}

uint8_t light_blink(const stimulus_t *stimulus)
{
    /* on_ms is at most 60 000 and count 65 535: the product fits 32 bits */
    uint8_t error = refuse(stimulus, stimulus->count ? stimulus->on_ms * stimulus->count : 1);
    if (error == 0)
        start(stimulus, 'B');
    return error;
}

uint8_t light_ramp(const stimulus_t *stimulus)
{
    uint8_t error = refuse(stimulus, 1);
    channel_state_t before = light_state(stimulus->channel);
    if (error)
        return error;
    if (before.mode != 'O' && before.range != stimulus->range)
        return ERROR_RANGE_CHANGE;
    make_room(stimulus->channel, stimulus->range, stimulus->level > before.level ? stimulus->level : before.level);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        channel_t *c = &channels[stimulus->channel];
        uint16_t distance;
        c->mode = 'R';
        c->range = stimulus->range;
        c->level = c->bright ? c->level : 0;
        c->bright = true;
        c->target = stimulus->level;
        distance = c->target > c->level ? c->target - c->level : c->level - c->target;
        c->left_ms = c->ramp_ms = stimulus->on_ms;
        c->ramp_whole = (uint16_t)(distance / stimulus->on_ms);
        c->ramp_part = distance % stimulus->on_ms;
        c->ramp_carry = 0;
        drive(stimulus->channel);
    }
    return 0;
}

void light_off(uint8_t channel)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { extinguish(channel); }
}

void light_all_off(void)
{
    for (uint8_t n = 0; n < CHANNELS; n++)
        light_off(n);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        trigger_ms = 0;
        pwm_trigger(false);
    }
}

channel_state_t light_state(uint8_t channel)
{
    channel_state_t state;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        const channel_t *c = &channels[channel];
        state.mode = c->mode;
        state.range = c->range;
        state.level = c->bright ? c->level : 0;
        state.bucket = c->bucket;
    }
    return state;
}

uint8_t light_flash(void)
{
    allowance_t next = kept;
    uint8_t error = ERROR_ENERGY;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (held_ms >= HELD_OFF_MS)
            error = ERROR_HELD;
        else if (flashes_left && flash_wait_ms == 0)
            error = 0;
        next.flashes = flashes_left ? flashes_left - 1 : 0;
    }
    if (error)
        return error;
    keep(&next);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        flashes_left = next.flashes;
        flash_wait_ms = FLASH_GAP_MS;
        if (held_ms >= HELD_OFF_MS) {
            error = ERROR_HELD;
        } else {
            trigger_ms = FLASH_TRIGGER_MS;
            pwm_trigger(true);
        }
    }
    return error;
}

void light_flash_state(uint8_t *left, uint16_t *wait_ms)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        *left = flashes_left;
        *wait_ms = flash_wait_ms;
    }
}

void light_feed_deadman(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { silent_ms = 0; }
}

uint8_t light_take_darkened(void)
{
    uint8_t taken;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        taken = darkened;
        darkened = 0;
    }
    return taken;
}

static void advance_ramp(uint8_t n, channel_t *c)
{
    uint16_t move = c->ramp_whole;
    c->ramp_carry += c->ramp_part;
    if (c->ramp_carry >= c->ramp_ms) {
        c->ramp_carry -= c->ramp_ms;
        move++;
    }
    c->level = c->target > c->level ? c->level + move : c->level - move;
    if (--c->left_ms == 0) {
        c->mode = c->target ? 'S' : 'O';
        c->level = c->target;
        c->bright = c->target != 0;
    }
    drive(n);
}

static void advance_blink(uint8_t n, channel_t *c)
{
    if (--c->left_ms)
        return;
    if (c->bright) {
        if (c->blinks_left && --c->blinks_left == 0) {
            extinguish(n);
            return;
        }
        c->left_ms = c->off_ms;
    } else {
        c->left_ms = c->on_ms;
    }
    c->bright = !c->bright;
    drive(n);
}

static void spend(uint8_t n, channel_t *c)
{
    uint16_t cost = cost_per_ms(c->range, c->level);
    if (c->bucket < cost || c->bucket - cost < floors[n]) {
        extinguish(n);
        darkened |= (uint8_t)(1 << n);
    } else {
        c->bucket -= cost;
    }
}

static void refill(uint8_t n, channel_t *c)
{
    uint32_t full = channel_limits[n].bucket;
    c->bucket = full - c->bucket < channel_limits[n].refill ? full : c->bucket + channel_limits[n].refill;
}

static void advance(uint8_t n, channel_t *c)
{
    if (c->bright)
        spend(n, c);
    else
        refill(n, c);
    switch (c->mode) {
    case 'R': advance_ramp(n, c); break;
    case 'B': advance_blink(n, c); break;
    case 'P':
        if (--c->left_ms == 0)
            extinguish(n);
        break;
    default: break;
    }
}

static void extinguish_all(void)
{
    for (uint8_t n = 0; n < CHANNELS; n++)
        extinguish(n);
    trigger_ms = 0;
    pwm_trigger(false);
}

static void advance_flash(void)
{
    if (trigger_ms && --trigger_ms == 0)
        pwm_trigger(false);
    if (flash_wait_ms)
        flash_wait_ms--;
    if (flashes_left < FLASHES_IN_A_ROW && ++flash_refill_ms == FLASH_REFILL_MS) {
        flash_refill_ms = 0;
        flashes_left++;
    }
}

/* Reads the contact itself, so that the button turns the lights off whatever the main loop does. */
static void watch_button(void)
{
    if (button_closed()) {
        open_ms = 0;
        if (held_ms < HELD_OFF_MS && ++held_ms == HELD_OFF_MS) {
            extinguish_all();
            darkened |= DARKENED_BY_BUTTON;
        }
    } else if (++open_ms >= DEBOUNCE_MS) {
        open_ms = DEBOUNCE_MS;
        held_ms = 0;
    }
}

void light_tick(void)
{
    if (silent_ms < DEADMAN_MS && ++silent_ms == DEADMAN_MS) {
        extinguish_all();
        darkened |= DARKENED_BY_SILENCE;
    }
    watch_button();
    advance_flash();
    for (uint8_t n = 0; n < CHANNELS; n++)
        advance(n, &channels[n]);
}
