/* Firmware of a flight computer behind a serial line that speaks slcan: frames that come are those of its CAN bus,
   frames that it sends are telemetry.

   The receive interrupt hands each frame to zygos_arm_frame(); the one task there is works off cycles, and at each SYNC
   reports. */

#include "arm_config.h"
#include "core.h"
#include "slcan.h"
#include "telemetry.h"
#include "uart.h"

#define CLOCK_HZ 25000000u
#define BAUD 115200u

/* SYNCs from one estimate to the next. */
#define EVERY 100u

static zygos_arm_t arm;
static node_telemetry_t telemetry;
static uart_t uart;
static slcan_t line;
static volatile uint32_t syncs;
static uint32_t corrupt;

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
            const int verdict = zygos_arm_frame(&arm, &frame);
            syncs += ((verdict == ZYGOS_ACCEPTED) && (frame.flags == 0) && (frame.id == ZYGOS_ID_SYNC)) ? 1u : 0u;
        }
        send(answer);
    }
}

void uart_transmit_interrupt(void)
{
    uart_transmit(&uart);
}

/* Memory was changed from outside. */
static void start_over(void)
{
    corrupt++;
    core_mask();
    if ((zygos_arm_restart(&arm, ZYGOS_KEEP_FAULTS) != 1) ||
        (zygos_arm_check(&arm, &arm_config, &telemetry.work) != 1)) {
        (void)zygos_arm_init(&arm, &arm_config);
    }
    core_unmask();
}

/* A cycle was not processed, because memory was changed. */
static void mend(void)
{
    core_mask();
    const int found = zygos_arm_scrub(&arm, &arm_config);
    core_unmask();
    if (found < 0) {
        start_over();
    } else {
        corrupt++;
    }
}

static void report(void)
{
    const node_losses_t losses = {
        .overflow = uart.overruns, .misshapen = line.refused, .unsent = uart.left_out, .corrupt = corrupt
    };
    zygos_frame_t frame;
    const int solved = node_telemetry_sync(&telemetry, &arm, &losses);
    while (node_telemetry_next(&telemetry, &arm, &frame) == 1) {
        char text[SLCAN_TEXT];
        slcan_line(&frame, text);
        core_mask();
        if (line.open == 1) {
            send(text);
        }
        core_unmask();
    }
    if (solved < 1) {
        start_over();
    }
}

int main(void)
{
    if (zygos_arm_init(&arm, &arm_config) < 0) {
        return 1;
    }
    node_telemetry_init(&telemetry, EVERY);
    slcan_init(&line);
    uart_init(&uart, UART_0, CLOCK_HZ / BAUD);
    core_enable(CORE_UART_RECEIVE);
    core_enable(CORE_UART_TRANSMIT);
    uint32_t reported = 0;
    for (;;) {
        const uint32_t closed = syncs; /* read first: when no cycle waits behind it, theirs are worked off */
        const int stepped = zygos_arm_step(&arm);
        if (stepped == 1) {
            continue;
        }
        if (stepped < 0) {
            mend();
        }
        if (reported != closed) {
            reported++;
            report();
            continue;
        }
        core_mask();
        if ((arm.receiver.queue.head == arm.receiver.queue.tail) && (reported == syncs)) {
            core_sleep();
        }
        core_unmask();
    }
}
