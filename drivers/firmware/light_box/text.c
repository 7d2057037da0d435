#include "text.h"

#include <avr/pgmspace.h>

char *put_text(char *end, const char *text)
{
    while (*text)
        *end++ = *text++;
    return end;
}

char *put_number(char *end, uint32_t number)
{
    char digits[10];
    uint8_t count = 0;
    do {
        digits[count++] = (char)('0' + number % 10);
        number /= 10;
    } while (number);
    while (count)
        *end++ = digits[--count];
    return end;
}

char *put_signed(char *end, int16_t number)
{
    if (number < 0)
        *end++ = '-';
    return put_number(end, (uint32_t)(number < 0 ? -(int32_t)number : number));
}

char *put_hex(char *end, uint32_t number, uint8_t digits)
{
    while (digits--)
        *end++ = "0123456789ABCDEF"[(number >> (4 * digits)) & 15];
    return end;
}

char *put_stamp(char *end, stamp_t stamp)
{
    uint16_t us = (uint16_t)stamp.ticks * US_PER_TICK;
    end = put_number(end, stamp.ms);
    *end++ = '.';
    *end++ = (char)('0' + us / 100);
    *end++ = (char)('0' + us / 10 % 10);
    *end++ = (char)('0' + us % 10);
    return end;
}

bool read_hex(const char *text, uint8_t digits, uint32_t *number)
{
    *number = 0;
    while (digits--) {
        char c = *text++;
        if (c >= '0' && c <= '9')
            *number = (*number << 4) | (uint8_t)(c - '0');
        else if (c >= 'A' && c <= 'F')
            *number = (*number << 4) | (uint8_t)(c - 'A' + 10);
        else
            return false;
    }
    return true;
}

bool read_number(const char *word, uint32_t high, uint32_t *number)
{
    uint8_t digits = 0;
    *number = 0;
    for (; *word; word++) {
        uint8_t digit = (uint8_t)(*word - '0');
        if (digit > 9 || ++digits > 10 || *number > (0xFFFFFFFFUL - digit) / 10)
            return false;
        *number = *number * 10 + digit;
    }
    return digits > 0 && *number <= high;
}

/* CRC-32 of IEEE 802.3 (reflected, 0xEDB88320), four bits at a time. */
static const uint32_t CRC_OF_NIBBLE[16] PROGMEM = {
    0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
    0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};

uint32_t crc32(const char *text, uint8_t length)
{
    uint32_t crc = 0xFFFFFFFFUL;
    while (length--) {
        crc ^= (uint8_t)*text++;
        crc = (crc >> 4) ^ pgm_read_dword(&CRC_OF_NIBBLE[crc & 15]);
        crc = (crc >> 4) ^ pgm_read_dword(&CRC_OF_NIBBLE[crc & 15]);
    }
    return ~crc;
}
