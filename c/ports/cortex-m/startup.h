/// From reset to main() on a Cortex-M, and what becomes of a fault.

#ifndef ZYGOS_STARTUP_H
#define ZYGOS_STARTUP_H

#include <stdint.h>

/// Exit status of a program that ran into a fault or an interrupt without a handler.
#define STARTUP_FAULT 99

/// The program. Its return value is the exit status under a debugger or emulator.
int main(void);

/// Handlers of the interrupts in use; a program defines those that it enables.
void uart_receive_interrupt(void);
void uart_transmit_interrupt(void);
void uart_overrun_interrupt(void);

/// Most bytes of stack in use at any time since reset, interrupts included. Cost: one pass over the unused stack.
uint32_t startup_stack_used(void);

#endif
