/* SPDX-License-Identifier: MIT */
/* The few system headers of the library, small enough for a parser that knows no extensions of a compiler. */
typedef signed char int8_t;
typedef unsigned char uint8_t;
typedef short int16_t;
typedef unsigned short uint16_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long int64_t;
typedef unsigned long uint64_t;
typedef unsigned long uintptr_t;
#define UINT32_MAX 4294967295u
#define INT32_MAX 2147483647
#define INT32_MIN (-INT32_MAX - 1)
#define UINT64_MAX 18446744073709551615ul
#define UINT64_C(x) x##ul
