/* SPDX-License-Identifier: MIT */
/* What GCC calls on a SPARC V8. Your toolchain's libgcc and C library have it (BCC, RTEMS), and then this file goes;
   those of sparc64-linux-gnu-gcc -m32 are made of V9 instructions, which a LEON3 does not have. */

#include <stddef.h>
#include <stdint.h>

/* Without it GCC makes each of these loops a call of itself. */
#pragma GCC optimize("no-tree-loop-distribute-patterns")

#define TWO_32 4294967296.0

void *memcpy(void *to, const void *from, size_t size);
void *memmove(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);
int memcmp(const void *a, const void *b, size_t size);
int64_t __fixdfdi(double value);
uint64_t __fixunsdfdi(double value);
double __floatundidf(uint64_t value);

void *memcpy(void *to, const void *from, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        ((unsigned char *)to)[i] = ((const unsigned char *)from)[i];
    }
    return to;
}

void *memmove(void *to, const void *from, size_t size)
{
    if ((uintptr_t)to <= (uintptr_t)from) {
        return memcpy(to, from, size);
    }
    while (size > 0) {
        size--;
        ((unsigned char *)to)[size] = ((const unsigned char *)from)[size];
    }
    return to;
}

void *memset(void *to, int value, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        ((unsigned char *)to)[i] = (unsigned char)value;
    }
    return to;
}

int memcmp(const void *a, const void *b, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        const int difference = (int)((const unsigned char *)a)[i] - (int)((const unsigned char *)b)[i];
        if (difference != 0) {
            return difference;
        }
    }
    return 0;
}

uint64_t __fixunsdfdi(double value)
{
    const uint32_t high = (uint32_t)(value / TWO_32);
    const uint32_t low = (uint32_t)(value - (double)high * TWO_32);
    return ((uint64_t)high << 32) | low;
}

int64_t __fixdfdi(double value)
{
    return (value < 0.0) ? -(int64_t)__fixunsdfdi(-value) : (int64_t)__fixunsdfdi(value);
}

/* One rounding: both products are exact. */
double __floatundidf(uint64_t value)
{
    return (double)(uint32_t)(value >> 32) * TWO_32 + (double)(uint32_t)value;
}
