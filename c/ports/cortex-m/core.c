/* SPDX-License-Identifier: MIT */
#include "core.h"

#include "semihosting.h"

#include <string.h>

#define UNTOUCHED 0xA5A5A5A5u
#define FPU_FULL_ACCESS (0xFu << 20)

/* Coprocessor access control, and the FPSCR with which an interrupt begins. */
#define CPACR (*(volatile uint32_t *)0xE000ED88u)
#define FPDSCR (*(volatile uint32_t *)0xE000EF3Cu)
#define INTERRUPT_ENABLE (*(volatile uint32_t *)0xE000E100u)

/* Places that the linker script names. */
extern unsigned char core_data_begin[], core_data_end[], core_data_image[];
extern unsigned char core_zero_begin[], core_zero_end[];
extern uint32_t core_stack_limit[], core_stack_top[];

void reset(void);

static void fault(void)
{
    semihosting_exit(CORE_FAULT);
}

#define MAY_BE_MISSING __attribute__((weak, alias("fault")))
MAY_BE_MISSING void tick_interrupt(void);
MAY_BE_MISSING void uart_receive_interrupt(void);
MAY_BE_MISSING void uart_transmit_interrupt(void);

typedef struct {
    uint32_t *stack;
    void (*handler[15 + 2])(void); /* the core's, and the board's as in enum core_interrupt */
} vectors_t;

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    core_stack_top,
    { reset, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, tick_interrupt,
      uart_receive_interrupt, uart_transmit_interrupt },
};

void reset(void)
{
#if defined(__ARM_FP)
    CPACR |= FPU_FULL_ACCESS;
    FPDSCR = 0; /* to nearest, denormals and NaNs as IEEE 754 has them: the library's bits depend on it */
    __asm volatile("dsb\n\tisb\n\tvmsr fpscr, %0" : : "r"(0u) : "memory");
#endif
    memcpy(core_data_begin, core_data_image, (uintptr_t)core_data_end - (uintptr_t)core_data_begin);
    memset(core_zero_begin, 0, (uintptr_t)core_zero_end - (uintptr_t)core_zero_begin);
    uint32_t *stack;
    __asm volatile("mov %0, sp" : "=r"(stack));
    for (volatile uint32_t *at = core_stack_limit; at < stack; at++) {
        *at = UNTOUCHED;
    }
    semihosting_exit(main());
}

void core_enable(enum core_interrupt interrupt)
{
    INTERRUPT_ENABLE = 1u << interrupt;
}

void core_mask(void)
{
    __asm volatile("cpsid i" : : : "memory");
}

void core_unmask(void)
{
    __asm volatile("cpsie i" : : : "memory");
}

void core_sleep(void)
{
    __asm volatile("dsb\n\twfi" : : : "memory");
}

uint32_t core_stack_used(void)
{
    const volatile uint32_t *at = core_stack_limit;
    while ((at < core_stack_top) && (*at == UNTOUCHED)) {
        at++;
    }
    return (uint32_t)((uintptr_t)core_stack_top - (uintptr_t)at);
}
