#include "protocol.h"

#include <stdbool.h>
#include <string.h>

#include "commands.h"
#include "config.h"
#include "events.h"
#include "light.h"
#include "text.h"
#include "uart.h"

#define LINE_SIZE 64

static char line[LINE_SIZE];
static uint8_t filled;
static bool overlong;
static char reply[REPLY_SIZE]; /* the latest, kept for a repeated request */
static uint32_t answered_crc;
static bool answered;

void protocol_init(uint8_t reset_cause)
{
    commands_init(reset_cause);
}

static void send(char *text, char *end)
{
    uint32_t crc = crc32(text, (uint8_t)(end - text));
    *end++ = '*';
    end = put_hex(end, crc, 8);
    *end++ = '\n';
    *end = 0;
    uart_write(text);
}

static void refuse_frame(void)
{
    char text[24];
    commands_count_bad_line();
    send(text, put_text(text, "=-- ER 01"));
}

/* #SS VERB...*CCCCCCCC: returns the length before the star, or 0 where the line is not whole. */
static uint8_t whole_request(uint32_t *crc)
{
    uint8_t length = filled < 9 ? 0 : (uint8_t)(filled - 9);
    uint32_t sequence;
    if (overlong || length < 6 || line[0] != '#' || line[3] != ' ' || line[length] != '*')
        return 0;
    if (!read_hex(line + 1, 2, &sequence) || !read_hex(line + length + 1, 8, crc))
        return 0;
    return *crc == crc32(line, length) ? length : 0;
}

static void answer(void)
{
    uint32_t crc;
    uint8_t length = whole_request(&crc);
    if (length == 0) {
        refuse_frame();
        return;
    }
    light_feed_deadman();
    if (!answered || crc != answered_crc) { /* else: the host missed the answer; do nothing twice */
        char *end = reply;
        line[length] = 0;
        *end++ = '=';
        *end++ = line[1];
        *end++ = line[2];
        *end++ = ' ';
        end = commands_run(line + 4, end);
        *end = 0;
        answered_crc = crc;
        answered = true;
    }
    send(reply, reply + strlen(reply));
    reply[strlen(reply) - 10] = 0; /* take off star, checksum and line end again */
}

static void take(uint8_t byte)
{
    if (byte == '\n') {
        if (filled || overlong)
            answer();
        filled = 0;
        overlong = false;
    } else if (byte == '#') { /* a request starts here, whatever came before */
        line[0] = '#';
        filled = 1;
        overlong = false;
    } else if (filled == LINE_SIZE) {
        overlong = true;
    } else if (byte != '\r') {
        line[filled++] = (char)byte;
    }
}

void protocol_poll(void)
{
    uint8_t byte;
    char text[EVENT_SIZE];
    char *end;
    while (uart_read(&byte))
        take(byte);
    light_keep();
    commands_watch_light();
    events_watch_button();
    while ((end = events_next(text)) != 0)
        send(text, end);
}
