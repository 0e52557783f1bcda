/* SPDX-License-Identifier: MIT */
/* Addition of doubles in software, with the last bit right.

   libgcc for Arm (gcc 12 at least) rounds one case the wrong way: of operands of unlike sign whose exponents differ by
   33, when the difference falls below the power of two that the larger one begins with, it has lost the bit that
   decides. The compiler calls these functions for + and - where the processor has no double; linked with
   -Wl,--wrap=__aeabi_dadd and so on they stand before libgcc's, and answer that case themselves. Doubles are passed in
   core registers, low word first, as the run-time ABI passes them, whatever the ABI of the program. */

#include <stdint.h>

#define SIGN 0x8000000000000000u
#define FRACTION 0x000FFFFFFFFFFFFFu
#define HIDDEN 0x0010000000000000u
#define INFINITE 0x7FFu
#define GAP 33u   /* exponents that differ by this many */
#define SPARE 11u /* bits of a 64-bit word below a 53-bit significand */

uint64_t __real___aeabi_dadd(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high);
uint64_t __real___aeabi_dsub(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high);
uint64_t __wrap___aeabi_dadd(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high);
uint64_t __wrap___aeabi_dsub(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high);
uint64_t __wrap___aeabi_drsub(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high);

static uint32_t exponent(uint64_t x)
{
    return (uint32_t)(x >> 52) & 0x7FFu;
}

/* From their upper words: the exponents may differ by GAP. One of a denormal reads one less than it counts, and so does
   the difference when the fractions borrow. In few instructions, for every sum comes by. */
static int suspect(uint32_t a, uint32_t b)
{
    const uint32_t apart = ((a << 1) - (b << 1)) >> 21;
    return (apart - (GAP - 1u) <= 2u) || (apart - (2048u - GAP - 2u) <= 2u);
}

/* large and small are of unlike sign. Returns 1 and the rounded sum when their exponents differ by GAP. */
static int subtract(uint64_t large, uint64_t small, uint64_t *out)
{
    const uint32_t top = exponent(large);
    const uint32_t bottom = exponent(small);
    if ((top == INFINITE) || (top != ((bottom > 0u) ? bottom : 1u) + GAP)) {
        return 0;
    }
    const uint64_t minuend = ((large & FRACTION) | HIDDEN) << SPARE;
    const uint64_t subtrahend = ((small & FRACTION) | ((bottom > 0u) ? HIDDEN : 0u)) << SPARE;
    const uint64_t rest = ((subtrahend & ((1uLL << GAP) - 1u)) != 0u) ? 1u : 0u;
    /* What was shifted out is less than 1, but more than nothing: a borrow, and a last bit that breaks ties. */
    uint64_t difference = (minuend - (subtrahend >> GAP) - rest) | rest;
    uint32_t place = top;
    if (!(difference & SIGN)) { /* the top bit is clear */
        difference <<= 1;
        place--;
    }
    const uint64_t kept = difference >> SPARE;
    const uint64_t lost = difference & ((1u << SPARE) - 1u);
    const uint64_t half = 1u << (SPARE - 1u);
    const uint64_t up = ((lost > half) || ((lost == half) && (kept & 1u))) ? 1u : 0u;
    /* The hidden bit adds 1 to the exponent, and a carry out of the significand another. */
    *out = (large & SIGN) | (((uint64_t)(place - 1u) << 52) + kept + up);
    return 1;
}

static uint64_t word(uint32_t low, uint32_t high)
{
    return (uint64_t)high << 32 | low;
}

/* Not inlined, so that all other sums pass by without a stack frame. */
__attribute__((noinline)) static uint64_t add(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high)
{
    const uint64_t a = word(a_low, a_high);
    const uint64_t b = word(b_low, b_high);
    uint64_t sum;
    if (((a ^ b) & SIGN) && (subtract(a, b, &sum) || subtract(b, a, &sum))) {
        return sum;
    }
    return __real___aeabi_dadd(a_low, a_high, b_low, b_high);
}

uint64_t __wrap___aeabi_dadd(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high)
{
    return suspect(a_high, b_high) ? add(a_low, a_high, b_low, b_high)
                                   : __real___aeabi_dadd(a_low, a_high, b_low, b_high);
}

uint64_t __wrap___aeabi_dsub(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high)
{
    return suspect(a_high, b_high) ? add(a_low, a_high, b_low, b_high ^ 0x80000000u)
                                   : __real___aeabi_dsub(a_low, a_high, b_low, b_high);
}

uint64_t __wrap___aeabi_drsub(uint32_t a_low, uint32_t a_high, uint32_t b_low, uint32_t b_high)
{
    return __wrap___aeabi_dsub(b_low, b_high, a_low, a_high);
}
