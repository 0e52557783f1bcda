/* SPDX-License-Identifier: MIT */
/* The flight loop on a Cortex-M: CAN through an slcan adapter on the UART, as the boards that QEMU knows have no CAN.
   With a CAN controller, its receive interrupt takes the place of the UART's. Start-up, interrupts and
   UART are those of c/ports/cortex-m. */

#include "core.h"
#include "flight.h"
#include "slcan.h"
#include "uart.h"

#define BIT_TICKS 217u /* 115,200 bit/s from 25 MHz */

static uart_t line;
static slcan_t adapter;
static volatile uint32_t received; /* since the task ran */

void uart_receive_interrupt(void)
{
    uint8_t character = 0;
    zygos_frame_t frame;
    char answer[SLCAN_TEXT];
    for (int read = uart_read(&line, &character); read != 0; read = uart_read(&line, &character)) {
        if (read < 0) {
            continue; /* the line that lost a character is too short, and is refused */
        }
        if (slcan_take(&adapter, character, &frame, answer) == 1) {
            flight_receive(&frame);
            received = 1;
        }
        (void)uart_send(&line, answer);
    }
}

void uart_transmit_interrupt(void)
{
    uart_transmit(&line);
}

void port_send(const zygos_frame_t *frame)
{
    char text[SLCAN_TEXT];
    if (slcan_line(frame, text) == 1) {
        core_mask();
        (void)uart_send(&line, text);
        core_unmask();
    }
}

/* Your flash, FRAM or MRAM. */
uint32_t port_load(uint8_t head[ZYGOS_SNAPSHOT_HEAD], void *image, uint32_t size)
{
    (void)head;
    (void)image;
    (void)size;
    return 0;
}

uint32_t port_save(const uint8_t head[ZYGOS_SNAPSHOT_HEAD], const void *image, uint32_t size)
{
    (void)head;
    (void)image;
    (void)size;
    return 0;
}

int main(void)
{
    const int started = flight_start();
    if (started < 0) {
        return -started;
    }
    slcan_init(&adapter);
    uart_init(&line, UART_0, BIT_TICKS);
    core_enable(CORE_UART_RECEIVE);
    core_enable(CORE_UART_TRANSMIT);
    for (;;) {
        flight_task();
        (void)flight_solve(); /* frames wait meanwhile */
        core_mask();
        if (received == 0u) {
            core_sleep();
        }
        received = 0;
        core_unmask();
    }
}
