#include "commands.h"

#include <avr/eeprom.h>
#include <avr/io.h>
#include <stdbool.h>
#include <string.h>

#include "button.h"
#include "clock.h"
#include "config.h"
#include "events.h"
#include "light.h"
#include "limits.h"
#include "protocol.h"
#include "pwm.h"
#include "sensors.h"
#include "text.h"
#include "uart.h"

#define MOST_WORDS 7
#define SERIAL_LENGTH 8 /* characters at the start of the EEPROM */

static bool session;
static uint8_t spoken = PROTOCOL_VERSION; /* the version that the host asked for */
static uint16_t bad_lines;
static uint8_t darkened_count;
static char cause;

static char *words[MOST_WORDS];
static uint8_t word_count;

void commands_init(uint8_t reset_flags)
{
    cause = reset_flags & _BV(WDRF) ? 'W' : reset_flags & _BV(BORF) ? 'B' : reset_flags & _BV(EXTRF) ? 'E' : 'P';
    events_add("BO", cause, clock_now());
}

void commands_count_bad_line(void)
{
    bad_lines++;
}

void commands_watch_light(void)
{
    uint8_t reasons = light_take_darkened();
    if (reasons & 0x80 && session) {
        session = false;
        darkened_count++;
        events_add("DK", 'D', clock_now());
    }
    if (reasons & 0x40) {
        darkened_count++;
        events_add("DK", 'B', clock_now());
    }
    for (uint8_t n = 0; n < CHANNELS; n++) {
        if (reasons & (1 << n)) {
            darkened_count++;
            events_add("DK", (char)('0' + n), clock_now());
        }
    }
}

static char *put_field(char *end, uint32_t number)
{
    *end++ = ' ';
    return put_number(end, number);
}

static char *put_field_stamp(char *end, stamp_t stamp)
{
    *end++ = ' ';
    return put_stamp(end, stamp);
}

static char *put_serial(char *end)
{
    char serial[SERIAL_LENGTH];
    eeprom_read_block(serial, (const void *)0, SERIAL_LENGTH);
    for (uint8_t n = 0; n < SERIAL_LENGTH; n++) {
        char c = serial[n];
        bool plain = (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '-';
        *end++ = plain ? c : '0';
    }
    return end;
}

static uint8_t channel_count(void)
{
    return spoken == 1 ? CHANNELS_OF_VERSION_1 : CHANNELS;
}

static uint8_t say_hello(char **end)
{
    uint32_t version;
    if (word_count != 2 || !read_number(words[1], 0xFFFFFFFFUL, &version))
        return ERROR_ARGUMENTS;
    if (version < 1 || version > PROTOCOL_VERSION)
        return ERROR_VERSION;
    spoken = (uint8_t)version;
    light_all_off();
    session = true;
    *end = put_text(*end, " " BOX_KIND);
    *end = put_field(*end, spoken);
    *end = put_text(*end, " " FIRMWARE_VERSION " ");
    *end = put_serial(*end);
    *end = put_field(*end, channel_count());
    return 0;
}

static uint8_t read_channel(uint8_t *channel)
{
    uint32_t number;
    if (word_count < 2 || !read_number(words[1], 0xFFFFFFFFUL, &number))
        return ERROR_ARGUMENTS;
    *channel = (uint8_t)number;
    return number < channel_count() ? 0 : ERROR_CHANNEL;
}

static uint8_t describe_channel(char **end)
{
    uint8_t n, error = read_channel(&n);
    const struct channel_limits *c = &channel_limits[n];
    if (error || word_count != 2)
        return error ? error : ERROR_ARGUMENTS;
    *end = put_text(*end, " ");
    *end = put_text(*end, c->name);
    *end = put_field(*end, c->peak_nm);
    *end = put_field(*end, c->steps);
    *end = put_field(*end, PWM_HZ);
    *end = put_field(*end, c->limit[LOW_RANGE]);
    *end = put_field(*end, c->limit[HIGH_RANGE]);
    *end = put_field(*end, c->bucket);
    *end = put_field(*end, c->refill);
    return 0;
}

static bool read_arguments(stimulus_t *stimulus, char verb)
{
    uint32_t number;
    bool range_known = words[2][1] == 0 && (words[2][0] == 'L' || words[2][0] == 'H');
    uint32_t longest = verb == 'B' ? LONGEST_BLINK_MS : LONGEST_MS;
    stimulus->range = words[2][0] == 'H' ? HIGH_RANGE : LOW_RANGE;
    if (!range_known || !read_number(words[3], 0xFFFF, &number))
        return false;
    stimulus->level = (uint16_t)number;
    if (verb == 'S')
        return true;
    if (!read_number(words[4], longest, &stimulus->on_ms) || stimulus->on_ms == 0)
        return false;
    if (verb != 'B')
        return true;
    if (!read_number(words[5], longest, &stimulus->off_ms) || stimulus->off_ms == 0)
        return false;
    if (!read_number(words[6], 0xFFFF, &number))
        return false;
    stimulus->count = (uint16_t)number;
    return true;
}

static uint8_t shine(char **end, uint8_t argument_count, uint8_t (*start)(const stimulus_t *))
{
    stimulus_t stimulus = {0};
    uint8_t error = read_channel(&stimulus.channel);
    if (error)
        return error;
    if (word_count != argument_count + 1 || !read_arguments(&stimulus, words[0][0]))
        return ERROR_ARGUMENTS;
    if (!session)
        return ERROR_SESSION;
    error = start(&stimulus);
    if (error)
        return error;
    *end = put_text(*end, stimulus.range == HIGH_RANGE ? " H" : " L");
    *end = put_field(*end, stimulus.level);
    *end = put_field(*end, pwm_steps(stimulus.channel, stimulus.level));
    return 0;
}

static uint8_t darken(char **end)
{
    uint8_t n, error;
    (void)end;
    if (word_count == 2 && strcmp(words[1], "*") == 0) {
        light_all_off();
        return 0;
    }
    error = read_channel(&n);
    if (error || word_count != 2)
        return error ? error : ERROR_ARGUMENTS;
    light_off(n);
    return 0;
}

static uint8_t read_back(char **end)
{
    uint8_t n, error = read_channel(&n);
    channel_state_t state;
    if (error || word_count != 2)
        return error ? error : ERROR_ARGUMENTS;
    state = light_state(n);
    *(*end)++ = ' ';
    *(*end)++ = state.mode;
    *(*end)++ = ' ';
    *(*end)++ = state.range == HIGH_RANGE ? 'H' : 'L';
    *end = put_field(*end, state.level);
    *end = put_field(*end, pwm_steps(n, state.level));
    *end = put_field(*end, state.bucket);
    return 0;
}

static uint8_t report_status(char **end)
{
    if (word_count != 1)
        return ERROR_ARGUMENTS;
    *end = put_field(*end, sensors_supply_mv());
    *(*end)++ = ' ';
    *end = put_signed(*end, sensors_temperature_dc());
    *end = put_field(*end, bad_lines);
    *end = put_field(*end, uart_lost());
    *end = put_field(*end, darkened_count);
    *(*end)++ = ' ';
    *(*end)++ = cause;
    *end = put_field(*end, button_pressed());
    *end = put_field(*end, session);
    return 0;
}

static uint8_t put_flash(char **end)
{
    uint8_t left;
    uint16_t wait_ms;
    light_flash_state(&left, &wait_ms);
    *end = put_field(*end, left);
    *end = put_field(*end, wait_ms);
    return 0;
}

static uint8_t fire_flash(char **end)
{
    uint8_t error;
    if (word_count != 1)
        return ERROR_ARGUMENTS;
    if (!session)
        return ERROR_SESSION;
    error = light_flash();
    return error ? error : put_flash(end);
}

static uint8_t tell_time(char **end)
{
    if (word_count != 1)
        return ERROR_ARGUMENTS;
    *end = put_field_stamp(*end, uart_line_stamp());
    *end = put_field_stamp(*end, clock_now());
    *(*end)++ = ' ';
    *end = put_hex(*end, events_latest(), 2);
    return 0;
}

static uint8_t repeat_event(char **end)
{
    uint32_t number;
    char *after;
    if (word_count != 2 || strlen(words[1]) != 2 || !read_hex(words[1], 2, &number))
        return ERROR_ARGUMENTS;
    after = events_again((uint8_t)number, *end + 1);
    if (after == 0)
        return ERROR_EVENT;
    **end = ' ';
    *end = after;
    return 0;
}

static uint8_t dispatch(char **end)
{
    const char *verb = words[0];
    if (strcmp(verb, "HI") == 0)
        return say_hello(end);
    if (strcmp(verb, "CH") == 0)
        return describe_channel(end);
    if (strcmp(verb, "SL") == 0)
        return shine(end, 3, light_steady);
    if (strcmp(verb, "RA") == 0)
        return shine(end, 4, light_ramp);
    if (strcmp(verb, "PU") == 0)
        return shine(end, 4, light_pulse);
    if (strcmp(verb, "BL") == 0)
        return shine(end, 6, light_blink);
    if (strcmp(verb, "OF") == 0)
        return darken(end);
    if (strcmp(verb, "RB") == 0)
        return read_back(end);
    if (strcmp(verb, "ST") == 0)
        return report_status(end);
    if (strcmp(verb, "TM") == 0)
        return tell_time(end);
    if (strcmp(verb, "EV") == 0)
        return repeat_event(end);
    if (spoken > 1 && strcmp(verb, "FL") == 0)
        return fire_flash(end);
    if (spoken > 1 && strcmp(verb, "FS") == 0)
        return word_count == 1 ? put_flash(end) : ERROR_ARGUMENTS;
    return ERROR_VERB;
}

/* Words are parted by exactly one space; an empty or surplus word makes the request wrong. */
static bool cut(char *request)
{
    word_count = 0;
    for (char *word = request; word; word_count++) {
        char *space = strchr(word, ' ');
        if (word_count == MOST_WORDS || *word == 0 || *word == ' ')
            return false;
        if (space)
            *space++ = 0;
        words[word_count] = word;
        word = space;
    }
    return true;
}

char *commands_run(char *request, char *end)
{
    char *fields = put_text(end, "OK");
    uint8_t error = cut(request) ? dispatch(&fields) : ERROR_ARGUMENTS;
    if (error == 0)
        return fields;
    end = put_text(end, "ER ");
    *end++ = (char)('0' + error / 10);
    *end++ = (char)('0' + error % 10);
    return end;
}
