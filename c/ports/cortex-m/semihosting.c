/* SPDX-License-Identifier: MIT */
#include "semihosting.h"

enum { OPEN = 0x01, CLOSE = 0x02, PRINT = 0x04, WRITE = 0x05, READ = 0x06, EXIT_EXTENDED = 0x20 };
#define APPLICATION_EXIT 0x20026u

/* Operation and address of its arguments in r0 and r1, answer in r0. */
static uint32_t call(uint32_t operation, const void *arguments)
{
    register uint32_t r0 __asm("r0") = operation;
    register const void *r1 __asm("r1") = arguments;
    __asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static uint32_t length(const char *text)
{
    uint32_t n = 0;
    while (text[n] != '\0') {
        n++;
    }
    return n;
}

int32_t semihosting_open(const char *name, enum semihosting_mode mode)
{
    const uintptr_t arguments[3] = { (uintptr_t)name, (uintptr_t)mode, length(name) };
    return (int32_t)call(OPEN, arguments);
}

int32_t semihosting_close(int32_t handle)
{
    return (int32_t)call(CLOSE, &handle);
}

uint32_t semihosting_read(int32_t handle, void *out, uint32_t size)
{
    const uintptr_t arguments[3] = { (uintptr_t)handle, (uintptr_t)out, size };
    return size - call(READ, arguments);
}

uint32_t semihosting_write(int32_t handle, const void *from, uint32_t size)
{
    const uintptr_t arguments[3] = { (uintptr_t)handle, (uintptr_t)from, size };
    return size - call(WRITE, arguments);
}

void semihosting_print(const char *text)
{
    (void)call(PRINT, text);
}

_Noreturn void semihosting_exit(int status)
{
    const uint32_t arguments[2] = { APPLICATION_EXIT, (uint32_t)status };
    for (;;) {
        (void)call(EXIT_EXTENDED, arguments);
    }
}
