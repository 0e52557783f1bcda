/* SPDX-License-Identifier: MIT */
#include "slcan.h"

#include <stdbool.h>
#include <string.h>

#define END '\r'
#define LARGEST_STANDARD 0x7FFu
#define LARGEST_EXTENDED 0x1FFFFFFFu
/* Kinds of frames, as the first character of their lines. */
#define STANDARD 't'
#define EXTENDED 'T'
#define REMOTE 'r'
#define EXTENDED_REMOTE 'R'

void slcan_init(slcan_t *self)
{
    memset(self, 0, sizeof *self);
}

/* Value of a hexadecimal digit, or 16. */
static uint32_t digit(uint8_t character)
{
    if ((character >= '0') && (character <= '9')) {
        return (uint32_t)character - '0';
    }
    const uint32_t lower = (uint32_t)character | 0x20u;
    return ((lower >= 'a') && (lower <= 'f')) ? lower - 'a' + 10u : 16u;
}

/* Reads so many hexadecimal digits. Returns false when one is none. */
static bool number(const uint8_t *text, uint32_t digits, uint32_t *out)
{
    uint32_t value = 0;
    for (uint32_t i = 0; i < digits; i++) {
        const uint32_t next = digit(text[i]);
        if (next > 15u) {
            return false;
        }
        value = value << 4 | next;
    }
    *out = value;
    return true;
}

/* Reads a line of n characters, its end not counted, that begins as a frame does. */
static bool parse(const uint8_t *line, uint32_t n, zygos_frame_t *out)
{
    const bool extended = (line[0] == EXTENDED) || (line[0] == EXTENDED_REMOTE);
    const bool remote = (line[0] == REMOTE) || (line[0] == EXTENDED_REMOTE);
    const uint32_t digits = extended ? 8u : 3u;
    const uint32_t data = 1u + digits + 1u;
    zygos_frame_t frame;
    memset(&frame, 0, sizeof frame);
    uint32_t length = 0;
    if ((n < data) || !number(&line[1], digits, &frame.id) || !number(&line[1u + digits], 1, &length) ||
        (frame.id > (extended ? LARGEST_EXTENDED : LARGEST_STANDARD)) || (length > sizeof frame.data) ||
        (n != data + (remote ? 0u : 2u * length))) {
        return false;
    }
    for (uint32_t i = 0; (i < length) && !remote; i++) {
        uint32_t byte = 0;
        if (!number(&line[data + 2u * i], 2, &byte)) {
            return false;
        }
        frame.data[i] = (uint8_t)byte;
    }
    frame.length = (uint8_t)length;
    frame.flags =
        (uint8_t)((extended ? (uint32_t)ZYGOS_FRAME_EXTENDED : 0u) | (remote ? (uint32_t)ZYGOS_FRAME_REMOTE : 0u));
    *out = frame;
    return true;
}

static char *hexadecimal(char *out, uint32_t value, uint32_t digits)
{
    for (uint32_t i = 0; i < digits; i++) {
        out[i] = "0123456789ABCDEF"[(value >> (4u * (digits - 1u - i))) & 0xFu];
    }
    return out + digits;
}

/* What is no frame. Returns the answer's end, or null when the line means nothing. */
static char *command(slcan_t *self, uint32_t n, char *out)
{
    if (n == 0) { /* hosts send empty lines to end what was left unfinished */
        return out;
    }
    const uint8_t *line = self->line;
    if ((n == 2) && (line[0] == 'S') && (line[1] >= '0') && (line[1] <= '8')) {
        return (self->open == 0) ? out : NULL;
    }
    if (n != 1) {
        return NULL;
    }
    switch (line[0]) {
    case 'O':
        self->open = 1;
        return out;
    case 'C':
        self->open = 0;
        return out;
    case 'V':
        *out++ = 'V';
        return hexadecimal(out, ZYGOS_VERSION_MAJOR << 8 | ZYGOS_VERSION_MINOR, 4);
    case 'N':
        memcpy(out, "NZYGO", 5);
        return out + 5;
    case 'F':
        *out++ = 'F';
        out = hexadecimal(out, self->flags, 2);
        self->flags = 0;
        return out;
    default:
        return NULL;
    }
}

static bool is_frame(uint8_t first)
{
    return (first == STANDARD) || (first == EXTENDED) || (first == REMOTE) || (first == EXTENDED_REMOTE);
}

int slcan_take(slcan_t *self, uint8_t character, zygos_frame_t *frame, char *answer)
{
    answer[0] = '\0';
    if (character != END) {
        if (self->used < SLCAN_LINE) {
            self->line[self->used++] = character;
        }
        return 0;
    }
    const uint32_t n = self->used;
    self->used = 0;
    int complete = 0;
    char *end = NULL;
    if ((n > 0) && (n < SLCAN_LINE) && is_frame(self->line[0])) {
        if ((self->open == 1) && parse(self->line, n, frame)) {
            self->frames++;
            complete = 1;
            answer[0] = (frame->flags & ZYGOS_FRAME_EXTENDED) ? 'Z' : 'z';
            end = answer + 1;
        }
    } else {
        end = command(self, n, answer);
    }
    if (end == NULL) {
        self->refused++;
        self->flags |= SLCAN_BUS_ERROR;
        end = answer;
        *end++ = '\a';
    } else {
        *end++ = END;
    }
    *end = '\0';
    return complete;
}

int slcan_line(const zygos_frame_t *frame, char *out)
{
    const bool extended = (frame->flags & ZYGOS_FRAME_EXTENDED) != 0;
    const bool remote = (frame->flags & ZYGOS_FRAME_REMOTE) != 0;
    out[0] = '\0';
    if ((frame->flags & (ZYGOS_FRAME_FD | ZYGOS_FRAME_ERROR)) || (frame->length > sizeof frame->data) ||
        (frame->id > (extended ? LARGEST_EXTENDED : LARGEST_STANDARD))) {
        return 0;
    }
    *out++ = remote ? (extended ? EXTENDED_REMOTE : REMOTE) : (extended ? EXTENDED : STANDARD);
    out = hexadecimal(out, frame->id, extended ? 8u : 3u);
    out = hexadecimal(out, frame->length, 1);
    for (uint32_t i = 0; (i < frame->length) && !remote; i++) {
        out = hexadecimal(out, frame->data[i], 2);
    }
    *out++ = END;
    *out = '\0';
    return 1;
}
