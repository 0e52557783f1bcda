/* SPDX-License-Identifier: MIT */
#include "uart.h"

#include <string.h>

enum { SENDING = 1, RECEIVED = 2, RECEIVE_OVERRUN = 8 };                   /* state */
enum { SEND = 1, RECEIVE = 2, SEND_INTERRUPT = 4, RECEIVE_INTERRUPT = 8 }; /* control */
enum { SENT_PENDING = 1, RECEIVED_PENDING = 2 };                           /* interrupt */

void uart_init(uart_t *self, uart_registers_t *registers, uint32_t divider)
{
    memset(self, 0, sizeof *self);
    self->registers = registers;
    registers->divider = divider;
    registers->control = SEND | RECEIVE | SEND_INTERRUPT | RECEIVE_INTERRUPT;
}

int uart_read(uart_t *self, uint8_t *out)
{
    uart_registers_t *registers = self->registers;
    registers->interrupt = RECEIVED_PENDING;
    const uint32_t state = registers->state;
    if (state & RECEIVE_OVERRUN) {
        registers->state = RECEIVE_OVERRUN; /* a 1 clears it */
        self->overruns++;
        return -1;
    }
    if (!(state & RECEIVED)) {
        return 0;
    }
    *out = (uint8_t)registers->data;
    return 1;
}

void uart_transmit(uart_t *self)
{
    uart_registers_t *registers = self->registers;
    registers->interrupt = SENT_PENDING;
    if ((self->head != self->tail) && !(registers->state & SENDING)) {
        registers->data = (uint8_t)self->buffer[self->tail++ % UART_BUFFER];
    }
}

int uart_send(uart_t *self, const char *text)
{
    const uint32_t n = (uint32_t)strlen(text);
    if (n > UART_BUFFER - (self->head - self->tail)) {
        self->left_out++;
        return 0;
    }
    for (uint32_t i = 0; i < n; i++) {
        self->buffer[self->head++ % UART_BUFFER] = text[i];
    }
    uart_transmit(self);
    return 1;
}
