#include "startup.h"

#include "semihosting.h"

#include <string.h>

#define UNTOUCHED 0xA5A5A5A5u
#define FPU_FULL_ACCESS (0xFu << 20)

/* Coprocessor access control, and the FPSCR with which an interrupt begins. */
#define CPACR (*(volatile uint32_t *)0xE000ED88u)
#define FPDSCR (*(volatile uint32_t *)0xE000EF3Cu)

/* Places that the linker script names. */
extern unsigned char startup_data_begin[], startup_data_end[], startup_data_image[];
extern unsigned char startup_zero_begin[], startup_zero_end[];
extern uint32_t startup_stack_limit[], startup_stack_top[];

void reset(void);

static void fault(void)
{
    semihosting_exit(STARTUP_FAULT);
}

#define MAY_BE_MISSING __attribute__((weak, alias("fault")))
MAY_BE_MISSING void uart_receive_interrupt(void);
MAY_BE_MISSING void uart_transmit_interrupt(void);
MAY_BE_MISSING void uart_overrun_interrupt(void);

typedef struct {
    uint32_t *stack;
    void (*handler[15 + 13])(void); /* the core's, and the board's up to the last one in use */
} vectors_t;

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    startup_stack_top,
    { reset, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault,
      /* The first two interrupts of an MPS2 are those of UART 0, the thirteenth all UARTs' overrun. */
      uart_receive_interrupt, uart_transmit_interrupt, fault, fault, fault, fault, fault, fault, fault, fault, fault,
      fault, uart_overrun_interrupt },
};

void reset(void)
{
#if defined(__ARM_FP)
    CPACR |= FPU_FULL_ACCESS;
    FPDSCR = 0; /* to nearest, denormals and NaNs as IEEE 754 has them: the library's bits depend on it */
    __asm volatile("dsb\n\tisb\n\tvmsr fpscr, %0" : : "r"(0u) : "memory");
#endif
    memcpy(startup_data_begin, startup_data_image, (uintptr_t)startup_data_end - (uintptr_t)startup_data_begin);
    memset(startup_zero_begin, 0, (uintptr_t)startup_zero_end - (uintptr_t)startup_zero_begin);
    uint32_t *stack;
    __asm volatile("mov %0, sp" : "=r"(stack));
    for (volatile uint32_t *at = startup_stack_limit; at < stack; at++) {
        *at = UNTOUCHED;
    }
    semihosting_exit(main());
}

uint32_t startup_stack_used(void)
{
    const volatile uint32_t *at = startup_stack_limit;
    while ((at < startup_stack_top) && (*at == UNTOUCHED)) {
        at++;
    }
    return (uint32_t)((uintptr_t)startup_stack_top - (uintptr_t)at);
}
