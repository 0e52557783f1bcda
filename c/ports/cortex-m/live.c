/* Firmware of a flight computer behind a serial line that speaks slcan: frames that come are those of its CAN bus,
   frames that it sends are telemetry.

   The receive interrupt hands each frame to zygos_frame(); the one task there is works off cycles and reports. One
   telemetry frame goes out for each cycle: in turn the verdict of a fresh estimate, its values and its sigmas. */

#include "arm_config.h"
#include "core.h"
#include "slcan.h"
#include "uart.h"

#define CLOCK_HZ 25000000u
#define BAUD 115200u

enum kind { KIND_VALUE = 0, KIND_SIGMA = 1, KIND_VERDICT = 3 }; /* as in the DBC */

static zygos_t arm;
static zygos_work_t work;
static zygos_estimate_t estimate;
static uart_t uart;
static slcan_t line;

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
            zygos_frame(&arm, &frame);
        }
        send(answer);
    }
}

void uart_transmit_interrupt(void)
{
    uart_transmit(&uart);
}

/* What is not known has no value, and is not sent. */
static void report(uint32_t index, enum kind kind, double value)
{
    zygos_frame_t frame;
    char text[SLCAN_TEXT];
    if ((line.open == 0) || !((value > -1e38) && (value < 1e38))) {
        return;
    }
    zygos_wire_encode_telemetry((uint8_t)arm.receiver.assembly.counter, (uint8_t)index, (uint8_t)kind, (float)value,
                                &frame);
    slcan_line(&frame, text);
    core_mask();
    send(text);
    core_unmask();
}

static void report_in_turn(void)
{
    const uint32_t p = arm.layout.count;
    const uint32_t turn = (uint32_t)(arm.cycles % (2u * p + 1u));
    if (turn == 0) {
        zygos_take(&arm, &work);
        zygos_solve(&work, &estimate);
        report(0, KIND_VERDICT, estimate.validity);
    } else if (turn <= p) {
        report(turn - 1u, KIND_VALUE, estimate.value[turn - 1u]);
    } else {
        report(turn - p - 1u, KIND_SIGMA, estimate.sigma[turn - p - 1u]);
    }
}

int main(void)
{
    if (zygos_init(&arm, &arm_config) < 0) {
        return 1;
    }
    slcan_init(&line);
    uart_init(&uart, UART_0, CLOCK_HZ / BAUD);
    core_enable(CORE_UART_RECEIVE);
    core_enable(CORE_UART_TRANSMIT);
    for (;;) {
        if (zygos_step(&arm) == 1) {
            report_in_turn();
            continue;
        }
        core_mask();
        if (arm.receiver.queue.head == arm.receiver.queue.tail) {
            core_sleep();
        }
        core_unmask();
    }
}
