/* SPDX-License-Identifier: MIT */
/// A serial line: the UART of Arm's CMSDK, as an MPS2 has it. Received characters are read in the interrupt, one at a
/// time; what is sent waits in a buffer that the transmit interrupt empties, so nobody waits for the line.

#ifndef ZYGOS_UART_H
#define ZYGOS_UART_H

#include <stdint.h>

/// Characters that may wait. A power of two.
#define UART_BUFFER 1024u

typedef struct {
    volatile uint32_t data;
    volatile uint32_t state;
    volatile uint32_t control;
    volatile uint32_t interrupt; ///< Pending ones; a 1 that is written clears it.
    volatile uint32_t divider;   ///< Clock ticks a bit.
} uart_registers_t;

/// UART 0 of an MPS2.
#define UART_0 ((uart_registers_t *)0x40004000u)

typedef struct {
    uart_registers_t *registers;
    uint32_t overruns; ///< Times that characters were lost because they were not read in time.
    uint32_t left_out; ///< Texts that were not sent because the buffer was full.
    uint32_t head;     ///< Characters ever put into the buffer,
    uint32_t tail;     ///< and taken from it.
    char buffer[UART_BUFFER];
} uart_t;

/// Switches the UART on, its interrupts included.
void uart_init(uart_t *self, uart_registers_t *registers, uint32_t divider);

/// The receive interrupt: returns 1 and the character, 0 when none waits, or -1 when one was lost since the last call,
/// which is counted; the next call goes on.
int uart_read(uart_t *self, uint8_t *out);

/// The transmit interrupt: sends the next character, if one waits.
void uart_transmit(uart_t *self);

/// Sends a text as a whole, or leaves it out and counts it. Returns 1 or 0. Call it in a handler, or masked.
int uart_send(uart_t *self, const char *text);

#endif
