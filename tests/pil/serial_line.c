/* SPDX-License-Identifier: MIT */
/* Feeds what comes on stdin to the slcan parser and to the UART, on the host, where sanitizers watch.

       serial_line lines   every character to slcan_take(): writes the answers, and behind each frame > and slcan_line()
                           of it
       serial_line uart    a script for a UART whose registers are memory: c X receives a character, o loses one,
                           s TEXT sends, t lets the transmitter become free; writes what is received and sent */

#include "slcan.h"
#include "uart.h"

#include <stdio.h>
#include <string.h>

static void lines(void)
{
    slcan_t line;
    slcan_init(&line);
    for (int c = getchar(); c != EOF; c = getchar()) {
        zygos_frame_t frame;
        char answer[SLCAN_TEXT];
        const int complete = slcan_take(&line, (uint8_t)c, &frame, answer);
        fputs(answer, stdout);
        if (complete == 1) {
            char text[SLCAN_TEXT];
            printf(">%s", (slcan_line(&frame, text) == 1) ? text : "nothing");
        }
    }
    printf("\n%u %u %u\n", (unsigned)line.frames, (unsigned)line.refused, (unsigned)line.flags);
}

enum { FULL = 1, RECEIVED = 2, OVERRUN = 8 };

static uart_registers_t registers;
static uart_t uart;

/* What the transmitter has been given. */
static void show_sent(void)
{
    if (registers.data != 0) {
        printf("sent %c\n", (char)registers.data);
        registers.data = 0;
        registers.state |= FULL;
    }
}

static void read_all(void)
{
    uint8_t character = 0;
    const int read = uart_read(&uart, &character);
    if (read == 1) {
        printf("received %c\n", (char)character);
    } else {
        printf((read < 0) ? "lost\n" : "nothing\n");
    }
    registers.state &= ~(uint32_t)(RECEIVED | OVERRUN); /* as reading and writing them does */
    registers.data = 0;
}

static void script(void)
{
    char step[UART_BUFFER + 16];
    uart_init(&uart, &registers, 16);
    while (fgets(step, sizeof step, stdin) != NULL) {
        step[strcspn(step, "\n")] = '\0';
        switch (step[0]) {
        case 'c':
            registers.state |= RECEIVED;
            registers.data = (uint8_t)step[2];
            read_all();
            break;
        case 'o':
            registers.state |= OVERRUN;
            read_all();
            break;
        case 's':
            printf("%s\n", (uart_send(&uart, &step[2]) == 1) ? "taken" : "left out");
            show_sent();
            break;
        default:
            registers.state &= ~(uint32_t)FULL;
            uart_transmit(&uart);
            show_sent();
            break;
        }
    }
    printf("%u %u\n", (unsigned)uart.overruns, (unsigned)uart.left_out);
}

int main(int count, char **argument)
{
    if ((count == 2) && (strcmp(argument[1], "lines") == 0)) {
        lines();
    } else {
        script();
    }
    return 0;
}
