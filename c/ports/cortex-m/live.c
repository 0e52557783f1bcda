/* SPDX-License-Identifier: MIT */
/* Firmware of a flight computer behind a serial line that speaks slcan: frames that come are those of its CAN bus,
   frames that it sends are telemetry.

   The receive interrupt hands each frame to zygos_frame(). There is one task, which calls zygos_step() while frames
   wait, and is the background as well: in between it solves, and sends. */

#include <stdbool.h>

#include "arm_config.h"
#include "core.h"
#include "slcan.h"
#include "telemetry.h"
#include "uart.h"

#define CLOCK_HZ 25000000u
#define BAUD 115200u

/* SYNCs from one estimate to the next. */
#define EVERY 100u

static zygos_t arm;
static zygos_background_t memory;
static node_telemetry_t telemetry;
static uart_t uart;
static slcan_t line;
static uint32_t corrupt; /* Times that the arm began anew. */

/* In a handler, or masked. */
static void send(const char *text)
{
    if (uart_send(&uart, text) == 0) {
        line.flags |= SLCAN_SEND_FULL;
    }
}

void uart_receive_interrupt(void)
{
    uint8_t character;
    for (int read = uart_read(&uart, &character); read != 0; read = uart_read(&uart, &character)) {
        if (read < 0) { /* the line that lost it is too short, and will be refused */
            line.flags |= SLCAN_OVERRUN;
            continue;
        }
        zygos_frame_t frame;
        char answer[SLCAN_TEXT];
        if (slcan_take(&line, character, &frame, answer) == 1) {
            (void)zygos_frame(&arm, &frame);
        }
        send(answer);
    }
}

void uart_transmit_interrupt(void)
{
    uart_transmit(&uart);
}

static int begin(void)
{
    const int begun = zygos_init(&arm, &arm_config, &memory, (uint32_t)sizeof memory);
    node_telemetry_follow(&telemetry, &arm);
    return begun;
}

static void report(void)
{
    const node_losses_t losses = { .overflow = uart.overruns,
                                   .misshapen = line.refused,
                                   .unsent = uart.left_out,
                                   .corrupt = corrupt + (uint32_t)(arm.repairs + arm.losses) };
    zygos_frame_t frame;
    (void)node_telemetry_step(&telemetry, &arm, &losses);
    while (node_telemetry_next(&telemetry, &arm, &frame) == 1) {
        char text[SLCAN_TEXT];
        slcan_line(&frame, text);
        core_mask();
        if (line.open == 1) {
            send(text);
        }
        core_unmask();
    }
}

int main(void)
{
    node_telemetry_init(&telemetry, EVERY, 0);
    if (begin() < 0) {
        return 1;
    }
    slcan_init(&line);
    uart_init(&uart, UART_0, CLOCK_HZ / BAUD);
    core_enable(CORE_UART_RECEIVE);
    core_enable(CORE_UART_TRANSMIT);
    for (int stepped = 0;;) {
        core_mask();
        const bool idle = (stepped != 1) && (arm.head == arm.tail) && (telemetry.wanted == 0u);
        if (idle) {
            core_sleep();
        }
        core_unmask();
        if (idle) {
            continue;
        }
        stepped = zygos_step(&arm);
        if (stepped < 0) { /* the configuration is in memory that does not change: the copies of it were */
            core_mask();
            corrupt += (uint32_t)(arm.repairs + arm.losses) + 1u;
            (void)begin();
            core_unmask();
        }
        report();
    }
}
