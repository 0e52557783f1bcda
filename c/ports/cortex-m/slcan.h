/* SPDX-License-Identifier: MIT */
/// slcan: CAN frames as lines of text on a serial line, as Lawicel's adapters, python-can and Linux' slcand write them.
///
///     t iii l dd..  frame with an 11-bit identifier, T iiiiiiii l dd.. with a 29-bit one; r, R: remote requests
///     O C S0..S8    open, close, set the bit rate (which has no meaning here) while closed
///     V N F         version, serial number, status flags since the last F
///
/// Each line ends with a carriage return. The answer is one too (behind z or Z for a frame), or BEL for a line that
/// means nothing: unknown, of another length than it says, with a digit that is none, or a frame while closed. Any
/// byte may come at any time; a line that lost a character has the wrong length and is refused.

#ifndef ZYGOS_SLCAN_H
#define ZYGOS_SLCAN_H

#include "zygos/wire.h"

/// Longest line, its end included: T, identifier, length, 8 bytes.
#define SLCAN_LINE (1 + 8 + 1 + 16 + 1)
/// Room for it as a text.
#define SLCAN_TEXT (SLCAN_LINE + 1)

/// Flags that F answers with, as Lawicel numbers them.
enum slcan_flag {
    SLCAN_SEND_FULL = 0x02, ///< A line to the host was left out because the buffer was full.
    SLCAN_OVERRUN = 0x08,   ///< Characters came faster than they were read.
    SLCAN_BUS_ERROR = 0x80  ///< A line was refused.
};

typedef struct {
    uint8_t line[SLCAN_LINE]; ///< The line that grows.
    uint32_t used;            ///< Its characters so far; SLCAN_LINE: too many, the rest is not kept.
    uint32_t open;            ///< 1 between O and C.
    uint32_t frames;          ///< Frames that came.
    uint32_t refused;         ///< Lines answered with BEL.
    uint32_t flags;           ///< Of enum slcan_flag, set until F asks. The caller adds what it knows.
} slcan_t;

/// Closed, nothing received. Needs memory of its own.
void slcan_init(slcan_t *self);

/// Takes one character. Returns 1 when it completed a frame, which is then in *frame, else 0 and *frame is as it was.
/// answer[SLCAN_TEXT] becomes the text to send back, empty while a line grows. Bounded: one line.
int slcan_take(slcan_t *self, uint8_t character, zygos_frame_t *frame, char *answer);

/// Writes a frame as a line into out[SLCAN_TEXT]. Returns 1, or 0 and an empty text for a frame that slcan does not
/// know: an FD or error frame, or one with a length or an identifier out of range.
int slcan_line(const zygos_frame_t *frame, char *out);

#endif
