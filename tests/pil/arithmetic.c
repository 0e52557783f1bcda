/* SPDX-License-Identifier: MIT */
/* Applies operations to operands from a file: ops.bin holds uint64 (operation) and two doubles each, results.bin a
   double each, or an integer that fits into one. */

#include "core.h"
#include "semihosting.h"

enum operation { ADD, SUBTRACT, MULTIPLY, DIVIDE, ROOT, LESS, FROM_UINT64, TO_INT32, TO_FLOAT };

static double apply(uint64_t operation, double a, double b)
{
    union {
        double value;
        uint64_t bits;
    } word = { a };
    switch (operation) {
    case ADD:
        return a + b;
    case SUBTRACT:
        return a - b;
    case MULTIPLY:
        return a * b;
    case DIVIDE:
        return a / b;
    case ROOT:
        return __builtin_sqrt(a);
    case LESS:
        return (a < b) ? 1.0 : 0.0;
    case FROM_UINT64:
        return (double)word.bits;
    case TO_INT32:
        return (double)(int32_t)a;
    default:
        return (double)(float)a;
    }
}

int main(void)
{
    struct {
        uint64_t operation;
        double a;
        double b;
    } one;
    const int32_t in = semihosting_open("ops.bin", SEMIHOSTING_READ);
    const int32_t out = semihosting_open("results.bin", SEMIHOSTING_WRITE);
    while (semihosting_read(in, &one, sizeof one) == sizeof one) {
        const double result = apply(one.operation, one.a, one.b);
        semihosting_write(out, &result, sizeof result);
    }
    return 0;
}
