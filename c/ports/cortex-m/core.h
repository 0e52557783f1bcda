/* SPDX-License-Identifier: MIT */
/// The processor: from reset to main(), faults, interrupts, sleep.

#ifndef ZYGOS_CORE_H
#define ZYGOS_CORE_H

#include <stdint.h>

/// Exit status of a program that ran into a fault, or into an interrupt without a handler.
#define CORE_FAULT 99

/// Interrupts of UART 0 on an MPS2.
enum core_interrupt { CORE_UART_RECEIVE = 0, CORE_UART_TRANSMIT = 1 };

/// The program. Its return value is the exit status under a debugger or emulator.
int main(void);

/// Handlers; a program defines those of the interrupts that it enables. All have the same priority: none interrupts
/// another. The processor saves the floating-point registers when a handler first uses one, so handlers may calculate.
void tick_interrupt(void); ///< Of the processor's own timer, SysTick.
void uart_receive_interrupt(void);
void uart_transmit_interrupt(void);

/// Lets an interrupt in.
void core_enable(enum core_interrupt interrupt);

/// Between these two no handler runs. Keep it short.
void core_mask(void);
void core_unmask(void);

/// Waits for an interrupt. Returns at once when one is pending, also a masked one: call it masked, behind a look at
/// what the handlers left, and none is missed.
void core_sleep(void);

/// Most bytes of stack in use at any time since reset, interrupts included. Cost: one pass over the unused stack.
uint32_t core_stack_used(void);

#endif
